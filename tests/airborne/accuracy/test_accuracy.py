"""Differences to a reference and their statistics."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import median_abs_deviation

from spl_batch.airborne.accuracy import differences
from spl_batch.airborne.accuracy.differences import (
    difference_sums,
    ground_differences,
    return_differences,
    surface_differences,
    terrain_differences,
)
from spl_batch.airborne.accuracy.error_tally import (
    STEPS_PER_M,
    Tally,
    accuracy_report,
    add_up,
    tallies,
)
from spl_batch.airborne.accuracy.raster_and_reference import Raster, Reference
from spl_batch.formats.rasters.parts import Grid
from spl_batch.numerics.error_statistics import STATISTICS, statistics

errors = arrays(np.float64, st.integers(1, 60), elements=st.floats(-1e3, 1e3))


@given(errors)
def test_statistics_equal_those_of_numpy_and_scipy(d):
    s = statistics(d)
    assert tuple(s) == STATISTICS
    assert s["n"] == len(d)
    assert s["mean"] == pytest.approx(np.mean(d), abs=1e-9)
    assert s["median"] == pytest.approx(np.median(d))
    assert s["rmse"] == pytest.approx(np.sqrt(np.square(d).sum() / len(d)))
    assert s["nmad"] == pytest.approx(median_abs_deviation(d, scale="normal"), rel=1e-4, abs=1e-9)
    assert s["p95"] == pytest.approx(np.quantile(abs(d), 0.95))
    assert (s["min"], s["max"]) == (d.min(), d.max())
    if len(d) == 1:
        assert s["sd"] is None
    else:
        assert s["sd"] ** 2 == pytest.approx(np.var(d, ddof=1), rel=1e-6, abs=1e-6)


def test_no_differences_give_nulls_and_what_is_not_finite_is_left_out():
    assert statistics(np.array([])) == dict.fromkeys(STATISTICS) | {"n": 0}
    assert statistics(np.array([np.nan, np.inf])) == dict.fromkeys(STATISTICS) | {"n": 0}
    assert statistics(np.array([np.nan, 2.0], np.float32))["mean"] == 2.0


def bumpy(rows=30, cols=40, cell_m=2.0):
    rng = np.random.default_rng(0)
    values = rng.normal(50, 3, (rows, cols)).astype(np.float32)
    return Raster(values, 1000.0, 5000.0, cell_m)


def test_bilinear_equals_scipys_grid_interpolator():
    raster = bumpy()
    rows, cols = raster.values.shape
    north = 5000 - (np.arange(rows) + 0.5) * 2
    east = 1000 + (np.arange(cols) + 0.5) * 2
    oracle = RegularGridInterpolator(
        (north[::-1], east), raster.values[::-1].astype(float), bounds_error=False
    )
    rng = np.random.default_rng(1)
    xy = np.stack([rng.uniform(990, 1090, 3000), rng.uniform(4930, 5010, 3000)], axis=1)
    corners = np.array([[e, n] for e in (east[0], east[-1]) for n in (north[0], north[-1])])
    xy = np.concatenate([xy, corners])
    got = raster.bilinear(xy)
    np.testing.assert_allclose(got, oracle(xy[:, ::-1]), atol=1e-9)
    assert np.isfinite(got[-4:]).all()
    assert np.isnan(got).any()


def flat(value, size=40):
    return Raster(np.full((size, size), value, np.float32), 0.0, float(size), 1.0)


def reference(*groups, counted=None):
    """Reference of (class, [[x, y, z], ...]) groups."""
    xyz = np.concatenate([np.asarray(points, float) for _, points in groups])
    kinds = np.repeat([kind for kind, _ in groups], [len(points) for _, points in groups])
    return Reference(xyz, kinds.astype(np.uint8), counted)


GROUND = [[10, 10, 5.0], [14.5, 10, 5.0], [20, 10, 5.0], [30, 10, 5.0], [36, 30, 5.0]]


def test_terrain_differences_by_what_stands_on_the_ground():
    ref = reference(
        (2, GROUND),
        (5, [[10.5, 10, 9.0]]),  # a tree over the first
        (1, [[15.0, 10, 5.3]]),  # grass at the second
        (6, [[21.5, 10, 11.0]]),  # a roof beside the third
        (18, [[30, 10, 80.0]]),  # noise over the fourth
    )
    dtm = flat(0.0)
    dtm.values[:] = (5 + 0.001 * np.arange(40))[None, :]
    d = terrain_differences(dtm, ref)
    x = np.array(GROUND)[:, 0]
    expected = (0.001 * (x - 0.5)).astype(np.float32)
    np.testing.assert_allclose(d["all"], expected, atol=2e-6)
    np.testing.assert_allclose(d["open_ground"], expected[[1, 3, 4]], atol=2e-6)
    np.testing.assert_allclose(d["under_canopy"], expected[[0]], atol=2e-6)
    assert len(d["slope_0_5"]) == 5
    assert len(d["slope_15_30"]) == 0


@given(st.integers(0, 2**32), st.sampled_from([0.5, 3.0, 40.0, 4000.0]), st.booleans())
def test_what_is_near_is_what_all_distances_say(seed, extent_m, on_lattice):
    random = np.random.default_rng(seed)
    points, others = (random.uniform(0, extent_m, (n, 3)) for n in random.integers(0, 60, 2))
    if on_lattice:  # ties, and distances of exactly the radius
        points, others = np.round(points * 2) / 2, np.round(others * 2) / 2
    apart = np.hypot(*(points[:, None, :2] - others[None, :, :2]).transpose(2, 0, 1))
    for radius_m in (1.0, 2.0):
        expected = (apart < radius_m).any(axis=1)
        assert np.array_equal(differences._near(points, others, radius_m), expected)


def test_ground_that_the_terrain_cuts_off_is_open_ground_that_is_wrong():
    ref = reference((2, GROUND))
    dtm, chm = flat(5.2), flat(0.0)
    dtm.values[40 - 1 - 10, 30] -= 4.0
    chm.values[40 - 1 - 10, 30] += 4.0
    at_ground_m = np.array([0.2, 0.2, -3.8, 0.2, 0.2])
    d = terrain_differences(dtm, ref, chm=chm, at_ground_m=at_ground_m)
    assert len(d["open_ground"]) == 5
    chm.values[40 - 1 - 10, 30] += 1.0
    d = terrain_differences(dtm, ref, chm=chm, at_ground_m=at_ground_m)
    assert len(d["open_ground"]) == 4


def same(one, other):
    """Whether two tallies count the same."""
    return (
        one.steps.tolist() == other.steps.tolist() and one.counts.tolist() == other.counts.tolist()
    )


@given(st.lists(errors, min_size=1, max_size=4))
def test_a_tally_says_what_its_errors_say(parts):
    total = add_up({"all": Tally.of(part)} for part in parts)["all"]
    every = np.concatenate(parts)
    assert same(total, Tally.of(every))
    said, exact = statistics(total.errors_m, total.counts), statistics(every)
    assert said["n"] == exact["n"] == total.n
    for key in ("mean", "median", "rmse", "min", "max", "p95"):
        assert said[key] == pytest.approx(exact[key], abs=0.6 / STEPS_PER_M)
    assert said["nmad"] == pytest.approx(exact["nmad"], abs=1.2 * 1.4826 / STEPS_PER_M)
    rounded = np.sort(np.rint(every * STEPS_PER_M)) / STEPS_PER_M
    np.testing.assert_array_equal(total.sample_m(100_000), rounded.astype(np.float32))
    few = total.sample_m(7)
    assert len(few) <= 7
    assert few[0] == np.float32(rounded[0])


def test_differences_of_chunks_with_margins_merge_into_those_of_the_whole():
    rng = np.random.default_rng(6)
    xyz = np.stack([rng.uniform(1, 39, 800), rng.uniform(1, 39, 800), rng.normal(5, 2, 800)], 1)
    kinds = rng.choice([2, 2, 5, 6], 800).astype(np.uint8)
    xyz[kinds == 2, 2] = rng.normal(5, 0.05, (kinds == 2).sum())
    whole = terrain_differences(flat(5.0), Reference(xyz, kinds))
    parts = []
    for low, high in ((0, 17), (17, 40)):
        near = (xyz[:, 0] > low - 8) & (xyz[:, 0] < high + 8)
        own = (xyz[:, 0] >= low) & (xyz[:, 0] < high)
        parts.append(terrain_differences(flat(5.0), Reference(xyz[near], kinds[near], own[near])))
    merged = add_up(map(tallies, parts))
    assert set(merged) == set(whole)
    for name, values in whole.items():
        assert same(merged[name], Tally.of(values))
    assert 0 < len(whole["open_ground"]) < len(whole["all"])


def test_surface_differences_use_the_highest_reference_point_of_each_cell():
    roof = [[x + 0.5, y + 0.5, 12.0] for x in range(10, 15) for y in range(10, 15)]
    ref = reference(
        (6, roof),
        (2, [[10.6, 10.6, 3.0], [30.5, 30.5, 3.0]]),
        (1, [[10.7, 10.6, 11.0], [20.6, 20.6, 9.0], [20.5, 20.5, 8.0]]),
        (9, [[5.5, 5.5, 2.0]]),
        # Of two as high the larger class counts, whichever comes first.
        (6, [[25.5, 25.5, 7.0], [27.5, 27.5, 7.0]]),
        (2, [[25.6, 25.5, 7.0]]),
        (9, [[27.6, 27.5, 7.0]]),
        # A higher class does not make up for height.
        (6, [[30.5, 30.6, 1.0]]),
        (7, [[5.6, 5.6, 90.0]]),
    )
    d = surface_differences(flat(12.5), ref)
    assert {k: len(v) for k, v in d.items()} == {
        "all": 30,
        "ground": 1,
        "water": 2,
        "building": 9,
        "building_edge": 17,
        "vegetation": 1,
    }
    assert (d["building"] == 0.5).all()
    assert d["vegetation"] == [3.5]
    assert d["ground"] == [9.5]
    assert sorted(d["water"]) == [5.5, 10.5]


def test_nothing_to_compare_gives_nulls_that_json_can_hold():
    empty = Reference(np.empty((0, 3)), np.empty(0, np.uint8))
    report = accuracy_report(
        tallies(terrain_differences(flat(1.0), empty)),
        tallies(surface_differences(flat(1.0), empty)),
    )
    json.dumps(report.model_dump(), allow_nan=False)
    assert report.dtm["all"].n == 0
    assert report.bias_m is None
    assert accuracy_report({}, {}).dsm["all"].rmse is None


def test_the_bias_is_reported_and_removed_on_request_only():
    rng = np.random.default_rng(2)
    dtm = {k: Tally.of(1.5 + 0.08 * rng.standard_normal(4000)) for k in ("all", "open_ground")}
    dsm = {"all": Tally.of(np.full(3, 2.0))}
    kept = accuracy_report(dtm, dsm)
    assert not kept.bias_removed
    assert kept.dtm["all"].mean == pytest.approx(1.5, abs=0.02)
    removed = accuracy_report(dtm, dsm, remove_bias=True)
    assert removed.bias_removed
    assert removed.bias_m == pytest.approx(1.5, abs=0.02)
    assert removed.dtm["open_ground"].median == pytest.approx(0, abs=1e-6)
    assert removed.dsm["all"].mean == pytest.approx(2 - removed.bias_m)


def test_sums_of_differences_are_those_of_each_cell_and_free_of_slope():
    y, x = np.mgrid[0:20, 0:20]
    plane = (2 * (x + 0.5) - (y + 0.5)).astype(np.float32)
    dtm = Raster(plane, 0.0, 20.0, 1.0)
    rng = np.random.default_rng(3)
    e, n = rng.uniform(1, 19, 500), rng.uniform(1, 19, 500)
    ref = reference((2, np.stack([e, n, 2 * e - (20 - n) - 0.25], axis=1)), (5, [[3, 3, 99]]))
    grid = Grid(10, 10, 0.0, 20.0, 2.0)
    cell, total, count = difference_sums(ground_differences(dtm, ref), ref, grid)
    np.testing.assert_allclose(total / count / STEPS_PER_M, 0.25, atol=1e-4)
    row, col, _ = grid.cells(ref.xyz_m[:500, :2])
    assert cell.tolist() == sorted({10 * r + c for r, c in zip(row, col, strict=True)})
    assert count.sum() == 500
    half = Reference(ref.xyz_m, ref.classification, np.arange(501) < 250)
    assert difference_sums(ground_differences(dtm, half), half, grid)[2].sum() == 250


def test_kept_returns_are_compared_with_the_nearest_ground_and_roof_that_is_near() -> None:
    reference = Reference(
        np.array([[0.0, 0, 10], [1, 0, 10], [5, 0, 20], [5.1, 0, 90]]),
        np.array([2, 2, 6, 7], np.uint8),
        np.zeros(4, np.bool_),  # those of the margin count as well
    )
    kept = np.array([[0.1, 0, 10.2], [0.9, 0.1, 9.9], [5, 0, 20.3], [5, 0, 21], [3, 0, 10]])
    (found,) = return_differences([kept], reference)
    np.testing.assert_allclose(found["ground"], [0.2, -0.1], atol=1e-6)
    np.testing.assert_allclose(found["building"], [0.3], atol=1e-6)
