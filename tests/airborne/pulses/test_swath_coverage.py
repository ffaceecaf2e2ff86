"""Density and spatial distribution of single swaths, against loops over squares and by hand."""

import json
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.airborne.pulses.pulse_coverage import SPACINGS
from spl_batch.airborne.pulses.swath_coverage import (
    GAP,
    RINGS,
    Swaths,
    by_flightline,
    outlines,
)
from spl_batch.lattice.tiles import Bounds

REACH_Q = 40_000
DEEPEST = 22


def found_in(core: Bounds, x, y, number, there=None, parts: int = 1):
    swaths = Swaths(core, REACH_Q)
    for start in range(parts):
        swaths.add(x[start::parts], y[start::parts], number[start::parts])
    if there is None:
        there = np.ones((1, 1), np.bool_)
    return swaths.facts(there, core)


def test_outlines_of_cells_side_by_side_are_one() -> None:
    # A swath of 60 m that crosses two cells at an angle, and another one that nobody flew.
    rng = np.random.default_rng(3)
    along, across = rng.uniform(0, 380, 60_000), rng.uniform(-30, 30, 60_000)
    x = np.rint((along * 0.8 - across * 0.6 + 40) * 1000).astype(np.int64)
    y = np.rint((along * 0.6 + across * 0.8 + 60) * 1000).astype(np.int64)
    number = np.full(len(x), 7)
    found = []
    for core in (Bounds(0, 0, 200_000, 400_000), Bounds(200_000, 0, 400_000, 400_000)):
        swaths = Swaths(core, REACH_Q)
        swaths.add(x, y, number)
        found.append(swaths.outlines())
    (shape,) = outlines(found, {7: "a", 8: "b"}).values()
    true = shapely.Polygon([(58, 36), (362, 264), (326, 312), (22, 84)])
    assert len(shape.geoms) == 1
    assert shapely.covers(shapely.buffer(shape, 6), true)
    assert shapely.covers(shapely.buffer(true, 9), shape)
    assert len(shapely.get_coordinates(shape)) < 80, "most steps of squares become lines"
    assert outlines([], {7: "a"}) == {}


def by_hand(core: Bounds, x, y) -> list[list[int]]:
    """Loops over squares, each looked at by itself."""
    held = np.unique(np.column_stack([x, y]) // 1000, axis=0)
    low, high = (np.array(core[k : k + 2]) // 1000 + side for k, side in ((0, -41), (2, 42)))
    wide = np.array([(i, j) for i in range(low[0], high[0]) for j in range(low[1], high[1])])
    far = wide[cKDTree(held).query(wide)[0] > GAP]
    covered = (cKDTree(far).query(wide)[0] > GAP) | (cKDTree(held).query(wide)[0] == 0)
    deep = cKDTree(wide[~covered]).query(wide[covered])[0].astype(int) - 1
    depth = dict(zip(map(tuple, wide[covered].tolist()), np.minimum(deep, DEEPEST), strict=True))
    rings = np.zeros((RINGS + 1, 2 + 2 * len(SPACINGS)), int)

    def owned(px: float, py: float) -> bool:
        return core.xmin <= px < core.xmax and core.ymin <= py < core.ymax

    for (i, j), ring in depth.items():
        if owned(i * 1000 + 500, j * 1000 + 500):
            rings[ring, 0] += int(((x // 1000 == i) & (y // 1000 == j)).sum())
            rings[ring, 1] += 1
    for k, spacing in enumerate(SPACINGS.values()):
        edge = 2 * spacing
        filled = set(zip((x // edge).tolist(), (y // edge).tolist(), strict=True))
        for i in range(core.xmin // edge - 1, core.xmax // edge + 2):
            for j in range(core.ymin // edge - 1, core.ymax // edge + 2):
                px, py = i * edge + spacing, j * edge + spacing
                if owned(px, py) and (px // 1000, py // 1000) in depth:
                    ring = depth[px // 1000, py // 1000]
                    rings[ring, 2 + 2 * k] += 1
                    rings[ring, 3 + 2 * k] += (i, j) in filled
    return [[k, *row.tolist()] for k, row in enumerate(rings) if row.any()]


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([40, 300]))
def test_rings_equal_loops(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    west, south = (rng.integers(-30, 30, 2) * 1000).tolist()
    core = Bounds(west, south, west + 20_000, south + 16_500)
    x = rng.integers(west - 12_000, west + 25_000, n)
    y = rng.integers(south - 8_000, south + 40_000, n)
    (line, rings), *more = found_in(core, x, y, np.full(n, 7), parts=3)
    assert (line, more) == (7, [])
    assert rings == by_hand(core, x, y)


def strip(rng, width_m: float, per_m2: float, west_m: float = 0.0) -> tuple[NDArray, NDArray]:
    """Returns of a swath of 300 m from south to north, edges of a tenth of the density."""
    n = rng.poisson(width_m * 300 * per_m2)
    across, along = rng.uniform(0, width_m, n), rng.uniform(0, 300, n)
    rim = np.minimum(across, width_m - across) < 0.02 * width_m
    kept = ~rim | (rng.random(n) < 0.1)
    return tuple((1000 * values[kept]).astype(np.int64) for values in (across + west_m, along))


def facts_of(core: Bounds, cuts: list[int], x, y, number) -> list:
    """What regions side by side found, as receipts have it."""
    edges = [core.xmin, *cuts, core.xmax]
    cores = [core._replace(xmin=a, xmax=b) for a, b in pairwise(edges)]
    return json.loads(json.dumps([found_in(one, x, y, number) for one in cores]))


WHOLE = Bounds(-60_000, -60_000, 360_000, 360_000)
FLOWN = {1: "A", 2: "B"}


def two_strips() -> tuple[NDArray, NDArray, NDArray]:
    rng = np.random.default_rng(3)
    one, other = strip(rng, 200.0, 3.0), strip(rng, 200.0, 1.5, west_m=60.0)
    line = np.repeat([1, 2], [len(one[0]), len(other[0])])
    x, y = (np.concatenate(pair) for pair in zip(one, other, strict=True))
    return x, y, line


def test_each_swath_is_judged_by_its_middle() -> None:
    totals = by_flightline(facts_of(WHOLE, [], *two_strips()), FLOWN, "QL2")
    assert list(totals) == ["A", "B"]
    for swath, per_m2 in zip(totals.values(), (3.0, 1.5), strict=True):
        assert swath.area_m2 == pytest.approx(200 * 300, rel=0.02)
        assert 0.90 < swath.middle_m2 / swath.area_m2 < 0.95
        # 4 % of the swath is a rim of a tenth of its density: the middle knows nothing of it
        assert swath.middle_pulses / swath.middle_m2 == pytest.approx(per_m2, rel=0.01)
        assert swath.pulses / swath.area_m2 < 0.985 * per_m2
        # Poisson: a square of 1.42 m is empty by exp(-its returns)
        full = 1 - np.exp(-per_m2 * 1.42**2)
        assert swath.filled / swath.squares == pytest.approx(full, abs=0.006)


def test_what_does_not_count_is_left_out() -> None:
    x, y, number = two_strips()
    there = np.zeros((2, 1), np.bool_)
    there[1] = True
    core = Bounds(0, 0, 300_000, 300_000)
    half = by_flightline([found_in(core, x, y, number, there)], FLOWN, "QL2")
    whole = by_flightline([found_in(core, x, y, number)], FLOWN, "QL2")
    for name, swath in half.items():
        assert swath.area_m2 == pytest.approx(whole[name].area_m2 / 2, rel=0.001)
