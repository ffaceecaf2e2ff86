"""What a reader does with the page in a browser: choose a map, come nearer, read it in the dark."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from spl_batch.airborne.report.pictures import make_pictures
from spl_batch.airborne.report.survey_page import render
from tests.browser import Page, browser, needs_chromium
from tests.report_data import make_failures, make_inputs, make_report

pytestmark = [pytest.mark.slow, needs_chromium]

SHOWN = (
    "[...document.querySelectorAll('.layers figure')]"
    ".filter(f => f.checkVisibility()).map(f => f.className)"
)
FOCUS = "document.activeElement.id || document.activeElement.className"


RESTING = """new Promise(done => {
  let last = -1;
  const timer = setInterval(() => {
    const now = document.activeElement.scrollLeft;
    if (now > 0 && now == last) { clearInterval(timer); done(now); }
    last = now;
  }, 400);
})"""
"""Where an element has scrolled to, once it stands still."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    inputs = make_inputs()
    rasters = {name: inputs["rasters"][name] for name in ("dtm", "density")}
    failed = make_failures()[1].model_copy(
        update={"extent_m": (500_100.0, 500_200.0, 3_300_000.0, 3_300_100.0)}
    )
    report = make_report(failures=(failed,))
    made = tmp_path_factory.mktemp("page") / "report.html"
    made.write_text(
        render(report, make_pictures(rasters, report, inputs["profile"])), encoding="utf-8"
    )
    return made


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("profile")) as opened:
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
    assert page.ask(FOCUS) == "pan"
    page.press("ArrowRight", times=3)
    place = page.ask(RESTING)
    assert place > 0
    # The other map shows the same place.
    page.ask("document.getElementById('layer-dtm').click()")
    assert page.ask(SHOWN) == ["dtm"]
    assert page.ask("document.querySelector('.layers .pan').scrollLeft") == place
    assert width(page, "#map figure.wide img") < 1100, "the profile has a size of its own"


def told(page: Page) -> list[tuple[str, str, str]]:
    """Role, name and description of all that a screen reader stops at, in its order."""
    return [
        tuple(node.get(key, {}).get("value", "") for key in ("role", "name", "description"))  # type: ignore[misc]
        for node in page.accessible()
    ]


CONTROLS = {"application", "button", "checkbox", "figure", "form", "heading", "image", "link",
            "radio", "region", "slider", "table"}  # fmt: skip


def test_every_control_has_a_name(page: Page) -> None:
    named = [(role, name) for role, name, _ in told(page) if role in CONTROLS]
    assert len(named) > 50
    assert [pair for pair in named if not pair[1]] == []
    radios = [name for role, name in named if role == "radio"]
    assert len(set(radios)) == len(radios), "who hears one knows what it is of"
    stops = page.ask(
        "[...document.querySelectorAll('[tabindex]')].filter(e => e.checkVisibility())"
        ".filter(e => !e.getAttribute('role') || !e.getAttribute('aria-label')).length"
    )
    assert stops == 0


def test_it_runs_no_script_and_asks_for_nothing(page: Page, path: Path) -> None:
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
