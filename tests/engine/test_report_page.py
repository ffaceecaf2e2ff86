"""What a reader meets on the pages of all receivers: structure, words, units, print, pieces."""

import html.parser
import re
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from spl_batch.airborne.compare.comparison import ComparisonReport, MethodResult
from spl_batch.airborne.compare.comparison import write as write_comparison
from spl_batch.airborne.report.model import Report
from spl_batch.airborne.report.noise_model import Noise
from spl_batch.airborne.report.pictures import PictureInputs, Raster, make_pictures
from spl_batch.airborne.report.survey_page import render
from spl_batch.airborne.report.verdicts import screen_summary
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.altimetry.compare.comparison_page import TrackComparison, TrackMethod
from spl_batch.altimetry.compare.comparison_page import write as write_tracks
from spl_batch.altimetry.report import page as track_page
from spl_batch.altimetry.report import pictures as track_pictures
from spl_batch.altimetry.report.model import Beam, TrackCounts, TrackReport
from spl_batch.engine.report import style
from spl_batch.engine.report.parameters import changed, without
from spl_batch.engine.report.parts import Provenance, Statistics
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.verbs import reporting
from spl_batch.errors import StoreError
from spl_batch.geiger.coincidence.report import model as coincidence
from spl_batch.geiger.coincidence.report import page as coincidence_page
from spl_batch.geiger.water.report import model as water
from spl_batch.geiger.water.report import page as water_page
from spl_batch.geiger.water.report import pictures as water_pictures
from tests.report_data import EXTENT, make_inputs, make_report

MADE = Provenance(version="0", created="2026-01-01T00:00:00+00:00")
GALLERY_PX, WIDE_PX = 508, 1044
"""Width that the page lays a picture out with, at its widest."""


