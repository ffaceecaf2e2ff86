"""Where silent beamlets pointed, and reflectance from the share that was seen."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import brentq

from spl_batch.airborne.beams.link_budget import link_constant
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.plan.space_tasks import index_of_boxes
from spl_batch.airborne.products.reflectance.beamlet_matching import SILENT, Grid, trace
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart, aim
from spl_batch.airborne.products.reflectance.reflectance import (
    bounds,
    credible_heights,
    first_surface,
    most_likely,
    raster,
    reach_m,
    slopes,
)
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA
from spl_batch.lattice.tables import BeamTable, PointTable, ShotClock
from spl_batch.lattice.tiles import Bounds

SENSOR = load_preset("spl100")
PRODUCTS = ProductSettings(extinction_per_m=0.0)
CLOCK = ShotClock(1000.0, 50_000.0)
CORE = Bounds(1_000_000, 2_000_000, 1_020_000, 2_020_000)
ALTITUDE_M = 2000.0
SHOTS = 240
INTERVAL = 60


def model(gain: NDArray[np.float64]) -> LineModel:
    """A flightline whose shots were all fired."""
    count = SHOTS // INTERVAL
    interval = np.arange(count)
    given: dict[str, Any] = {f.name: np.zeros(count) for f in fields(LineModel)}
    given |= {
        "interval": interval,
        "first": np.zeros(count, np.int64),
        "last": np.full(count, INTERVAL - 1),
        "gain": gain,
        "kind": "range",
        "gate_m": 100.0,
        "mean_rate": 0.0,
        "beamlets": 100,
        "interval_shots": INTERVAL,
        "seen_shots": 1,
    }
    return LineModel(**given)


def flat_gain() -> NDArray[np.float64]:
    gain = np.zeros(256)
    gain[1:101] = 1.0
    return gain


def leans(order: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sensor of each shot, and dx/dz, dy/dz of each beamlet: (s, 3) and (s, 100, 2).

    The array turns with the scan; its path is no polynomial.
    """
    shot = np.arange(SHOTS)
    turn = 0.4 + shot * 0.003
    sensor = np.column_stack(
        [1010.0 + 0.002 * shot - 400.0, np.full(SHOTS, 2010.0), np.full(SHOTS, ALTITUDE_M)]
    )
    sweep = 0.004 * np.sin(shot / 40.0), 0.004 * np.cos(shot / 55.0)
    centre = np.column_stack([0.2 + sweep[0], sweep[1]])
    i, j = np.divmod(order, 10)
    x, y = (i - 4.5) * 2.2e-4, (j - 4.5) * 2.2e-4
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    array = np.stack([c * x - s * y, s * x + c * y], axis=2)
    return sensor, -(centre[:, None] + array)


def survey(
    rho: Any, gain: NDArray[np.float64], seed: int = 1, order: NDArray[np.int64] | None = None
) -> tuple[PointTable, BeamTable, NDArray[np.bool_]]:
    """Points on flat ground at height 0, seen by chance as bright as ``rho(x, y)``."""
    rng = np.random.default_rng(seed)
    sensor, lean = leans(np.arange(100) if order is None else order)
    ground = sensor[:, None, :2] - lean * ALTITUDE_M
    length = np.sqrt(1 + (lean**2).sum(axis=2))
    expected = link_constant(SENSOR) * gain[1:101] / (ALTITUDE_M * length) ** 2 / length
    expected = expected * rho(ground[..., 0], ground[..., 1])
    seen = rng.random(expected.shape) < -np.expm1(-expected)
    shot, channel = np.nonzero(seen)
    xy = np.rint(ground[seen] * 1000).astype(np.int64)
    table = PointTable({}).with_columns(
        x=xy[:, 0], y=xy[:, 1], z=np.zeros(len(xy)), shot=shot, channel=channel + 1,
        gps_time=CLOCK.t0_s + shot / CLOCK.prf_hz, noise_class=np.zeros(len(xy)),
        line=np.full(len(xy), 7),
    )  # fmt: skip
    points = np.column_stack([xy / 1000, np.zeros(len(xy))])
    direction = points - sensor[shot]
    range_m = np.linalg.norm(direction, axis=1)
    known = np.ones(len(xy), dtype=np.bool_)
    return table, BeamTable(sensor[shot], direction / range_m[:, None], range_m, known), seen


