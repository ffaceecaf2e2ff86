"""The square that can be turned: the delivered points, small, and no script but our own."""

import base64
import hashlib
import io
import re
from html import unescape
from pathlib import Path

import laspy
import numpy as np
import pytest
from PIL import Image

from spl_batch.airborne.report.clip_view import KINDS, MOST, Clip, view_of
from spl_batch.airborne.report.survey_page import render
from tests.report_data import make_report


def data(page: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places from 0 to 1, kinds, and extent [m] of a page."""
    packed = re.search(r'id="clip-points">([^<]*)<', page)[1]  # type: ignore[index]
    count = int(re.search(r'data-count="(\d+)"', page)[1])  # type: ignore[index]
    extent = re.search(r'data-extent="\[([^]]*)\]"', page)[1]  # type: ignore[index]
    content = base64.b64decode(packed)
    places = np.frombuffer(content, "<u2", 3 * count).reshape(count, 3) / 65_535
    return (
        places,
        np.frombuffer(content, np.uint8, offset=6 * count),
        np.array([float(e) for e in extent.split(",")]),
    )


def test_the_page_holds_the_delivered_points_of_its_square(tiny_output: Path) -> None:
    page = (tiny_output / "report.html").read_text(encoding="utf-8")
    places, kind, extent = data(page)
    corner = re.search(r"from ([^<]+?) E, ([^<]+?) N, around", page).groups()  # type: ignore[union-attr]
    west, south = (int(re.sub(r"\s", "", told)) for told in corner)
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


def test_the_largest_square_is_small() -> None:
    places = np.random.default_rng(0).uniform(0, 100, (MOST, 3))
    view = view_of(Clip(places, np.zeros(MOST, np.uint8), (0.0, 0.0), 10**7))
    assert len(view.packed) + len(view.still.data_uri) < 2e6
    assert len(base64.b64decode(view.packed)) == 7 * MOST
    assert re.search(r"of 10\W000\W000", view.still.caption)


def test_the_still_picture_shows_what_is_nearest() -> None:
    toward = np.array([-np.sin(0.5) * np.sin(1.1), -np.cos(0.5) * np.sin(1.1), np.cos(1.1)])
    along = np.arange(-40, 41)
    kind = np.where(along == 40, 1, 0).astype(np.uint8)
    for order in (slice(None), slice(None, None, -1)):
        clip = Clip((50.0 + along[:, None] * toward)[order], kind[order], (0.0, 0.0), 81)
        drawn = np.asarray(Image.open(io.BytesIO(view_of(clip).still.png)))
        assert drawn[400, 800] == 2
        assert np.count_nonzero(drawn == 1) < 9, "but for rounding it hides all others"


def test_the_page_runs_our_script_alone() -> None:
    clip = Clip(np.eye(3), np.array([0, 1, 2], np.uint8), (1.0, 2.0), 3)
    evil = "</title><script>alert(1)</script>"
    survey = make_report().survey.model_copy(update={"name": evil})
    page = render(make_report(survey=survey), {}, clip)
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", page, re.DOTALL)
    assert [kind for kind, _ in scripts] == [' type="text/plain" id="clip-points"', ""]
    named = base64.b64encode(hashlib.sha256(scripts[1][1].encode()).digest()).decode()
    policy = unescape(re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1])  # type: ignore[index]
    assert policy == (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{named}'"
    )
    assert not re.search(r"https?://|@import|url\(", page)