class Outline(html.parser.HTMLParser):
    """Headings, headers of tables, tables by their number of columns, and text of a page."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.headings: list[int] = []
        self.headers: list[dict[str, str | None]] = []
        self.tables: list[list[str]] = []
        self.parents: list[str] = []
        self.open: list[tuple[str, dict[str, str | None]]] = []
        self.images: list[dict[str, str | None]] = []
        self.text = ""
        self.feed(content)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in {"h1", "h2", "h3", "h4"}:
            self.headings.append(int(tag[1]))
        if tag == "th":
            self.headers.append(given)
        if tag == "table":
            self.tables.append([])
            self.parents.append(str(self.open[-1][1].get("class")))
        if tag == "img":
            self.images.append(given)
        elif tag not in {"meta", "input", "hr"}:
            self.open.append((tag, given))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        inside = [tag for tag, _ in self.open]
        if "style" not in inside:
            self.text += data
        if "thead" in inside and inside[-1] == "th":
            self.tables[-1].append(data)


def beam(**changes: Any) -> Beam:
    values: dict[str, Any] = {
        "file": "track_with_a_long_name_20260101.h5",
        "name": "gt1r",
        "photons": 131_247,
        "signal": 6_786,
        "noise_per_m2": (0.01, 0.02, 0.04),
        "ground": Statistics(n=5, mean=0.1, rmse=0.4, median=-1.5, nmad=0.29),
    }
    return Beam(**{**values, **changes})


def track_report() -> TrackReport:
    return TrackReport(
        name="hills",
        method="likelihood",
        counts=TrackCounts(
            points_in=209_593, points_out=209_593, signal=24_238, background=185_355
        ),
        ground=Statistics(n=9, median=-0.01, nmad=0.29, rmse=1.41),
        beams=(beam(), beam(name="gt1l")),
        provenance=MADE,
    )


def water_report() -> water.WaterReport:
    errors = {"variance_m2": 5.8e-6, "mse_m2": 70.6e-6, "normal_deg": 1.27, "pixel_normal_deg": 2.9}
    return water.WaterReport(
        name="tank",
        method="adaptive",
        frames_per_acquisition=2000,
        files=(
            water.WaterFile(name="a.h5", role="water", frames=4000, acquisitions=20,
                            gate=(395, 442), hits=503_901, outside=1719),
        ),
        points=18_560,
        surfaces=water.SurfaceErrors(acquisitions=20, bias_m=0.008, signed_bias_m=0.00801,
                                     **errors),
        floor=water.FloorErrors(in_water_m=6.2, straight_m=0.5748, level_m=0.2888,
                                refracted_m=0.0548, straight_beam_m=0.5727, level_beam_m=0.2839,
                                refracted_beam_m=0.0364),
        calibration=None,
        provenance=MADE,
    )  # fmt: skip


def coincidence_report() -> coincidence.CoincidenceReport:
    return coincidence.CoincidenceReport(
        scene=coincidence.Scene(name="scene", method="bridge_sign", voxel_m=0.045),
        counts=coincidence.Counts(frames=4419, looks=18_100_224, detections=4_417_001, points=5),
        intensity=coincidence.Intensity(),
        provenance=MADE,
    )


def comparison(folder: Path) -> str:
    method = MethodResult(name="vsaes", folder="vsaes", points=10, signal=7, background=2,
                          afterpulse=1, ground=5, kept_only=0, removed_only=0)  # fmt: skip
    report = ComparisonReport(
        survey="s", version="0", photons=True, far_m=50.0, methods=(method, method)
    )
    write_comparison(folder, report, [])
    return (folder / "compare.html").read_text(encoding="utf-8")


def track_comparison(folder: Path) -> str:
    method = TrackMethod(name="mdbscan", title="mDBSCAN", folder="compare/mdbscan", photons=10,
                         signal=7, kept_only=0, removed_only=0)  # fmt: skip
    write_tracks(folder, TrackComparison(name="t", version="0", methods=(method, method)), None)
    return (folder / "compare.html").read_text(encoding="utf-8")


def linear_report(**changes: Any) -> Report:
    """As the workflow for linear-mode lidar gives it."""
    whole = make_report()
    survey = whole.survey.model_copy(update={"flightlines": (), "sensor": None})
    counts = whole.counts.model_copy(
        update={"signal": whole.counts.points_in, "background": 0, "afterpulse": 0,
                "not_assessed": 0, "withheld": 0, "vendor_flagged": 0}
    )  # fmt: skip
    parameters = {
        "kind": "imaging",
        "output": "out",
        "survey": {"name": "town", "flightlines": "*.laz", "sensor": "spl100"},
        "filter": {"method": "none", "dcc": {"coarse_bin_m": 30.0}},
        "afterpulse": {"enabled": False, "lag_max_m": 5.0},
        "ground": {"method": "smrf"},
        "products": {"cell_m": 0.5},
    }
    made = whole.provenance.model_copy(update={"parameters": parameters})
    values = {"survey": survey, "counts": counts, "noise": Noise(), "accuracy": None,
              "provenance": made, "findings": ()}  # fmt: skip
    return make_report(**{**values, **changes})


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    report = make_report()
    return {
        "airborne": render(report, make_pictures(make_inputs(), report)),
        "linear": render(linear_report(), make_pictures(PictureInputs(), linear_report())),
        "altimetry": track_page.render(track_report(), [{}]),
        "coincidence": coincidence_page.render(
            coincidence_report(), coincidence_page.pictures(None, None, None)
        ),
        "water": water_page.render(water_report(), {}),
        "compare": comparison(tmp_path_factory.mktemp("compare")),
        "tracks": track_comparison(tmp_path_factory.mktemp("tracks")),
    }


KINDS = ("airborne", "linear", "altimetry", "coincidence", "water", "compare", "tracks")


class TestStructure:
    @pytest.mark.parametrize("kind", KINDS)
    def test_headers_name_what_they_head(self, pages: dict[str, str], kind: str) -> None:
        for header in Outline(pages[kind]).headers:
            assert header.get("scope") in {"col", "row"}

    @pytest.mark.parametrize("kind", KINDS)
    def test_there_is_one_main_part_and_no_level_of_heading_is_left_out(
        self, pages: dict[str, str], kind: str
    ) -> None:
        assert pages[kind].count("<main>") == pages[kind].count("</main>") == 1
        levels = Outline(pages[kind]).headings
        assert levels[0] == 1
        assert levels.count(1) == 1
        assert all(after - before <= 1 for before, after in pairwise(levels))

    def test_each_picture_is_told_in_words(self, pages: dict[str, str]) -> None:
        images = Outline(pages["airborne"]).images
        assert len(images) == 10
        assert all(len(image["alt"] or "") > 20 for image in images)

    @pytest.mark.parametrize("kind", KINDS)
    def test_each_table_scrolls_by_itself(self, pages: dict[str, str], kind: str) -> None:
        parents = Outline(pages[kind]).parents
        assert parents
        assert set(parents) == {"scroll"}
        assert pages[kind].count('class="scroll" tabindex="0"') == len(parents)

    def test_the_table_of_beams_has_room(self, pages: dict[str, str]) -> None:
        (beams,) = [t for t in Outline(pages["altimetry"]).tables if "length [km]" in t]
        assert len(beams) <= 12
        assert 'class="wrap">track_with_a_long_name' in pages["altimetry"]

    def test_the_print_keeps_headings_with_their_tables(self, pages: dict[str, str]) -> None:
        printed = pages["airborne"].split("@media print", 1)[1].split("</style>", 1)[0]
        assert re.search(r"h2, h3, \.lead, [^{}]*\{ break-after: avoid; \}", printed)
        assert "break-after: page" not in printed, "it left a page nearly empty"
        assert "orphans: 1" in printed, "a row of maps may stand alone at the end of a page"
        assert re.search(r"pre\.small \{ font-size: 6pt", printed)


class TestLinear:
    def test_nothing_is_said_of_single_photons(self) -> None:
        report = linear_report()
        inputs = make_inputs()
        pictures = make_pictures(inputs, report)
        shown = render(report, pictures)
        page = Outline(shown)
        assert len(page.images) == 7
        told = page.text + " ".join(image["alt"] or "" for image in page.images)
        words = r"single.photon|SPL100|spl100|afterpulse|beamlet|circular|noise filter|Wang"
        assert not re.findall(words, told, re.IGNORECASE)
        assert "Linear-mode lidar" in told
        assert "ground.method" in told
        assert "filter.method" in told
        assert 'href="#noise"' not in shown

    def test_the_console_says_nothing_of_noise(self) -> None:
        assert [label for label, _ in screen_summary(linear_report())][:3] == [
            "points",
            "ground",
            "density",
        ]

    def test_a_survey_with_afterpulses_alone_is_still_of_photons(self) -> None:
        parameters = {"afterpulse": {"enabled": True}}
        made = make_report().provenance.model_copy(update={"parameters": parameters})
        shown = render(make_report(noise=Noise(), provenance=made), {})
        assert "single-photon lidar" in shown.lower()
        assert 'id="noise"' in shown


class TestParameters:
    def test_only_what_differs_is_shown(self) -> None:
        given = {"kind": "imaging", "survey": {"flightlines": ["x" * 500]}, "output": "o"}
        given |= {"products": {"cell_m": 0.5}, "ground": {"method": "smrf"}}
        whole = parse_workflow(given, "w").model_dump(mode="json")
        found = dict(changed(whole))
        assert found.keys() == {"survey.flightlines", "output", "products.cell_m", "ground.method"}
        assert (found["products.cell_m"], found["ground.method"]) == ("0.5", "smrf")
        assert len(found["survey.flightlines"]) < 200
        assert not dict(changed({"kind": "of another version"}))

    def test_keys_are_left_out_however_deep(self) -> None:
        given = {"a": {"b": 1, "c": 2}, "d": 3}
        assert without(given, ["a.b", "d"]) == {"a": {"c": 2}}


class TestPictures:
    def test_pictures_of_all_receivers_are_twice_as_fine_as_the_page(self) -> None:
        for wide, pictures in drawn_of_others():
            for picture in pictures:
                assert picture.width_px >= 2 * (WIDE_PX if wide else GALLERY_PX) - 1, picture.title

    def test_axes_of_other_receivers_have_names_and_units(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        seen = watch(monkeypatch)
        drawn_of_others()
        labels = {text for drawn in seen for axes in drawn.axes for text in names(axes)}
        assert len(labels) > 12
        for label in labels:
            assert re.search(r"\[[^\]]+\]$|detections per look$", label), label
            assert "less" not in label


def words(drawn: Figure) -> list[str]:
    """All text of a figure."""
    parts = [*drawn.texts, *(t for axes in drawn.axes for t in axes.texts)]
    return [part.get_text() for part in parts]


def names(axes: Any) -> list[str]:
    """Names of the axes of a chart; a map's have none."""
    return [t for t in (axes.get_xlabel(), axes.get_ylabel()) if t]


