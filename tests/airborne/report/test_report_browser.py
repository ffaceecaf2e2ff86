"""What a reader does with the page in a browser: choose a map, come nearer, read it in the dark."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from spl_batch.airborne.report.clip_view import Clip
from spl_batch.airborne.report.pictures import PictureInputs, make_pictures
from spl_batch.airborne.report.survey_page import render
from tests.browser import Page, browser, needs_chromium
from tests.report_data import make_failures, make_inputs, make_report

pytestmark = [pytest.mark.slow, needs_chromium]

SHOWN = (
    "[...document.querySelectorAll('.layers figure')]"
    ".filter(f => f.checkVisibility()).map(f => f.className)"
)
FOCUS = "document.activeElement.id || document.activeElement.className"


WEBGL = ("--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader")


def make_clip() -> Clip:
    """Ground, and background noise above it."""
    rng = np.random.default_rng(5)
    xyz = rng.uniform(0, (100, 100, 40), (4000, 3))
    kind = np.repeat(np.array([0, 2], np.uint8), 2000)
    xyz[kind == 0, 2] = 5.0
    return Clip(xyz, kind, (500_000.0, 3_300_000.0), 4000)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    inputs = make_inputs()
    part = PictureInputs(dtm=inputs.dtm, density=inputs.density, profile=inputs.profile)
    failed = make_failures()[1].model_copy(
        update={"extent_m": (500_100.0, 500_200.0, 3_300_000.0, 3_300_100.0)}
    )
    report = make_report(failures=(failed,))
    made = tmp_path_factory.mktemp("page") / "report.html"
    made.write_text(render(report, make_pictures(part, report), make_clip()), encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("profile"), *WEBGL) as opened:
        yield opened


@pytest.fixture
def page(path: Path, chromium: Page) -> Page:
    chromium.media()
    chromium.open(path)
    return chromium


def width(page: Page, image: str) -> float:
    return float(page.ask(f"document.querySelector('{image}').getBoundingClientRect().width"))


def test_keys_choose_a_map_and_its_size(page: Page) -> None:
    assert page.ask(SHOWN) == ["dtm"]
    page.ask("document.getElementById('layer-dtm').focus()")
    page.press("ArrowRight")
    assert page.ask(FOCUS) == "layer-density"
    assert page.ask(SHOWN) == ["density"]
    whole = width(page, ".density img")

    page.press("Tab")
    assert page.ask(FOCUS) == "zoom-map-x1"
    page.press("ArrowRight", times=2)
    assert width(page, ".density img") > 3 * whole
    page.press("Tab")
    assert page.ask(FOCUS) == "show-marks"
    mark = "document.querySelector('.density .mark').checkVisibility()"
    assert page.ask(mark)
    page.press("Space")
    assert not page.ask(mark)
    page.press("Tab")
    assert page.ask(FOCUS) == "pan"
    page.press("ArrowRight", times=3)
    page.ask("new Promise(done => setTimeout(done, 400))")
    place = page.ask("document.activeElement.scrollLeft")
    assert place > 0
    # The other map shows the same place.
    page.ask("document.getElementById('layer-dtm').click()")
    assert page.ask(SHOWN) == ["dtm"]
    assert page.ask("document.querySelector('.layers .pan').scrollLeft") == place
    assert width(page, "#map figure.wide img") < 1100, "the profile has a size of its own"


DRAWN = """new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => {
  const drawn = document.querySelector('#clip canvas'), flat = document.createElement('canvas');
  [flat.width, flat.height] = [drawn.width, drawn.height];
  const pen = flat.getContext('2d');
  pen.drawImage(drawn, 0, 0);
  const data = pen.getImageData(0, 0, flat.width, flat.height).data;
  const count = (r, g, b) => {
    let n = 0;
    for (let i = 0; i < data.length; i += 4)
      n += data[i + 3] == 255 && data[i] == r && data[i + 1] == g && data[i + 2] == b;
    return n;
  };
  done([count(0xa5, 0x79, 0x3f), count(0xe0, 0x7b, 0x54)]);
})))"""
"""Pixels of ground and of background noise."""


def test_points_are_turned_and_noise_is_hidden_by_keys(page: Page) -> None:
    still = "document.querySelector('#clip img').checkVisibility()"
    form = "document.querySelector('#clip form').checkVisibility()"
    assert page.ask(still)
    assert not page.ask(form), "nothing begins before a reader asks"
    page.ask("document.querySelector('#clip .start').focus()")
    page.press("Space")
    assert page.ask("document.activeElement.tagName") == "CANVAS"
    assert page.ask(f"[{still}, {form}]") == [False, True]
    ground, noise = page.ask(DRAWN)
    assert min(ground, noise) > 500
    page.press("ArrowRight", times=5)
    assert page.ask(DRAWN) != [ground, noise]
    page.ask("document.querySelector('#clip [name=kind][value=\"2\"]').focus()")
    page.press("Space")
    assert page.ask(DRAWN)[1] == 0
    assert page.ask(DRAWN)[0] >= 500
    assert page.ask("document.querySelector('#clip canvas').dataset.error") == "0"
    page.media("print")
    assert page.ask(f"[{still}, {form}]") == [True, False]


def test_without_webgl_the_still_picture_stays(path: Path, tmp_path: Path) -> None:
    with browser(tmp_path, "--disable-3d-apis") as page:
        page.open(path)
        assert page.ask("document.querySelector('#clip img').checkVisibility()")
        assert not page.ask("document.querySelector('#clip .start').checkVisibility()")


def test_every_control_has_a_name(page: Page) -> None:
    page.ask("document.querySelector('#clip .start').click()")
    named = [
        node["name"]["value"]
        for node in page.accessible()
        if node["role"]["value"]
        in {"application", "button", "checkbox", "image", "link", "radio", "region", "slider"}
    ]
    assert len(named) > 25
    assert all(named)


def test_it_runs_no_other_script_and_asks_for_nothing(page: Page, path: Path) -> None:
    asked = [said for said in page.said if not said.startswith("data:image/png;base64,")]
    assert asked == [path.as_uri()]
    page.ask(
        "document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.ran=1\">')"
    )
    page.ask("new Promise(done => setTimeout(done, 200))")
    assert page.ask("window.ran") is None


def test_a_print_shows_every_map_and_no_buttons(page: Page) -> None:
    page.ask("document.getElementById('zoom-map-x4').click()")
    page.media("print")
    assert page.ask(SHOWN) == ["dtm", "density"]
    assert (
        page.ask("[...document.querySelectorAll('input')].some(i => i.checkVisibility())") is False
    )
    assert width(page, ".dtm img") < 600


def test_it_fits_a_telephone(page: Page, path: Path) -> None:
    page.open(path, width=390, height=800)
    assert page.ask("document.documentElement.scrollWidth") <= 390
    high = page.ask("document.querySelector('#clip .stage').getBoundingClientRect().height")
    assert high > 0.7 * width(page, "#clip .stage"), "points are no narrow strip"


def test_only_what_is_too_wide_for_a_telephone_says_scroll(page: Page, path: Path) -> None:
    page.open(path, width=390, height=800)
    said = page.ask(
        "[...document.querySelectorAll('figure')].map(f => [f.scrollWidth > f.clientWidth || "
        "[...f.querySelectorAll('.sheet')].some(s => s.scrollWidth > f.clientWidth), "
        "getComputedStyle(f.querySelector('figcaption'), '::before').content.includes('Scroll')])"
    )
    assert [True, True] in said
    assert all(wide == told for wide, told in said), said


def test_on_a_telephone_the_button_is_below_the_points(page: Page, path: Path) -> None:
    page.open(path, width=400, height=900)
    assert page.ask(
        "(() => { const b = document.querySelector('.clip .start').getBoundingClientRect();"
        "const i = document.querySelector('.clip img').getBoundingClientRect();"
        "const hint = getComputedStyle(document.querySelector('.clip figcaption'), '::before');"
        "return b.height > 0 && b.top >= i.bottom && hint.content == 'none'; })()"
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read(page: Page, scheme: str) -> None:
    page.media(scheme=scheme)
    colours = page.ask(
        """(() => {
          const behind = e => {
            for (; e; e = e.parentElement) {
              const c = getComputedStyle(e).backgroundColor;
              if (!/, 0\\)$/.test(c)) return c;
            }
          };
          const found = new Set();
          const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
          while (walk.nextNode()) {
            const e = walk.currentNode.parentElement;
            const name = e.tagName + ' ' + e.className;
            if (walk.currentNode.data.trim() && e.tagName != 'STYLE')
              found.add(getComputedStyle(e).color + ' on ' + behind(e) + ' ' + name);
          }
          return [...found];
        })()"""
    )
    assert len(colours) > 20
    for pair in colours:
        text, paper = (_luminance(c) for c in re.findall(r"rgb\([^)]*\)", pair))
        assert (text > paper) == (scheme == "dark") or "LABEL" in pair or "answer" in pair, pair
        low, high = sorted((text, paper))
        assert (high + 0.05) / (low + 0.05) >= 4.5, f"too faint in the {scheme}: {pair}"


def _luminance(colour: str) -> float:
    """Relative luminance of WCAG 2.2."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (int(v) / 255 for v in re.findall(r"\d+", colour)[:3])
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