def part_of(table: PointTable, beams: BeamTable, gain: NDArray[np.float64]) -> FiredPart:
    return aim(table, beams, model(gain), SENSOR, CLOCK, 7)


def predicted(part: FiredPart, shot: int, channel: int) -> NDArray[np.float64]:
    """Where a beamlet meets the reference plane, written out once more."""
    fires = (part.blocks["first"] <= shot) & (shot <= part.blocks["last"])
    block = part.blocks[fires][0]
    t = (shot - block["middle"]) / block["half"]
    gx, gy = part.patterns[block["pattern"], channel]
    terms = np.array([1, t, t**2, t**3, gx, gx * t, gy, gy * t])
    return np.asarray(block["anchor"][:2] + terms @ block["coefficient"])


@pytest.mark.parametrize(
    "order", [np.arange(100), np.random.default_rng(5).permutation(100)], ids=["known", "learnt"]
)
def test_silent_beamlets_are_found_between_the_seen(order: NDArray[np.int64]) -> None:
    table, beams, seen = survey(lambda x, _: np.full(x.shape, 0.1), flat_gain(), order=order)
    sensor, lean = leans(order)
    part = part_of(table, beams, flat_gain())
    assert part.dropped == 0
    silent = np.argwhere(~seen)[::53]
    assert len(silent) > 100
    # the wobble is no cubic, and coordinates are whole millimetres
    for shot, c in silent:
        truth = sensor[shot, :2] - lean[shot, c] * ALTITUDE_M
        assert np.abs(predicted(part, shot, c + 1) - truth).max() < 0.25


def test_a_line_may_be_cut_anywhere_between_intervals() -> None:
    table, beams, _ = survey(lambda x, _: np.full(x.shape, 0.2), flat_gain())
    whole = part_of(table, beams, flat_gain())
    mine = table["shot"] >= 2 * INTERVAL
    rest = BeamTable(*(getattr(beams, f.name)[mine] for f in fields(BeamTable)))
    piece = part_of(table.take(mine), rest, flat_gain())
    np.testing.assert_array_equal(whole.blocks[2:], piece.blocks)
    np.testing.assert_array_equal(whole.pattern[2:], piece.pattern)


def test_a_part_survives_the_way_to_disk() -> None:
    table, beams, _ = survey(lambda x, _: np.full(x.shape, 0.2), flat_gain())
    part = part_of(table, beams, flat_gain())
    for kept in (part, replace(part, blocks=part.blocks[:0])):
        again = FiredPart.from_arrays(kept.to_arrays())
        for field in fields(FiredPart):
            found, was = (np.asarray(getattr(some, field.name)) for some in (again, kept))
            np.testing.assert_array_equal(found, was, err_msg=field.name)
            assert found.dtype == was.dtype
    west, south, east, north = part.reach()
    x, y = table["x"] / 1000, table["y"] / 1000
    assert west <= x.min()
    assert x.max() <= east
    assert south <= y.min()
    assert y.max() <= north