def watch(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Every figure that becomes a picture from now on."""
    seen: list[Figure] = []
    to_png = style.to_png

    def noted(drawn: Figure, **given: Any) -> tuple[bytes, int, int]:
        seen.append(drawn)
        return to_png(drawn, **given)

    monkeypatch.setattr(style, "to_png", noted)
    return seen


def titles(make: Any, *given: Any) -> list[str]:
    """Headings of the figures that a call draws."""
    with pytest.MonkeyPatch.context() as patch:
        seen = watch(patch)
        make(*given)
    return [
        t for drawn in seen for t in (*words(drawn), *(a.get_title("left") for a in drawn.axes))
    ]


def drawn_of_others() -> list[tuple[bool, list[Any]]]:
    """Pictures of the other receivers, and whether they are as wide as the page."""
    rng = np.random.default_rng(1)
    along = np.linspace(0, 4000, 50)
    hills = track_pictures.draw(
        track_pictures.BeamPictures(
            "a gt1r",
            np.column_stack(
                [along, rng.normal(0, 1, 50), rng.integers(0, 2, 50), rng.choice([0, 40, 41], 50)]
            ),
            np.column_stack([along, along * 0, along * 0 + 2, along * 0, along * 0 - 3]),
            np.column_stack([along, along * 0 + 0.1]),
            np.column_stack([along, rng.normal(0, 1, 50), rng.normal(0, 1, 50)]),
        )
    )
    grid = rng.random((8, 8))
    tank = water_pictures.make_pictures(
        Raster(grid, (0.0, 1.0, 0.0, 1.0)),
        dict.fromkeys(("bias_m", "variance_m2", "mse_m2", "normal_deg"), grid),
        rng.integers(0, 9, 500),
        (100, 200),
        grid,
    )
    strip = (rng.random((9, 2)), rng.random((9, 2)))
    raster = Raster(grid, EXTENT)
    scene = coincidence_page.pictures(raster, raster, strip)
    small = [tank.pop(k) for k in ("height", "intensity")]
    return [
        (True, [*hills.values(), *tank.values(), scene.pop("slice")]),
        (False, [*small, *scene.values()]),
    ]


def test_a_profile_shows_the_water_that_it_crosses(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = watch(monkeypatch)
    along = np.linspace(0, 4000, 60)
    none = np.full(60, np.nan)
    water = np.repeat([0, 41, 40], 20)
    for parts, lines in ((along * 0, (along * 0, none, none, none)), (water, (along * 0,) * 4)):
        photons = np.column_stack([along, along * 0, along * 0 + 1, parts])
        profile = np.column_stack([along, *lines])
        rate = np.column_stack([along, along * 0 + 0.1])
        track_pictures.draw(track_pictures.BeamPictures("a", photons, profile, rate, None))
    land, lake = (
        [text.get_text() for text in drawn.axes[0].get_legend().get_texts()]
        for drawn in shown
        if drawn.axes[0].get_legend() is not None
    )
    assert land == ["signal", "ground line"]
    assert lake[:3] == ["signal", "water surface", "floor"]
    assert lake[3:] == ["ground line", "canopy top line", "water surface line", "floor line"]


@pytest.mark.parametrize("same", [True, False])
def test_records_of_another_version_are_told(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    same: bool,  # noqa: FBT001
) -> None:
    def fails(*_: object) -> None:
        raise KeyError("a fact")

    code = code_version("imaging") if same else "0.0.9+0123456789abcdef"
    kind = SimpleNamespace(kind="imaging")
    context = SimpleNamespace(code=code, workflow=kind, output=tmp_path)
    monkeypatch.setattr(reporting, "no_output", lambda *_: "")
    monkeypatch.setattr(reporting, "recalled", lambda _: ({}, context, None))
    monkeypatch.setattr(reporting, "receiver", lambda _: SimpleNamespace(report=fails))
    # a fault of this version's own is no other's
    with pytest.raises(KeyError if same else StoreError, match=r"a fact|0\.0\.9.*run the workflow"):
        reporting.report(tmp_path)
