"""Planar patches that flightlines share, against a slow oracle, and what they do not depend on."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.strips.patch_moments import add_moments, doubled
from spl_batch.airborne.strips.strip_comparison import _overlaps
from spl_batch.airborne.strips.strip_patches import (
    FEWEST,
    MOST,
    MOST_PASSES,
    THICKEST_M,
    find_passes,
    find_patches,
    region,
)
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests.airborne.strips.two_strips import CORE, Shift, ground, table, two_strips


def test_moments_are_the_sums_of_the_points_of_each_square() -> None:
    rng = np.random.default_rng(1)
    x, y, z = (rng.integers(0, 60_000, 500).astype(np.int64) for _ in range(3))
    strip = rng.integers(0, 3, 500).astype(np.int16)
    corner = np.array([10_000, 10_000, 0], np.int64)
    got = np.zeros((3, 4, 8, 10), np.int64)
    add_moments(x, y, z, strip, corner, 5_000, 4, got)
    for s in range(3):
        for j in range(4):
            for i in range(8):
                west, south = 10_000 + 5_000 * i, 10_000 + 5_000 * j
                mine = (strip == s) & (x >= west) & (x < west + 5_000)
                mine &= (y >= south) & (y < south + 5_000)
                u = x[mine] - (20_000 + 20_000 * (i // 4))
                v, w = y[mine] - 20_000, z[mine]
                wanted = [len(u), u, v, w, u * u, u * v, v * v, u * w, v * w, w * w]
                assert got[s, j, i].tolist() == [int(np.sum(one)) for one in wanted]
    assert np.array_equal(doubled(got)[:, 1, 3], got[:, 2:, 6:].sum(axis=(1, 2)))


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
    passes = find_passes([points], 60.0)
    patches = find_patches([points], passes, CORE)
    assert set(patches["edge_m"]) == {5.0, 10.0}, "those of 5 m that hold too little are joined"
    xyz = np.stack([points[axis] / 1000 for axis in "xyz"], axis=1)
    for k in range(0, len(patches["rise"]), 7):
        half = patches["edge_m"][k] / 2
        middle = np.array([patches["x"][k], patches["y"][k]])
        inside = ((xyz[:, :2] >= middle - half) & (xyz[:, :2] < middle + half)).all(axis=1)
        near = xyz - [*middle, 0]
        sides = [near[inside & (points["point_source_id"] == psid)] for psid in (1, 2)]
        for name, value in oracle(*sides).items():
            assert patches[name][k] == pytest.approx(value, rel=1e-5, abs=1e-9), name
        assert min(map(len, sides)) >= FEWEST
        assert patches["thickness"][k] <= THICKEST_M


def test_no_square_is_used_twice() -> None:
    patches = find_patches(*_passed(two_strips(Shift(), per_m2=0.4)), CORE)
    for k, edge in enumerate(patches["edge_m"]):
        apart = np.maximum(*(np.abs(patches[axis] - patches[axis][k]) for axis in "xy"))
        assert np.count_nonzero(apart < (edge + patches["edge_m"]) / 2 - 1e-6) == 1


def test_flightlines_that_overlap_without_patches_are_known() -> None:
    rng = np.random.default_rng(3)
    crowns = two_strips(Shift(), heights=lambda x, _: rng.uniform(0, 12, len(x)))
    apart = two_strips(Shift())
    apart = apart.take((apart["point_source_id"] == 1) ^ (apart["x"] > np.median(apart["x"])))
    for points, met in ((crowns, {(0, 1)}), (apart, set())):
        overlaps: set[tuple[int, int]] = set()
        found = find_patches(*_passed(points), CORE, overlaps)
        assert not len(found["rise"])
        assert overlaps == met
    flown = {"overlaps": np.array([[0, 1], [1, 2]])}
    assert _overlaps([(["b", "a", "a"], flown)]) == {("a", "b")}, "none with itself"


def test_crowns_and_lone_flightlines_have_no_patches() -> None:
    rng = np.random.default_rng(3)
    crowns = two_strips(Shift(), heights=lambda x, _: rng.uniform(0, 12, len(x)))
    assert not len(find_patches(*_passed(crowns), CORE)["rise"])
    whole = two_strips(Shift())
    alone = whole.take(whole["point_source_id"] == 1)
    assert not len(find_patches(*_passed(alone), CORE)["rise"])
    assert not len(find_patches(*_passed(whole.take(slice(0, 0))), CORE)["rise"])


def test_a_pair_that_shares_much_is_thinned_and_keeps_its_slopes() -> None:
    patches = find_patches(*_passed(two_strips(Shift(), per_m2=4, edge_m=200)), WIDE)
    patches = {name: values[patches["beyond"] == 0] for name, values in patches.items()}
    assert len(patches["rise"]) == MOST


def test_passes_are_parted_by_id_and_by_pauses() -> None:
    time = np.array([5.0, 6.0, 5.5, 300.0, 301.0, np.nan, 5.0, 70.0, 1e9])
    psid = np.array([1, 1, 1, 1, 1, 1, 2, 2, 2])
    points = PointTable(
        {"gps_time": time, "point_source_id": psid.astype(np.uint16), "z": np.zeros(9, np.int32)}
    )
    passes = find_passes([points], 100.0)
    assert passes.of(points).tolist() == [1, 1, 1, 2, 2, 0, 3, 3, 4]
    assert passes.psid.tolist() == [1, 1, 1, 2, 2]
    assert passes.time_s[1:].tolist() == [5.0, 300.0, 5.0, 1e9]
    assert np.isnan(passes.time_s[0])


def test_crumbs_of_passes_cost_nothing_and_change_nothing() -> None:
    lines = two_strips(Shift(0.1, 0.1, 0.1), per_m2=0.8)
    wanted = find_patches(*_passed(lines), CORE)
    # 70 000 passes of one return each, a minute apart, as clocks that jump make them.
    n = 70_000
    rng = np.random.default_rng(4)
    x, y = rng.integers(0, 80_000, (2, n))
    crumbs = {
        "x": x + CORE.xmin, "y": y + CORE.ymin, "z": np.zeros(n, np.int32),
        "gps_time": 1e6 + 100.0 * np.arange(n), "point_source_id": np.full(n, 3, np.uint16),
    }  # fmt: skip
    names = list(crumbs)
    points = PointTable(
        {k: np.concatenate([lines[k], crumbs[k]]).astype(lines[k].dtype) for k in names}
    )
    passes = find_passes([points], 60.0)
    assert len(passes.psid) == n + 2
    assert passes.of(points).max() == n + 1
    assert passes.left_out == 0
    assert _same(find_patches([points], passes, CORE), wanted)


def test_of_many_passes_those_with_most_returns_are_compared() -> None:
    sizes = [2.0, 2.0, *[0.5] * MOST_PASSES]
    many = table([ground(k + 1, Shift(), per_m2=d, edge_m=20) for k, d in enumerate(sizes)])
    passes = find_passes([many], 60.0)
    assert passes.left_out == 2
    patches = find_patches([many], passes, CORE)
    used = {*patches["first"].tolist(), *patches["second"].tolist()}
    returns = passes.returns
    assert used <= set(np.argsort(-returns, kind="stable")[:MOST_PASSES].tolist())
    assert {0, 1} <= used


def test_a_cell_in_strips_has_the_same_patches() -> None:
    points = two_strips(Shift(0.1, 0.0, 0.03), per_m2=1.0)
    timeless = np.arange(len(points)) % 50 == 0
    points = points.with_columns(gps_time=np.where(timeless, np.nan, points["gps_time"]))
    west, east = np.quantile(points["x"], [0.2, 0.7])
    cuts = np.searchsorted([west, east], points["x"], side="right")
    strips = [points.take(cuts == k) for k in range(3)]
    assert min(map(len, strips)) > 0
    whole, parts = find_passes([points], 60.0), find_passes(strips, 60.0)
    for name in ("psid", "time_s", "returns", "lowest"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name), equal_nan=True)
    found = find_patches(strips, parts, CORE)
    assert len(found["rise"])
    assert _same(found, find_patches([points], whole, CORE))


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_the_order_of_points_does_not_count(seed: int, quarter: int) -> None:
    points = two_strips(Shift(0.1, 0.1, 0.1), per_m2=0.8)
    core = quarters()[quarter]
    wanted = find_patches(*_passed(points), core)
    order = np.random.default_rng(seed).permutation(len(points))
    assert _same(find_patches(*_passed(points.take(order)), core), wanted)


def test_cells_part_the_patches_of_a_survey_between_them() -> None:
    points = two_strips(Shift(0.1, 0.1, 0.1), per_m2=0.8)
    whole = find_patches(*_passed(points), CORE)
    parts = [_owned(points, core) for core in quarters()]
    joined = {k: np.concatenate([part[k] for part in parts]) for k in whole}
    for found in (whole, joined):
        order = np.lexsort((found["y"], found["x"]))
        found.update({k: v[order] for k, v in found.items()})
    for name in whole:
        assert joined[name] == pytest.approx(whole[name], rel=1e-9, abs=1e-12)


WIDE = Bounds(CORE.xmin, CORE.ymin, CORE.xmin + 200_000, CORE.ymin + 200_000)


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
    return find_patches(*_passed(points.take(inside)), core)


def _passed(points: PointTable) -> tuple[list[PointTable], Any]:
    return [points], find_passes([points], 60.0)


def _same(one: Mapping[str, NDArray[Any]], other: Mapping[str, NDArray[Any]]) -> bool:
    return all(np.array_equal(one[k], other[k]) for k in other)


def test_the_scene_is_what_its_shift_says() -> None:
    points = table([ground(1, Shift()), ground(2, Shift(0, 0, 5.0))])
    height = [points["z"][points["point_source_id"] == psid].mean() for psid in (1, 2)]
    assert height[1] - height[0] == pytest.approx(5000, abs=100)
