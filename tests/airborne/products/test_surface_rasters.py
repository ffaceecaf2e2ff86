"""Rasters of a ground cell, and the delivered classes."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import poisson

from spl_batch.airborne.classes.point_classes import classify
from spl_batch.airborne.products.product_table import PRODUCTS
from spl_batch.airborne.products.surface_rasters import reach_m, surfaces
from spl_batch.airborne.products.top_surface import lift_pits, support_of
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, inside

SETTINGS = ProductSettings(void_max_m=5.0)
CELL = Bounds(-20_000, 40_000, 0, 60_000)


def table_of(xyz_m, **columns):
    """Points in metres with the columns that the stage reads; signal unless told otherwise."""
    xyz = np.rint(np.asarray(xyz_m, dtype=float).reshape(-1, 3) * 1000)
    n = len(xyz)
    given_ = {
        "noise_class": 0,
        "ground": 0,
        "intensity": 100,
        "return_number": 1,
        "flags": 0,
        "input_class": 0,
    } | columns
    table = PointTable({})
    return table.with_columns(
        x=xyz[:, 0],
        y=xyz[:, 1],
        z=xyz[:, 2],
        **{k: np.broadcast_to(v, n) for k, v in given_.items()},
    )


def terrain(seed=0, density=6.0, noise=0.0, around=20.0):
    """Sloped ground over the cell and a margin."""
    rng = np.random.default_rng(seed)
    west, south, east, north = (edge / 1000 for edge in CELL)
    n = rng.poisson(density * (east - west + 2 * around) * (north - south + 2 * around))
    x = rng.uniform(west - around, east + around, n)
    y = rng.uniform(south - around, north + around, n)
    return np.stack([x, y, 100 + 0.5 * x - 0.2 * y + rng.normal(0, noise, n)], axis=1)


def centres():
    """Coordinates of cell centres, north up [m]."""
    x, y = np.meshgrid(np.arange(-20, 0) + 0.5, np.arange(40, 60)[::-1] + 0.5)
    return x, y


def test_the_dtm_of_a_plane_is_the_plane_north_up():
    rasters = surfaces(table_of(terrain(), ground=1), CELL, SETTINGS, 0.05)
    x, y = centres()
    np.testing.assert_allclose(rasters["dtm"], 100 + 0.5 * x - 0.2 * y, atol=0.002)
    assert set(rasters) == {product.name for product in PRODUCTS} - {"noise"}
    assert all(r.shape == (20, 20) and r.dtype == np.float32 for r in rasters.values())


def test_density_and_intensity_are_those_of_a_plain_loop():
    points = terrain(density=1.5)
    rng = np.random.default_rng(2)
    table = table_of(
        points,
        intensity=rng.integers(0, 60_000, len(points)),
        return_number=rng.integers(1, 3, len(points)),
        noise_class=rng.choice([0, 0, 0, 1, 2], len(points)),
    )
    rasters = surfaces(table, CELL, SETTINGS, 0.05)
    signal = table["noise_class"] == 0
    for row in range(20):
        for col in range(20):
            here = signal & (table["x"] // 1000 == col - 20) & (table["y"] // 1000 == 59 - row)
            assert rasters["density"][row, col] == here.sum()
            first = here & (table["return_number"] == 1)
            counted = first if first.any() else here
            mean = table["intensity"][counted].mean() if here.any() else NODATA
            assert rasters["intensity"][row, col] == pytest.approx(mean, rel=1e-6)
    without = surfaces(
        table.select([n for n in table.columns if n != "intensity"]), CELL, SETTINGS, 0.05
    )
    assert without.keys() == rasters.keys() - {"intensity"}
    assert np.array_equal(without["density"], rasters["density"])


def test_the_dsm_is_the_highest_confirmed_return_and_never_below_the_dtm():
    ground = terrain(density=8)
    roof = np.stack(
        [g.ravel() for g in np.meshgrid(np.arange(-15, -10, 0.25), np.arange(45, 50, 0.25))]
        + [np.full(400, 120.0)],
        axis=1,
    )
    spike = [[-5.5, 50.5, 150.0]]
    low = [[-8.5, 52.5, 50.0], [-8.4, 52.5, 50.0], [-8.5, 52.4, 50.0]]
    table = table_of(
        np.concatenate([ground, roof, spike, low]),
        ground=np.repeat([1, 0], [len(ground), len(roof) + 4]),
    )
    rasters = surfaces(table, CELL, SETTINGS, 0.05)
    x, y = centres()
    on_roof = (x > -15) & (x < -10) & (y > 45) & (y < 50)
    assert (rasters["dsm"][on_roof] == 120).all()
    assert rasters["dsm"].max() == 120
    assert (rasters["dsm"] >= rasters["dtm"]).all()
    np.testing.assert_allclose(rasters["chm"], rasters["dsm"] - rasters["dtm"], atol=2e-5)


@pytest.mark.parametrize("least", [0, 1, 3])
def test_support_is_the_smallest_count_that_noise_reaches_rarely_enough(least):
    asked = SETTINGS.model_copy(update={"dsm_support": least, "dsm_false_alarm": 1e-4})
    noise = np.array([0.0, 0.3, 0.3, 1e-4, 0.02, 2.5, 40.0])
    found = support_of(noise, asked)
    for which, per_m3 in zip(found.noise, noise, strict=True):
        for radius, needed in zip(found.radius, found.needed[which], strict=True):
            expected = 4 / 3 * np.pi * per_m3 * (radius / 1000) ** 3
            passing = (k for k in range(least, 999) if poisson.sf(k - 1, expected) <= 1e-4)
            assert needed == (next(passing) if least else 0)


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(("expected", "top"), [(None, 12.0), (1e-8, 12.0), (0.5, 10.0)])
def test_the_noise_that_is_expected_at_the_returns_of_a_cell_decides_how_many_confirm(
    expected, top, order
):
    """Two returns above one another stand out of a floor where hardly any noise is expected."""
    rng = np.random.default_rng(7)
    floor = np.column_stack([rng.uniform((-40, 20), (20, 80), (14_000, 2)), np.full(14_000, 10.0)])
    table = table_of(np.concatenate([floor, [[-9.5, 50.5, 12.0], [-9.5, 50.5, 11.9]]]))
    if expected is not None:
        density = np.full(len(table), 1e-9, np.float32)
        density[-2:], density[-3] = (expected, np.nan), np.nan
        table = table.with_columns(noise_density=density)
        # The most counts, not the last.
        table = table.take(np.arange(len(table))[::order])
    dsm = surfaces(table, CELL, SETTINGS, 0.05)["dsm"]
    assert dsm[60 - 51, 20 - 10] == pytest.approx(top, abs=0.11)
    assert np.delete(dsm, (60 - 51) * 20 + 20 - 10).max() == pytest.approx(10.0)


def test_pits_are_lifted_as_in_a_plain_loop():
    rng = np.random.default_rng(4)
    shape = (29, 31)
    start = np.concatenate([[0], np.cumsum(rng.integers(0, 4, shape[0] * shape[1]))])
    z = rng.integers(0, 9000, start[-1]).astype(np.int32)
    for a, b in pairwise(start):
        z[a:b] = np.sort(z[a:b])[::-1]
    tops = rng.choice([0.0, 5000.0, 6000.0, 7000.0, np.nan], shape, p=[0.3, 0.2, 0.2, 0.2, 0.1])
    lifted = tops.copy()
    lift_pits(z, start, tops, 2000.0, lifted)
    expected = tops.copy()
    for row, col in np.ndindex(shape):
        if not (0 < row < shape[0] - 1 and 0 < col < shape[1] - 1):
            continue
        own = z[slice(*start[row * shape[1] + col :][:2])]
        around = np.delete(tops[row - 1 : row + 2, col - 1 : col + 2].ravel(), 4)
        void = np.isnan(tops[row, col])
        for level in np.unique(around[~np.isnan(around)])[::-1]:
            if (around >= level).sum() >= (2 if void else 6):
                if (void or tops[row, col] <= level - 2000) and (own <= level).any():
                    expected[row, col] = np.fmax(tops[row, col], own[own <= level].max())
                break
    np.testing.assert_array_equal(lifted, expected)
    assert (lifted > tops).sum() > 3
    assert (np.isnan(tops) & ~np.isnan(lifted)).sum() > 3


@pytest.mark.parametrize(("covered", "height"), [(True, 9.5), (False, 0.0)])
def test_a_sparse_twig_at_the_rim_of_a_crown_counts_where_no_ground_was_seen(covered, height):
    rng = np.random.default_rng(8)
    flat = terrain(density=8) * [1, 1, 0]
    crown = np.stack([rng.uniform(-18, -10, 3200), rng.uniform(42, 52, 3200),
                      rng.uniform(9, 10, 3200)], axis=1)  # fmt: skip
    beside = (flat[:, 0] > -10) & (flat[:, 0] < -9) & (flat[:, 1] > 46) & (flat[:, 1] < 47)
    ground = flat[~beside] if covered else flat
    table = table_of(
        np.concatenate([ground, crown, [[-9.2, 46.5, 9.5]]]),
        ground=np.repeat([1, 0], [len(ground), len(crown) + 1]),
    )
    strict = SETTINGS.model_copy(update={"dsm_support": 20})
    rasters = surfaces(table, CELL, strict, 0.05)
    x, y = centres()
    at = (np.abs(x + 9.5) < 0.5) & (np.abs(y - 46.5) < 0.5)
    assert rasters["dsm"][at] == pytest.approx(height, abs=0.01)
    assert rasters["dsm"][(x > -9) & (y > 53)].max() < 0.01


def test_voids_are_filled_up_to_the_stated_distance_only():
    points = terrain(density=20)
    hole = (points[:, 0] + 10) ** 2 + (points[:, 1] - 50) ** 2 < 9**2
    rasters = surfaces(table_of(points[~hole], ground=1), CELL, SETTINGS, 0.05)
    x, y = centres()
    inward = 9 - np.hypot(x + 10, y - 50)
    assert (rasters["dtm"][inward > 6] == NODATA).all()
    assert (rasters["dtm"][inward < 4] != NODATA).all()
    np.testing.assert_allclose(
        rasters["dtm"][inward < 4], (100 + 0.5 * x - 0.2 * y)[inward < 4], atol=0.05
    )
    assert (rasters["dsm"][inward > 4.5] == NODATA).all()
    assert (rasters["dsm"][(inward > 1) & (inward < 2)] != NODATA).all()
    assert (rasters["chm"][inward > 6] == NODATA).all()
    assert (rasters["density"][inward > 1.5] == NODATA).all()
    assert (rasters["density"][inward < 0] >= 0).all()


def test_density_is_zero_where_only_noise_came_back_and_nodata_where_nothing_did():
    points = terrain(density=20)
    west = points[:, 0] < -10
    lake = (points[:, 0] + 15) ** 2 + (points[:, 1] - 50) ** 2 < 4**2
    rng = np.random.default_rng(1)
    noise = np.column_stack([rng.uniform(-40, 0, 9000), rng.uniform(20, 80, 9000), np.zeros(9000)])
    # Off the edge of a swath noise is met far above and far below the ground only.
    noise[:, 2] = np.where(noise[:, 0] < -10, 90.0, rng.choice([150.0, 40.0], 9000))
    xyz = np.concatenate([points[west & ~lake], noise])
    kind = np.repeat([0, 1], [np.count_nonzero(west & ~lake), len(noise)])
    table = table_of(xyz, noise_class=kind, ground=kind == 0)
    density = surfaces(table, CELL, SETTINGS, 0.05)["density"]
    x, y = centres()
    assert (density[x > -10] == NODATA).all()
    assert (density[np.hypot(x + 15, y - 50) < 3] == 0).all()
    assert (density[x < -10] != NODATA).all()


def test_what_was_flown_does_not_depend_on_the_ground_cell():
    points = np.random.default_rng(4).uniform((-60, -10, 0), (60, 110, 90), (60, 3))
    table = table_of(points)
    both = Bounds(-20_000, 40_000, 20_000, 60_000)
    east = Bounds(0, 40_000, 20_000, 60_000)
    whole, west, rest = (surfaces(table, c, SETTINGS, 0.05)["density"] for c in (both, CELL, east))
    assert 0 < np.count_nonzero(whole == NODATA) < whole.size
    np.testing.assert_array_equal(np.hstack([west, rest]), whole)


def test_a_hall_wider_than_the_margin_leaves_no_void_near_ground():
    # Its rim runs askew: the ground that is read has no far side, and its triangles end there.
    ground, (x, y) = terrain(around=reach_m(SETTINGS) + 2), centres()
    within, deep = ((a - b + 52) / np.sqrt(2) for a, b in ((ground[:, 0], ground[:, 1]), (x, y)))
    hall = within > 0
    points = np.where(hall[:, None], ground + np.array([0, 0, 9.0]), ground)
    covered = surfaces(table_of(points, ground=~hall), CELL, SETTINGS, 0.05)["dtm"]
    near = (deep > 0) & (deep < 3.5)
    assert (covered[deep < 3.5] != NODATA).all()
    assert (covered[deep > 6.5] == NODATA).all()
    # The unknown corner is as high as the nearest ground: less than the slope across the reach.
    assert np.abs(covered - (100 + 0.5 * x - 0.2 * y))[near].max() < 0.54 * SETTINGS.void_max_m
    # Where nothing was returned the survey ends: no terrain beyond its edge.
    ended = surfaces(table_of(ground[~hall], ground=1), CELL, SETTINGS, 0.05)["dtm"]
    assert (ended[deep > 2.5] == NODATA).all()


def test_returns_that_nothing_assessed_count_only_where_no_signal_is():
    signal = terrain(density=10)
    west = signal[:, 0] < -10
    rng = np.random.default_rng(4)
    stray = np.stack(
        [rng.uniform(-20, 0, 3000), rng.uniform(40, 60, 3000), np.full(3000, 300.0)], 1
    )
    table = table_of(
        np.concatenate([signal[west], stray]),
        noise_class=np.repeat([0, 255], [west.sum(), len(stray)]),
    )
    dsm = surfaces(table, CELL, SETTINGS, 0.05)["dsm"]
    assert (dsm[:, :9] < 120).all()
    assert (dsm[:, 12:] == 300).all()


@pytest.mark.parametrize("flag", [PointFlag.WITHHELD, PointFlag.OUTSIDE_AOI])
def test_points_that_take_part_in_nothing_leave_no_trace(flag):
    points = terrain(density=5)
    higher = points + np.array([0, 0, 10])
    both = table_of(
        np.concatenate([points, higher]),
        flags=np.repeat([0, int(flag)], len(points)),
    )
    expected = surfaces(table_of(points), CELL, SETTINGS, 0.05)
    for name, raster in surfaces(both, CELL, SETTINGS, 0.05).items():
        np.testing.assert_array_equal(raster, expected[name])


def mixed(seed):
    rng = np.random.default_rng(seed)
    points = np.concatenate(
        [terrain(seed, 3, 0.05, 35.0), terrain(seed + 1, 1, 3.0) + np.array([0, 0, 4])]
    )
    n = len(points)
    return table_of(
        points,
        ground=points[:, 2] < 100.2 + 0.5 * points[:, 0] - 0.2 * points[:, 1],
        noise_class=rng.choice([0, 0, 0, 1, 255], n),
        intensity=rng.integers(0, 500, n),
    )


@given(st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_order_and_points_beyond_the_margin_do_not_matter(seed):
    table = mixed(seed)
    rng = np.random.default_rng(seed)
    reach = round(reach_m(SETTINGS) * 1000)
    west, south, east, north = CELL
    near = inside(
        table["x"], table["y"], Bounds(west - reach, south - reach, east + reach, north + reach)
    )
    assert near.sum() < len(table)
    expected = surfaces(table, CELL, SETTINGS, 0.05)
    other = table.take(rng.permutation(np.flatnonzero(near)))
    for name, raster in surfaces(other, CELL, SETTINGS, 0.05).items():
        np.testing.assert_array_equal(raster, expected[name])


@given(st.integers(-50_000, 50_000), st.integers(-50_000, 50_000))
@settings(max_examples=8, deadline=None)
def test_a_shift_by_whole_cells_moves_the_rasters_exactly(east, north):
    table = mixed(3)
    moved = table.with_columns(x=table["x"] + east * 1000, y=table["y"] + north * 1000)
    there = Bounds(
        CELL.xmin + east * 1000,
        CELL.ymin + north * 1000,
        CELL.xmax + east * 1000,
        CELL.ymax + north * 1000,
    )
    expected = surfaces(table, CELL, SETTINGS, 0.05)
    for name, raster in surfaces(moved, there, SETTINGS, 0.05).items():
        np.testing.assert_array_equal(raster, expected[name])


@pytest.mark.parametrize(
    "xyz",
    [
        [],
        [[-10.5, 50.5, 3.0]],
        [[-10.5, 50.5, 3.0]] * 40,
        [[-10.5, 40 + k, 3.0] for k in range(20)],
    ],
)
def test_few_or_degenerate_points(xyz):
    rasters = surfaces(table_of(xyz, ground=1), CELL, SETTINGS, 0.05)
    assert all(np.isfinite(r).all() for r in rasters.values())
    assert rasters["density"][rasters["density"] != NODATA].sum() == len(xyz)
    known = rasters["dtm"] != NODATA
    assert known.any() == bool(len(xyz))
    assert (rasters["dtm"][known] == 3).all()
    assert (rasters["chm"][known] == 0).all()


def test_a_cell_off_the_raster_grid_is_refused():
    with pytest.raises(ValueError, match="not aligned"):
        surfaces(table_of([]), Bounds(0, 0, 1500, 2000), SETTINGS, 0.05)


@pytest.mark.parametrize(
    ("expected", "height", "columns"),
    [
        (2, 0.0, {"ground": 1}),
        (1, 3.0, {}),
        (1, 3.0, {"input_class": 5}),
        (1, 3.0, {"input_class": 2}),
        (6, 3.0, {"input_class": 6}),
        (9, 0.2, {"input_class": 9}),
        (9, 0.24, {"flags": int(PointFlag.WATER)}),
        (1, 0.5, {"flags": int(PointFlag.WATER)}),
        (1, 4.0, {"flags": int(PointFlag.WATER)}),
        (9, 0.0, {"flags": int(PointFlag.WATER), "ground": 1}),
        (7, -2.0, {"noise_class": 1}),
        (18, 2.0, {"noise_class": 1, "input_class": 6}),
        (7, -0.5, {"noise_class": 2, "flags": int(PointFlag.WATER)}),
        (18, 40.0, {"noise_class": 255, "input_class": 18, "flags": int(PointFlag.VENDOR_NOISE)}),
        (5, 4.0, {"noise_class": 255, "input_class": 5, "flags": int(PointFlag.NO_BEAM)}),
        (1, 4.0, {"noise_class": 255, "input_class": 2, "flags": int(PointFlag.NO_BEAM)}),
        (2, 0.0, {"noise_class": 255, "ground": 1, "flags": int(PointFlag.NO_BEAM)}),
        (2, 4.0, {"noise_class": 255, "input_class": 2, "flags": int(PointFlag.OUTSIDE_AOI)}),
    ],
)
def test_each_point_gets_its_class(expected, height, columns):
    dtm = np.full((20, 20), 50.0, np.float32)
    dtm[:10] = 80.0
    table = table_of([[-3.5, 43.5, 50 + height], [-3.5, 57.5, 80 + height]], **columns)
    assert list(classify(table, CELL, dtm)) == [expected, expected]


def test_where_the_dtm_is_void_the_signal_divides_the_noise():
    dtm = np.full((20, 20), NODATA, np.float32)
    heights = [10.0, 12.0, 14.0, 9.0, 13.0]
    table = table_of([[-3.5, 43.5, z] for z in heights], noise_class=[0, 0, 0, 1, 1])
    assert list(classify(table, CELL, dtm)) == [1, 1, 1, 7, 18]
    only_noise = table.take(np.array([3, 4]))
    assert list(classify(only_noise, CELL, dtm)) == [18, 18]
