"""The figures of the documentation: what they draw is finite, and files get written."""

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import figures, report_picture
from benchmarks.geiger.water import water_surface
from spl_batch.engine.report import style
from tests.browser import CHROMIUM, needs_chromium


@pytest.mark.pictures
def test_a_figure_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "NULL_DENSITIES", (0.02, 0.05))
    monkeypatch.setattr(figures, "POINTS", 300)
    monkeypatch.setattr(sys, "argv", ["figures", str(tmp_path / "out"), "--only", "null_share"])
    figures.main()
    (written,) = (tmp_path / "out").iterdir()
    content = written.read_bytes()
    assert written.name == "null_share.png"
    assert content.startswith(b"\x89PNG")
    assert 5_000 < len(content) <= figures.LARGEST


def test_the_published_test_is_drawn_above_the_calibrated_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "NULL_DENSITIES", (0.05, 0.13))
    monkeypatch.setattr(figures, "POINTS", 2000)
    with style.type_context():
        (axes,) = figures.null_share(tmp_path).axes
    published, *_, calibrated = (np.asarray(line.get_ydata()) for line in axes.lines)
    assert np.isfinite(published).all()
    assert (published > 10.0).all()
    assert not (calibrated > 1.0).any()


def test_shares_by_threshold_are_those_counted() -> None:
    rng = np.random.default_rng(5)
    score, true = rng.random(4000), rng.random(4000) < 0.5
    lost, removed = figures.by_threshold(score, true, ~true)
    assert np.isfinite(lost).all()
    assert (np.diff(lost) >= 0).all()
    assert removed[-1] == pytest.approx(100.0)
    limit = np.quantile(score[~true], 0.5)
    assert np.interp(50.0, removed, lost) == pytest.approx(
        100.0 * (score[true] >= limit).mean(), abs=1.0
    )


def test_our_rays_end_nearer_than_the_source_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(water_surface, "DISTANCES_M", np.array([2.5, 3.3, 4.1]))
    monkeypatch.setattr(water_surface, "TARGET_FRAMES", 500)
    with style.type_context():
        rays, theirs, ours, _ = water_surface.water_normals(Path(), count=1).axes
    spread = {
        str(line.get_label()): np.hypot(*np.asarray(line.get_data(), dtype=float)).mean()
        for line in rays.lines
    }
    assert spread["ours"] < 0.7 * spread["the source's way"]
    assert spread["ours"] < 0.5 * spread["level surface"]
    errors = [np.nanmean(np.asarray(axes.images[0].get_array())) for axes in (theirs, ours)]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
def test_the_curve_of_afterpulses_lies_below_its_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CANOPIES", "LIGHTS"):
        small = [{**content, "extent_m": [12, 12]} for content in getattr(figures, name)]
        monkeypatch.setattr(figures, name, small)
    with style.type_context():
        panels = figures.afterpulse_curve(tmp_path).axes
    assert len(panels) == 3
    removed = []
    for axes in panels:
        curves = {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}
        assert all(np.isfinite(curve).all() for curve in curves.values())
        best, ours = (
            next(c for name, c in curves.items() if str(name).startswith(word))
            for word in ("best", "ours: what")
        )
        at = np.array([2.0, 4.0, 8.0])
        assert (np.interp(at, *ours.T) < np.interp(at, *best.T) + 2.0).all()
        removed.append(float(np.interp(2.0, *ours.T)))
    even, clumped, easton = removed
    assert clumped > even + 10.0
    assert easton > 75.0


@needs_chromium
def test_a_picture_of_a_report_shows_its_part_alone(tmp_path: Path) -> None:
    def box(colour: str, height: int) -> str:
        return f"<div style='height:{height}px;background:{colour}'></div>"

    page = tmp_path / "report.html"
    page.write_text(
        f"<head></head><body style='margin:0'><header>{box('red', 100)}</header><main>"
        f"<section id=good-enough>{box('lime', 1000)}</section>"
        f"<section id=problems>{box('blue', 1000)}</section></main></body>"
    )
    picture = report_picture.requirements(str(CHROMIUM), page)
    assert picture.size == (960, 1380)
    at = [picture.getpixel((9, y)) for y in (9, 90, 810, 840, 1370)]
    assert at == [(255, 0, 0), (0, 255, 0), (0, 255, 0), *2 * [(255, 255, 255)]]
