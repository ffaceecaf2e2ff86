"""Floors that lean within a cell: the layer that shows them, their line, where they are lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.altimetry.ground.lost_floor import LostFloor, lost_floor
from spl_batch.altimetry.report.beam_warnings import floor_said
from spl_batch.altimetry.water.leaning_floor import (
    Below,
    bed,
    depths_of,
    leaning_floor,
    leaning_layers,
)

CELL_M = 20.0


def fullest_beyond(x: np.ndarray, depth: np.ndarray, noise: np.ndarray) -> float:
    """Most photons that a layer of a metre holds beyond what it needs, slope by slope."""
    best = 0.0
    for slope in np.arange(-10, 11) / 10.0:
        half = abs(slope) * CELL_M / 2.0 + 0.5
        bins = np.floor((depth - slope * x) * 2.0)
        for b in np.unique(np.concatenate([bins, bins - 1])):
            low, high = np.floor((b + 1) / 2.0 - half), np.ceil((b + 1) / 2.0 + half)
            passed = noise[int(max(low, 0)) : int(min(high, len(noise)))]
            if len(passed):
                held = np.count_nonzero((bins == b) | (bins == b + 1))
                best = max(best, held - passed.mean() - 4.0 * np.sqrt(passed.mean()) - 2.0)
    return best


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(-0.9, 0.9), st.integers(0, 12))
def test_the_layer_of_a_cell_is_the_fullest_beyond_noise(
    seed: int, slope: float, photons: int
) -> None:
    rng = np.random.default_rng(seed)
    noise = np.sort(rng.uniform(0.01, 0.8, 30))[::-1].copy()
    x = rng.uniform(-10.0, 10.0, photons + 15)
    depth = np.where(np.arange(len(x)) < photons, 15.2 + slope * x, rng.uniform(0.0, 30.0, len(x)))
    out = np.empty((1, 3))
    leaning_layers(x, depth, np.array([0, len(x)]), noise[None], CELL_M, out)
    expected = fullest_beyond(x, depth, noise)
    assert np.nan_to_num(out[0, 2]) == pytest.approx(expected, abs=1e-9)
    if photons == 12 and out[0, 2] > 6.0:
        assert out[0, :2] == pytest.approx([15.2, slope], abs=1.0)


def drawn(depth_m: np.ndarray, per_cell: int, seed: int = 1) -> Below:
    """Photons of a floor through the ends of cells, and as many of noise."""
    rng = np.random.default_rng(seed)
    n = len(depth_m) - 1
    cell = np.repeat(np.arange(n), 2 * per_cell)
    x = rng.uniform(-10.0, 10.0, len(cell))
    floor = np.arange(len(cell)) % 2 == 0
    line = np.interp(cell + 0.5 + x / CELL_M, np.arange(n + 1.0), depth_m)
    line += rng.normal(0.0, 0.15, len(cell))
    depth = np.where(floor, line, rng.uniform(0.0, 59.0, len(cell)))
    return Below(np.arange(n), cell, x, depth)


def test_a_steep_floor_is_followed_and_noise_is_not() -> None:
    depth = 15.0 + 10.0 * np.sin(np.arange(41.0))
    photons = drawn(depth, 9)
    noise = np.full((40, 59), 9.0 / 59.0)
    line = leaning_floor(photons, noise, CELL_M)
    known = np.isfinite(line[:, 0])
    assert known.mean() > 0.9
    middle = (depth[1:] + depth[:-1]) / 2.0
    assert np.abs(line[known, 0] - middle[known]).max() < 1.0
    passed = depths_of(line, 59, CELL_M)
    assert passed[known, np.floor(middle[known]).astype(int)].all()
    assert not passed[~known].any()
    # The line joins the cells, but where the floor has a step.
    ends = bed(photons.number, line.astype(np.float32), CELL_M)
    step = np.abs(ends[1:, 0] - ends[:-1, 1])
    assert ((step == 0.0) | (step > 1.0)).all()
    assert (step == 0.0).mean() > 0.7
    assert np.median(np.abs(ends[:, 0] - depth[:-1])) < 0.5
    strewn = photons._replace(
        depth_m=np.random.default_rng(2).uniform(0.0, 59.0, len(photons.cell))
    )
    assert np.isfinite(leaning_floor(strewn, 2.0 * noise, CELL_M)[:, 0]).mean() < 0.1


def test_nothing_follows_a_floor_that_is_far() -> None:
    index = np.array([0, 1, 400, 505, 2000, 2600, 3000])
    line = np.full((7, 2), np.nan, np.float32)
    line[1], line[6] = (-5.0, 0.1), (-8.0, 0.0)
    ends = bed(index, line, CELL_M)
    assert ends[1] == pytest.approx([-6.0, -4.0])
    assert ends[0] == pytest.approx([-6.0, -6.0])
    assert ends[2] == pytest.approx([-4.0, -4.0])
    assert (ends[3:5] == 0.0).all()
    assert ends[5] == pytest.approx([-8.0, -8.0])


def test_a_floor_is_lost_where_it_lies_or_is_seen_on_both_sides() -> None:
    cell = np.arange(100, 200)
    found = np.isin(cell, [110, 120, 150, 190])
    lost = lost_floor(cell, found, np.array([180, 5]), CELL_M)
    # 111 to 119; 180 to 189, as 180 shows it. Between 120, 150 and 180 no cell is near both.
    near_both = [
        c for c in range(121, 180) if any(c - a <= 25 >= b - c for a, b in GAPS if a < c < b)
    ]
    assert lost == LostFloor(9 + len(near_both) + 10, 4, 2220.0, 3800.0)
    assert lost_floor(cell, found & False, np.array([5]), CELL_M).lost == 0


GAPS = ((120, 150), (150, 180))


@pytest.mark.parametrize(
    ("lost", "found", "said"), [(9, 1, False), (10, 39, True), (10, 50, False)]
)
def test_afloor_said_is_said_with_its_place(lost: int, found: int, *, said: bool) -> None:
    sentences = list(floor_said(LostFloor(lost, found, 1200.0, 3400.0)))
    assert bool(sentences) == said
    if said:
        assert "between 1.2 and 3.4 km the floor is lost in 10 of 49" in sentences[0]
