"""The page and its pictures: complete, self-contained, safe, the same every time."""

import html.parser
import io
import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from spl_batch.airborne.report.model import Counts, DeliveredUnits
from spl_batch.airborne.report.pictures import PICTURES, Profile, Raster, make_pictures
from spl_batch.airborne.report.survey_page import render
from spl_batch.constants import US_FOOT_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report import maps, style
from spl_batch.engine.report.page import write_both
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.reported import reported
from spl_batch.errors import StoppedError
from spl_batch.formats.units import US_FOOT
from tests.report_data import (
    EXTENT,
    drawn_pictures,
    make_failures,
    make_inputs,
    make_profile,
    make_report,
    smallest_report,
)

VOID_ELEMENTS = {"meta", "img", "br", "hr", "link", "input"}

pytestmark = pytest.mark.pictures


class Page(html.parser.HTMLParser):
    """Tags, attributes and text of a page; complains about tags that do not match."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, dict[str, str | None]]] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(content)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes.append((tag, dict(attrs)))
        if tag not in VOID_ELEMENTS:
            self.open.append(tag)
        for name, value in attrs:
            assert not name.startswith("on"), f"{tag} carries the script {name}"
            if name in {"src", "href", "action", "data", "srcset", "poster"}:
                self.links.append(value or "")
            if name == "id":
                self.ids.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.text += data


@pytest.fixture(scope="module")
def pictures() -> Mapping[str, Picture]:
    with drawn_pictures():
        return make_pictures(report=make_report(), **make_inputs())


@pytest.fixture(scope="module")
def page(pictures: Mapping[str, Picture]) -> str:
    return render(make_report(), pictures)


class TestPage:
    def test_it_is_one_file_without_any_reference(self, page: str) -> None:
        parsed = Page(page)
        assert parsed.open == []
        for link in parsed.links:
            assert link.startswith(("data:image/png;base64,", "#")), link
        assert not {"script", "link", "iframe", "object", "base"} & set(parsed.tags)
        style_text = page[: page.index("</style>")]
        assert "url(" not in style_text
        assert "@import" not in style_text
        assert "http:" not in re.sub(r"base64,[^\"]*", "", page)
        assert "https:" not in page

    def test_it_has_one_main_part_headings_in_order_and_pictures_in_words(self, page: str) -> None:
        parsed = Page(page)
        assert parsed.tags.count("main") == 1
        levels = [int(tag[1]) for tag in parsed.tags if re.fullmatch("h[1-4]", tag)]
        assert (levels[0], levels.count(1)) == (1, 1)
        assert all(after - before <= 1 for before, after in pairwise(levels))
        scopes = {given.get("scope") for tag, given in parsed.attributes if tag == "th"}
        assert scopes == {"col", "row"}
        texts = [given["alt"] or "" for tag, given in parsed.attributes if tag == "img"]
        assert all(len(text) > 20 for text in texts)
        assert page.index("Parameters that differ") < page.index("Appendix: all parameters")

    def test_each_inner_link_has_its_aim(self, page: str) -> None:
        parsed = Page(page)
        inner = [link[1:] for link in parsed.links if link.startswith("#")]
        assert len(inner) >= 6
        assert set(inner) <= set(parsed.ids)

    def test_it_holds_every_picture_and_section(self, page: str) -> None:
        parsed = Page(page)
        assert parsed.tags.count("img") == len(PICTURES)
        for heading in ("Failures", "Accuracy", "Map and profile", "Noise", "Method", "Provenance"):
            assert heading in parsed.text
        assert "Weak Echo Detection" in parsed.text
        assert "Filtering of Single Photon Lidar Data" in parsed.text
        assert "sha256:1111" in parsed.text

    def test_points_that_took_no_part_are_listed(self) -> None:
        counts = Counts(points_in=9, points_out=9, signal=6, outside_aoi=1, copies=2)
        text = " ".join(Page(render(make_report(counts=counts), {})).text.split())
        assert "part: 1 outside the area of interest, 2 that are copies of others." in text

    def test_the_same_input_gives_the_same_page(
        self, page: str, pictures: Mapping[str, Picture]
    ) -> None:
        assert render(make_report(), pictures) == page
        rasters = {name: make_inputs()["rasters"][name] for name in ("dtm", "dsm")}
        again = make_pictures(rasters, make_report(), make_inputs()["profile"])
        for name in (*rasters, "profile"):
            assert again[name].png == pictures[name].png

    def test_names_cannot_become_markup(self) -> None:
        evil = "<script>alert(1)</script>\"'&"
        failures = tuple(
            f.model_copy(update={"reason": evil, "remedy": evil, "place": evil})
            for f in make_failures()
        )
        report = make_report(
            survey=make_report().survey.model_copy(update={"name": evil, "crs_name": evil}),
            failures=failures,
            findings=reported([Finding("I06", {"what": evil}, evil)]),
            provenance=make_report().provenance.model_copy(
                update={"parameters": {evil: evil}, "command": evil}
            ),
        )
        made = {"dtm": Picture(evil, evil, evil, b"x", 1, 1), "dsm": Picture(evil, evil)}
        parsed = Page(render(report, made))
        assert parsed.open == []
        assert "script" not in parsed.tags
        assert evil in parsed.text

    def test_a_page_even_of_nothing_shows_no_value_as_nan_or_none(self, page: str) -> None:
        for content in (page, render(smallest_report(), {})):
            parsed = Page(content)
            assert parsed.open == []
            words = set(re.findall(r"[A-Za-z]+", parsed.text))
            assert not {"nan", "NaN", "inf", "None", "Undefined"} & words
        assert "No points were read." in parsed.text

    def test_long_tables_are_cut_and_say_so(self) -> None:
        many = [Finding("I06", {"what": f"warning number {n}"}) for n in range(350)]
        report = make_report(findings=reported(many))
        shown = Page(render(report, {})).text
        assert "warning number 199" in shown
        assert "warning number 200" not in shown
        assert "150 more are in report.json" in shown


class TestWrite:
    def test_a_failed_write_keeps_the_earlier_report(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        write_both(tmp_path, make_report(), render(make_report(), {}))
        before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

        def full(_: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.fsync", full)
        with pytest.raises(StoppedError, match="disk full"):
            write_both(tmp_path, make_report(findings=()), "other")
        assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


class TestPictures:
    def test_each_is_a_picture_of_the_size_it_says(self, pictures: Mapping[str, Picture]) -> None:
        assert tuple(pictures) == PICTURES
        for made in pictures.values():
            image = Image.open(io.BytesIO(made.png))
            assert image.format == "PNG"
            assert image.size == (made.width_px, made.height_px)
            assert made.caption
            assert made.title in made.alt

    def test_what_is_missing_says_why(self) -> None:
        made = make_pictures({}, make_report())
        assert tuple(made) == PICTURES
        for picture in made.values():
            assert picture.png == b""
            assert picture.caption.endswith(".")
        shown = Page(render(make_report(), made)).text
        assert all(picture.caption in shown for picture in made.values())

    def test_rasters_without_a_value_are_missing(self) -> None:
        nothing = Raster(np.full((5, 5), -9999.0, dtype=np.float32), EXTENT)
        rasters = dict.fromkeys(PICTURES, nothing)
        made = make_pictures(rasters, make_report(accuracy=None), None, np.full(3, np.nan))
        assert all(picture.png == b"" for picture in made.values())

    @pytest.mark.parametrize("shape", [(1, 1), (1, 7), (300, 2), (2, 300)])
    def test_odd_shapes_can_be_drawn(self, shape: tuple[int, int]) -> None:
        extent = (0.0, float(shape[1]), 0.0, float(shape[0]))
        flat = Raster(np.full(shape, 7.25), extent)
        picture = make_pictures({"dtm": flat, "difference": flat}, make_report())
        assert picture["dtm"].png
        assert picture["difference"].png

    def test_pictures_of_a_survey_in_feet_are_in_feet(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        drawn: list[Figure] = []
        monkeypatch.setattr(style, "to_png", lambda made: (drawn.append(made), (b"", 1, 1))[1])
        inputs, report = make_inputs(), make_report()
        feet = DeliveredUnits(
            horizontal=US_FOOT, horizontal_m=US_FOOT_M, vertical=US_FOOT, vertical_m=US_FOOT_M
        )
        for units in (DeliveredUnits(), feet):
            survey = report.survey.model_copy(update={"units": units})
            make_pictures(
                inputs["rasters"],
                report.model_copy(update={"survey": survey}),
                replace(inputs["profile"], units=units.known),
                inputs["differences_m"],
            )
        half = len(drawn) // 2
        labels = []
        for ours, theirs in zip(drawn[:half], drawn[half:], strict=True):
            mine, other = ours.axes[0], theirs.axes[0]
            places = mine.images or "height" in mine.get_ylabel()
            assert np.allclose(
                mine.viewLim, other.viewLim.get_points() * (US_FOOT_M if places else 1)
            )
            before, after = ([one.get_ylabel() for one in made.axes] for made in (ours, theirs))
            labels += after
            for mine, other, label in zip(ours.axes, theirs.axes, after, strict=True):
                if label.startswith("height") and label.endswith("[ft]"):
                    assert np.allclose(mine.get_ylim(), np.multiply(other.get_ylim(), US_FOOT_M))
                elif not label.endswith("[ft]"):
                    assert label in before
        assert sum(label.endswith("[ft]") for label in labels) == 6
        assert re.search(r"RMSE \S+\sft \(\S+\scm\)", drawn[-2].axes[0].get_title(loc="left"))

    def test_differences_are_shown_in_centimetres(self, monkeypatch: pytest.MonkeyPatch) -> None:
        drawn: list[Figure] = []
        monkeypatch.setattr(style, "to_png", lambda made: (drawn.append(made), (b"", 1, 1))[1])
        metres = Raster(np.linspace(0.0, 0.4, 900).reshape(30, 30), EXTENT)
        make_pictures({"strips": metres, "difference": metres}, make_report())
        strips, difference = (made.axes[1].viewLim.get_points() for made in drawn)
        assert strips.max() == pytest.approx(39.2, abs=0.1), "98 % of the cells"
        assert np.abs(difference).max() == 50.0

    def test_the_order_of_points_does_not_show(self) -> None:
        profile = make_profile(np.random.default_rng(1))
        order = np.random.default_rng(2).permutation(profile.along_m.size)
        columns = (profile.along_m, profile.z_m, profile.noise_class, profile.classification)
        shuffled = Profile(*[c[order] for c in columns], width_m=profile.width_m)
        first, second = (
            make_pictures({}, make_report(), p)["profile"].png for p in (profile, shuffled)
        )
        assert first == second

    def test_two_threads_draw_what_one_draws(self, pictures: Mapping[str, Picture]) -> None:
        inputs, report = make_inputs(), make_report()
        rasters, differences_m = {"chm": inputs["rasters"]["chm"]}, inputs["differences_m"]

        def draw(_: int) -> dict[str, Picture]:
            return make_pictures(rasters, report, None, differences_m)

        with ThreadPoolExecutor(2) as pool:
            for made in pool.map(draw, range(2)):
                for key in ("chm", "histogram"):
                    assert made[key].png == pictures[key].png

    def test_a_large_png_is_reduced(self) -> None:
        drawn = style.figure(2.0, 2.0)
        axes = drawn.subplots()
        axes.imshow(np.random.default_rng(4).random((360, 360, 3)))
        whole, width, height = style.to_png(drawn, largest=10_000_000)
        small, *size = style.to_png(drawn, largest=60_000)
        assert len(small) <= 60_000 < len(whole)
        assert tuple(size) == (width, height)


class TestMaps:
    def test_reduction_is_the_mean_of_what_is_there(self) -> None:
        rng = np.random.default_rng(5)
        values = rng.normal(10, 3, (23, 37))
        values[rng.random(values.shape) < 0.3] = -9999.0
        values[:4, :4] = np.nan
        made = maps.reduce_raster(Raster(values, (100.0, 137.0, 50.0, 73.0)), largest=10)
        assert made.values.shape == (6, 10)
        for row in range(6):
            for column in range(10):
                block = values[row * 4 : row * 4 + 4, column * 4 : column * 4 + 4].ravel()
                block = [v for v in block if np.isfinite(v) and v != -9999.0]
                expected = np.mean(block) if block else np.nan
                np.testing.assert_allclose(made.values[row, column], expected, rtol=1e-12)
        assert made.extent_m == pytest.approx((100.0, 140.0, 49.0, 73.0))

    def test_a_ramp_spans_the_values_or_something(self) -> None:
        assert maps.spread(np.array([100.0, np.nan, 110.0]), 0, 100) == (100.0, 110.0)
        assert maps.spread(np.full(3, 100.0), 0, 100) == pytest.approx((99.95, 100.05))
