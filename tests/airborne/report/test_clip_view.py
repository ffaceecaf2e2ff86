"""The square that can be turned: the delivered points, in one small file that loads nothing."""

import base64
import re
import subprocess
from pathlib import Path

import laspy
import numpy as np
import pytest

from spl_batch.airborne.report import CLIP_PAGE
from spl_batch.airborne.report.clip_view import KINDS, MOST, Clip, render_clip
from spl_batch.engine.report.picture import Picture
from tests.browser import CHROMIUM, needs_chromium

STILL = Picture("profile", "caption", "what it shows", b"\x89PNG", 10, 10)
GPU = ("--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader")


def data(page: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places from 0 to 1, kinds, and extent [m] of a page."""
    found = re.search(r'id="points">([^<]*)<', page)
    count, extent = re.search(r"count = (\d+), extent = \[([^]]*)\]", page).groups()  # type: ignore[union-attr]
    content, n = base64.b64decode(found[1]), int(count)  # type: ignore[index]
    places = np.frombuffer(content, "<u2", 3 * n).reshape(n, 3) / 65_535
    return (
        places,
        np.frombuffer(content, np.uint8, offset=6 * n),
        np.array([float(e) for e in extent.split(",")]),
    )


def test_the_page_holds_the_delivered_points_of_its_square(tiny_output: Path) -> None:
    page = (tiny_output / CLIP_PAGE).read_text(encoding="utf-8")
    assert len(page) < 2e6
    places, kind, extent = data(page)
    west, south = map(int, re.search(r"from (\d+) E, (-?\d+) N", page).groups())  # type: ignore[union-attr]
    clouds = [laspy.read(path) for path in sorted(tiny_output.glob("laz/**/*.laz"))]
    x, y, z, noise, classes = (
        np.concatenate([np.asarray(getattr(cloud, name)) for cloud in clouds])
        for name in ("x", "y", "z", "noise_class", "classification")
    )
    # Corners are told in whole metres: the square reaches half a metre farther at most.
    inside = (abs(x - west - 50) < 50.5) & (abs(y - south - 50) < 50.5)
    low, high = np.percentile(z[inside & (noise == 0)], [0.1, 99.9])
    near = inside & (z >= low - 30.0) & (z <= high + 30.0)
    assert len(kind) == pytest.approx(near.sum(), rel=0.01)
    expected = {
        "ground": (noise == 0) & (classes == 2),
        "other signal": (noise == 0) & (classes != 2),
        "background noise": noise == 1,
        "afterpulses": noise == 2,
    }
    for number, (name, _) in enumerate(KINDS[:4]):
        there = np.sort(z[near & expected[name]])
        shown = np.sort(places[kind == number, 2] * extent[2])
        assert len(shown) == pytest.approx(len(there), rel=0.01), name
        if number == 0:  # heights, from the lowest one on
            lag = np.median(there) - np.median(shown)
            assert np.percentile(shown + lag, [5, 95]) == pytest.approx(
                np.percentile(there, [5, 95]), abs=0.05
            )


def test_the_largest_page_is_small() -> None:
    places = np.random.default_rng(0).uniform(0, 100, (MOST, 3))
    page = render_clip("many", Clip(places, np.zeros(MOST, np.uint8), (0.0, 0.0), 10**7), STILL)
    assert len(page) < 1.6e6
    assert len(data(page)[1]) == MOST
    assert re.search(r"of 10\W000\W000", page)


def test_texts_of_files_are_only_shown() -> None:
    clip = Clip(np.eye(3), np.array([0, 1, 2], np.uint8), (1.0, 2.0), 3)
    page = render_clip("</title><script>alert(1)</script>", clip, STILL)
    assert page.count("<script") == 2  # the data, and our own
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|@import|url\(", page)


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize(("switches", "turns"), [(GPU, "live"), (("--disable-3d-apis",), "")])
def test_a_browser_draws_it_or_shows_the_profile(
    switches: tuple[str, ...], turns: str, tiny_output: Path, tmp_path: Path
) -> None:
    found = subprocess.run(  # noqa: S603
        [
            *(
                str(CHROMIUM),
                "--headless",
                "--no-sandbox",
                f"--user-data-dir={tmp_path}",
                *switches,
            ),
            *("--virtual-time-budget=3000", "--dump-dom", f"file://{tiny_output / CLIP_PAGE}"),
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert ('<body class="live">' in found.stdout) == bool(turns)
    assert ('data-error="0"' in found.stdout) == bool(turns)
