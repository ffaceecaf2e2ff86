"""Planar patches that flightlines share, against a slow oracle, and what they do not depend on."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.lines.patches import (
    MIN_RETURNS_PER_PATCH,
    THICKEST_M,
    Patches,
    find_patches,
    in_fours,
    region,
    squares_of,
)
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests.airborne.lines.two_strips import CORE, Shift, two_strips


def test_moments_are_the_sums_of_the_points_of_each_square() -> None:
    rng = np.random.default_rng(1)
    x, y, z = (rng.integers(0, 60_000, 500).astype(np.int64) for _ in range(3))
    line = rng.choice(np.array([0, 7, 65_535], np.uint16), 500)
    points = PointTable({"x": x + 10_000, "y": y + 10_000, "z": z.astype(np.int32), "line": line})
    squares = squares_of(points, Bounds(20_000, 20_000, 60_000, 40_000))
    for edge, found in ((5_000, squares), (10_000, in_fours(squares))):
        places = zip(found.row.tolist(), found.column.tolist(), found.line.tolist(), strict=True)
        got = dict(zip(places, found.moments.tolist(), strict=True))
        held = set()
        for j, i, number in np.ndindex(20_000 // edge, 40_000 // edge, 3):
            west, south, own = 10_000 + edge * i, 10_000 + edge * j, [0, 7, 65_535][number]
            mine = (line == own) & (x >= west) & (x < west + edge)
            mine &= (y >= south) & (y < south + edge)
            u = x[mine] - (20_000 + 20_000 * (edge * i // 20_000))
            v, w = y[mine] - 20_000, z[mine] - z.min()
            wanted = [len(u), u, v, w, u * u, u * v, v * v, u * w, v * w, w * w]
            if len(u):
                held.add((j, i, own))
                assert got[j, i, own] == [int(np.sum(one)) for one in wanted]
        assert got.keys() == held


def oracle(first: NDArray[Any], second: NDArray[Any]) -> dict[str, float]:
    """Slopes in common and a height of each, by least squares over the points of a square."""
    design = np.zeros((len(first) + len(second), 4))
    design[: len(first), 0] = 1
    design[len(first) :, 1] = 1
    both = np.concatenate([first, second])
    design[:, 2:] = both[:, :2]
    found, *_ = np.linalg.lstsq(design, both[:, 2], rcond=None)
    left = both[:, 2] - design @ found
    square = float(left @ left) / (len(both) - 4)
    covariance = square * np.linalg.inv(design.T @ design)
    along = np.array([-1.0, 1.0, 0.0, 0.0])
    return {
        "rise": found[1] - found[0],
        "east": found[2],
        "north": found[3],
        "variance": float(along @ covariance @ along),
        "ee": covariance[2, 2],
        "en": covariance[2, 3],
        "nn": covariance[3, 3],
        "thickness": math.sqrt(square),
        "returns": len(both),
    }


def test_patches_are_what_least_squares_over_their_points_gives() -> None:
    points = two_strips(Shift(0.2, -0.1, 0.05), per_m2=0.4)
    patches = found_in(points)
    assert set(patches["edge_m"]) == {5.0, 10.0}, "those of 5 m that hold too little are joined"
    x, y, half = patches["x"], patches["y"], patches["edge_m"] / 2
    squares = shapely.union_all(shapely.box(x - half, y - half, x + half, y + half))
    assert squares.area == pytest.approx(np.sum(patches["edge_m"] ** 2)), "none lies in another"
    xyz = np.stack([points[axis] / 1000 for axis in "xyz"], axis=1)
    for k in range(0, len(patches["rise"]), 7):
        half = patches["edge_m"][k] / 2
        middle = np.array([patches["x"][k], patches["y"][k]])
        inside = ((xyz[:, :2] >= middle - half) & (xyz[:, :2] < middle + half)).all(axis=1)
        near = xyz - [*middle, 0]
        sides = [near[inside & (points["line"] == psid)] for psid in (1, 2)]
        for name, value in oracle(*sides).items():
            assert patches[name][k] == pytest.approx(value, rel=1e-5, abs=1e-9), name
        assert min(map(len, sides)) >= MIN_RETURNS_PER_PATCH
        assert patches["thickness"][k] <= THICKEST_M


def test_flightlines_that_overlap_without_patches_are_known() -> None:
    rng = np.random.default_rng(3)
    crowns = two_strips(Shift(), heights=lambda x, _: rng.uniform(0, 12, len(x)))
    apart = two_strips(Shift())
    apart = apart.take((apart["line"] == 1) ^ (apart["x"] > np.median(apart["x"])))
    alone, nothing = apart.take(apart["line"] == 1), apart.take(slice(0, 0))
    for points, met in ((crowns, [[1, 2]]), (apart, []), (alone, []), (nothing, [])):
        found, overlaps = find_patches(points, CORE)
        assert not len(found["rise"])
        assert overlaps.tolist() == met


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_the_order_of_points_does_not_count(seed: int, quarter: int) -> None:
    points = two_strips(Shift(0.1, 0.1, 0.1), per_m2=0.8)
    core = quarters()[quarter]
    wanted = found_in(points, core)
    order = np.random.default_rng(seed).permutation(len(points))
    assert _same(found_in(points.take(order), core), wanted)


def test_cells_part_the_patches_of_a_survey_between_them() -> None:
    points = two_strips(Shift(0.1, 0.1, 0.1), per_m2=0.8)
    whole = found_in(points)
    parts = [_owned(points, core) for core in quarters()]
    joined = {k: np.concatenate([part[k] for part in parts]) for k in whole}
    for found in (whole, joined):
        order = np.lexsort((found["y"], found["x"]))
        found.update({k: v[order] for k, v in found.items()})
    for name in whole:
        assert joined[name] == pytest.approx(whole[name], rel=1e-9, abs=1e-12)


def quarters() -> list[Bounds]:
    """Cells whose edges are no multiple of the largest patch."""
    east, north = CORE.xmin + 33_000, CORE.ymin + 47_000
    columns, rows = (CORE.xmin, east, CORE.xmax), (CORE.ymin, north, CORE.ymax)
    return [
        Bounds(columns[i], rows[j], columns[i + 1], rows[j + 1]) for i in (0, 1) for j in (0, 1)
    ]


def _owned(points: PointTable, core: Bounds) -> dict[str, NDArray[Any]]:
    reads = region(core)
    inside = (points["x"] >= reads.xmin) & (points["x"] < reads.xmax)
    inside &= (points["y"] >= reads.ymin) & (points["y"] < reads.ymax)
    return found_in(points.take(inside), core)


def found_in(points: PointTable, core: Bounds = CORE) -> Patches:
    return find_patches(points, core)[0]


def _same(one: Mapping[str, NDArray[Any]], other: Mapping[str, NDArray[Any]]) -> bool:
    return all(np.array_equal(one[k], other[k]) for k in other)