def two_halves(x: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(x < 1010.0, 0.15, 0.6)


def test_reflectance_of_two_halves_with_dead_and_weak_channels() -> None:
    gain = flat_gain()
    gain[[7, 8, 40, 77]] = 0.0
    gain[[12, 50]] = 0.2
    ratios = []
    for seed in range(4):
        table, beams, _ = survey(two_halves, gain, seed=seed)
        found = raster(table, [part_of(table, beams, gain)], CORE, PRODUCTS)
        left = np.arange(20)[None, :] < 9
        right = np.arange(20)[None, :] >= 11
        for side, rho in ((left, 0.15), (right, 0.6)):
            ratios.append(found[(found != NODATA) & side].mean() / rho)
    # 20 000 beamlets in four surveys: the counts alone spread a mean by 2 %
    assert np.abs(np.reshape(ratios, (4, 2)).mean(axis=0) - 1).max() < 0.05


def test_order_of_points_and_parts_does_not_matter() -> None:
    table, beams, _ = survey(two_halves, flat_gain())
    part = part_of(table, beams, flat_gain())
    expected = raster(table, [part], CORE, PRODUCTS)
    half = len(part.blocks) // 2
    pieces = [replace(part, blocks=some) for some in (part.blocks[half:], part.blocks[:half])]
    mixed = table.take(np.random.default_rng(3).permutation(len(table)))
    np.testing.assert_array_equal(raster(mixed, pieces, CORE, PRODUCTS), expected)
    assert np.isfinite(expected).all()
    assert expected.shape == (20, 20)
    assert (expected >= 0).any()


def test_a_flightline_that_is_shifted_takes_its_beamlets_along() -> None:
    table, beams, _ = survey(lambda x, _: np.where(x < 1010, 0.2, 0.5), flat_gain())
    part, up = part_of(table, beams, flat_gain()), 50_000
    here = raster(table, [part], CORE, PRODUCTS)
    moved = table.with_columns(z=table["z"] + up)
    np.testing.assert_allclose(raster(moved, [part.raised(up)], CORE, PRODUCTS), here, rtol=1e-3)
    assert np.abs(raster(moved, [part], CORE, PRODUCTS) / here - 1).max() > 0.1


def test_flightlines_flown_at_the_same_time_have_returns_of_their_own() -> None:
    """Twice the beamlets, of which half see nothing: far less light; as much where both see."""
    table, beams, _ = survey(two_halves, flat_gain())
    part = part_of(table, beams, flat_gain())
    alone = raster(table, [part], CORE, PRODUCTS)
    other = replace(part, line=8)
    dark = raster(table, [part, other], CORE, PRODUCTS)
    known = (alone != NODATA) & (alone > 0)
    assert (dark[known] < 0.75 * alone[known]).all()
    both = PointTable({k: np.concatenate([table[k], table[k]]) for k in table.columns})
    lines = np.repeat([7, 8], len(table)).astype(np.uint16)
    twice = raster(both.with_columns(line=lines), [other, part], CORE, PRODUCTS)
    assert np.median(twice[known] / alone[known]) == pytest.approx(1.0, abs=0.05)


def test_noise_is_no_detection_and_hides_none() -> None:
    table, beams, _ = survey(two_halves, flat_gain())
    part = part_of(table, beams, flat_gain())
    expected = raster(table, [part], CORE, PRODUCTS)
    high = table.with_columns(z=table["z"] + 30_000, noise_class=np.ones(len(table)))
    both = PointTable({k: np.concatenate([table[k], high[k]]) for k in table.columns})
    np.testing.assert_array_equal(raster(both, [part], CORE, PRODUCTS), expected)


def test_nothing_fired_is_nodata() -> None:
    table, beams, _ = survey(two_halves, flat_gain())
    part = part_of(table, beams, flat_gain())
    assert (raster(table, [], CORE, PRODUCTS) == -9999).all()
    assert (raster(table.take(slice(0, 0)), [part], CORE, PRODUCTS) == -9999).all()
    far = Bounds(*(edge + 500_000 for edge in CORE))
    assert (raster(table, [part], far, PRODUCTS) == -9999).all()
    assert reach_m(PRODUCTS) >= PRODUCTS.void_max_m


@settings(max_examples=40, deadline=None)
@given(
    seen=st.lists(st.floats(0.05, 20.0), min_size=1, max_size=30),
    silent=st.floats(0.01, 200.0),
)
@example(seen=[18.0, 0.0625, 0.0625], silent=0.01171875)
def test_most_likely_solves_its_equation(seen: list[float], silent: float) -> None:
    k = np.array(seen)
    out = np.empty(2)
    most_likely(np.array([0, 0, len(k)]), k, np.array([silent, silent]), out)
    assert out[0] == 0.0

    def excess(rho: float) -> float:
        with np.errstate(over="ignore"):
            return float((k / np.expm1(k * rho)).sum()) - silent

    high = 1.0
    while excess(high) > 0:
        high *= 2.0
    assert out[1] == pytest.approx(brentq(excess, 1e-9, high, xtol=1e-13), rel=1e-6)


def test_slopes_do_not_look_across_walls() -> None:
    x = np.arange(12.0)
    roof = np.where(x < 6, 0.1 * x, 20.0 - 0.5 * x)
    found = slopes(np.tile(roof, (3, 1)), 1.0)[1, :, 0]
    np.testing.assert_allclose(found[:6], 0.1)
    np.testing.assert_allclose(found[7:], -0.5)
    assert slopes(np.full((3, 3), np.nan), 1.0).tolist() == np.zeros((3, 3, 2)).tolist()


def town(rng: np.random.Generator) -> NDArray[np.float64]:
    """Heights of 64 x 64 cells: a slope with boxes on it."""
    height = np.tile(0.1 * np.arange(64.0), (64, 1))
    for _ in range(6):
        row, col = rng.integers(4, 52, 2)
        height[row : row + 8, col : col + 8] += rng.uniform(2, 12)
    return height


def ends(
    grid: Grid, sensor: NDArray[np.float64], *leans: NDArray[np.float64]
) -> list[tuple[int, int]]:
    """Row and column where each ray of a shot meets a surface; (-1, -1) where it meets none."""
    aim = np.array([*sensor, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    cell = np.empty(len(leans), np.int64)
    wanted = np.full(len(leans), SILENT)
    trace(grid.height, grid.low, grid.high, grid.cell_m, 5.0, aim, np.array(leans), wanted, cell)
    cols = grid.height.shape[1]
    return [(int(n // cols), int(n % cols)) if n >= 0 else (-1, -1) for n in cell]


def test_rays_end_where_a_slow_walk_ends() -> None:
    rng = np.random.default_rng(2)
    height = town(rng)
    low, high = bounds(height), -bounds(-height)
    grid = Grid(1.0, height, slopes(height, 1.0), low, high)
    sensor = np.array([-300.0, 100.0, 1500.0])
    same = near = 0
    for _ in range(400):
        target = rng.uniform(8, 56, 2)
        lean = (sensor[:2] - target) / sensor[2]
        z = np.arange(height.max() + 1.0, -1.0, -1e-3)
        xy = sensor[:2, None] + lean[:, None] * (z - sensor[2])
        col, row = np.clip(np.floor(xy).astype(int), 0, 63)
        hit = int(np.argmax(z <= height[row, col]))
        (found,) = ends(grid, sensor, lean)
        near += max(abs(found[0] - row[hit]), abs(found[1] - col[hit])) <= 1
        same += found == (row[hit], col[hit])
    # half a cell is stepped at once: some rays end in the next cell, a few beside a corner
    assert near >= 396
    assert same >= 280


def test_bounds_are_those_of_a_loop_over_squares_and_their_neighbours() -> None:
    rng = np.random.default_rng(6)
    shape = 37, 50
    cell = rng.choice(37 * 50, 500, replace=False)
    z = rng.integers(0, 2000, 500).astype(np.int32)
    grid = first_surface(cell, z, shape, PRODUCTS.model_copy(update={"dsm_void_max_m": 1.0}))
    assert grid.low.shape == grid.high.shape == (5, 7)
    for row, col in np.ndindex(5, 7):
        around = grid.height[max(8 * row - 8, 0) : 8 * row + 16, max(8 * col - 8, 0) : 8 * col + 16]
        assert grid.low[row, col] == np.nanmin(around)
        assert grid.high[row, col] == np.nanmax(around)
    assert np.isnan(bounds(np.full((9, 9), np.nan))).all()


def test_noise_in_the_air_is_no_surface() -> None:
    height = np.full((40, 40), 10.0)
    height[5, 5], height[8, 8:10] = 60.0, 60.0
    height[20:24, 8:12] = 18.0
    height[30, 30:32], height[31, 30] = (30.0, 30.0), 31.5
    found = credible_heights(height, 1.0)
    np.testing.assert_array_equal(np.isnan(found), height == 60.0)
    np.testing.assert_array_equal(found[height < 60.0], height[height < 60.0])


def test_stretches_are_chosen_by_where_they_fired() -> None:
    boxes = {"b": [0, 0, 10, 10], "a": [5, 5, 20, 20], "c": [50, 0, 60, 10]}
    index = index_of_boxes(boxes, 1000)
    assert index.overlapping(Bounds(8_000, 8_000, 9_000, 9_000)) == ["a", "b"]
    assert index.overlapping(Bounds(20_000, 20_000, 30_000, 30_000)) == []
