"""Lines of sight, and the sensor where they meet."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares

from spl_batch.airborne.beams import geometry, sensor_path
from spl_batch.airborne.beams.shot_runs import blind_behind, run_starts
from spl_batch.airborne.noise import line_noise, line_statistics, voxel_noise
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.lattice.tables import PointTable, Trajectory
from tests.flightlines import Flight, cut, fly

SETTINGS = NoiseSettings()
SECONDS = np.arange(1000.0, 1006.0)


def straight(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Path with a constant velocity."""
    return np.array([500.0, 90.0, 2600.0]) + (time - 1000.0)[:, None] * [80.0, -30.0, 1.5]


def look(
    n: int, *, sigma_rad: float = 0.0, seed: int = 0, spread: tuple[float, float] = (2, 9000)
) -> sensor_path.Lines:
    """Lines from the straight path to places in a circle of 600 m below it."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(1000.0, 1004.9, n))
    sensor = straight(time)
    angle = rng.uniform(0, 2 * np.pi, n)
    height = rng.uniform(0, 80, n)
    across = sensor[:, :2] + 600.0 * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    slope = (sensor[:, :2] - across) / (sensor[:, 2] - height)[:, None]
    amount = rng.uniform(*spread, n)
    slope += rng.normal(0, 1, (n, 2)) * sigma_rad * np.sqrt(np.mean(spread) / amount)[:, None]
    return sensor_path.Lines(time, across, height, slope, amount)


def as_one_channel(table: PointTable) -> PointTable:
    """The same points from a file without channels, in time order."""
    table = table.with_columns(channel=np.zeros(len(table)))
    return table.take(np.lexsort([table[k] for k in ("z", "y", "x", "gps_time")]))


def found_path(table: PointTable, beamlets: int) -> sensor_path.Path:
    lines = sensor_path.merge([sensor_path.collect(table, beamlets, SETTINGS.interval_shots)])
    return sensor_path.find_path(lines, (float(table["gps_time"][0]), float(table["gps_time"][-1])))


def beam_error_rad(table: PointTable, found: Trajectory, true: Trajectory) -> float:
    one, other = (geometry.beams(table, t).direction for t in (found, true))
    return float(np.linalg.norm(np.cross(one, other), axis=1).max())


def test_exact_lines_meet_at_the_sensor() -> None:
    found = sensor_path.intersect(look(400), SECONDS)
    assert found == pytest.approx(straight(SECONDS), abs=0.02)


def test_intersection_against_a_general_solver() -> None:
    lines = look(2000, sigma_rad=1e-4)

    def missed(knots: NDArray[np.float64]) -> NDArray[np.float64]:
        ends = knots.reshape(2, 3)
        share = (lines.time_s - SECONDS[0]) / (SECONDS[-1] - SECONDS[0])
        at = ends[0] * (1 - share)[:, None] + ends[1] * share[:, None]
        up = (at[:, 2] - lines.height)[:, None]
        angle = (at[:, :2] - lines.across) / up - lines.slope
        return (angle * np.sqrt(lines.spread)[:, None]).ravel()

    slow = least_squares(missed, [0, 0, 2000, 0, 0, 2000], x_scale=[1e2, 1e2, 1e3] * 2).x
    found = sensor_path.intersect(lines, SECONDS)
    assert found[[0, -1]] == pytest.approx(slow.reshape(2, 3), abs=0.3)
    assert found == pytest.approx(straight(SECONDS), abs=0.4)


def test_a_quarter_of_false_lines_changes_little() -> None:
    lines, false = look(900, sigma_rad=2e-5), look(300, sigma_rad=0.2, seed=5)
    both = sensor_path.Lines(*(np.concatenate(pair) for pair in zip(lines, false, strict=True)))
    assert sensor_path.intersect(both, SECONDS) == pytest.approx(straight(SECONDS), abs=0.3)


def test_wide_pencils_do_not_pull_the_sensor_down() -> None:
    lines = look(4000, sigma_rad=0.05, spread=(5000, 9000))
    assert sensor_path.intersect(lines, SECONDS)[:, 2].mean() == pytest.approx(2603.75, abs=60)


@pytest.mark.parametrize("lines", [look(sensor_path.LINES_MIN - 1), look(300, sigma_rad=0.5)])
def test_few_or_contradicting_lines_tell_no_sensor(lines: sensor_path.Lines) -> None:
    found = sensor_path.find_path(lines, (1000.0, 1004.9))
    assert found.trajectory is None
    assert found.lines == len(lines.time_s)


def slow_lines(table: PointTable) -> list[tuple[float, ...]]:
    """Best lines of each interval: time, mean place, slope and spread, beamlet by beamlet."""
    keys = np.stack([table["gps_time"], table["channel"]], axis=1)
    lines = []
    for key in np.unique(keys, axis=0):
        own = table.take(np.all(keys == key, axis=1))
        x, y, z = (own[k] / 1000.0 for k in "xyz")
        spread = float(np.sum((z - z.mean()) ** 2))
        if len(own) > 1 and spread > 0.0:
            slope = [np.polynomial.polynomial.polyfit(z, v, 1)[1] for v in (x, y)]
            row = (key[0], x.mean(), y.mean(), z.mean(), *slope, spread)
            lines.append((int(own["shot"][0]) // 60, -spread, *map(float, row)))
    lines.sort()
    intervals = [line[0] for line in lines]
    ranked = [line for k, line in enumerate(lines) if intervals[:k].count(line[0]) < 2]
    return sorted(line[2:] for line in ranked)


def test_lines_against_fits_one_by_one() -> None:
    table = fly(shots=70).table
    slow = slow_lines(table)
    lines = sensor_path.merge([sensor_path.collect(table, 100, 60)])
    fast = np.column_stack([lines.time_s, lines.across, lines.height, lines.slope, lines.spread])
    assert len(slow) == 2 * len(np.unique(table["shot"] // 60))
    assert fast == pytest.approx(np.array(slow), rel=1e-5, abs=1e-7)


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 9), st.randoms(use_true_random=False))
def test_cutting_changes_no_bit(intervals: int, order: object) -> None:
    table = fly(shots=700).table
    parts = [sensor_path.collect(t, 100, 60) for t in cut(table, 60 * intervals)]
    order.shuffle(parts)  # type: ignore[attr-defined]
    whole = sensor_path.merge([sensor_path.collect(table, 100, 60)])
    for one, other in zip(sensor_path.merge(parts), whole, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize(("beamlets", "limit_rad"), [(100, 1e-5), (1, 1.5e-3)])
def test_noise_is_right_without_a_trajectory(beamlets: int, limit_rad: float) -> None:
    flight = fly(shots=4000, scan_m=700.0)
    table = flight.table if beamlets > 1 else as_one_channel(flight.table)
    path = found_path(table, beamlets).trajectory
    assert path is not None
    assert beam_error_rad(table, path, flight.trajectory) < limit_rad
    expected, true = totals(Flight(table, path, flight.noise), flight, beamlets)
    assert expected.sum() / true.sum() == pytest.approx(1.0, abs=0.02)
    # Beams that lean the wrong way miss the ends of the gate and the edge of the swath.
    level = np.arange(true.shape[2]) - np.flatnonzero(true.sum(axis=(0, 1)))[-1]
    top = (level >= -4) & (level <= 1)
    assert expected[:, :, top].sum() / true[:, :, top].sum() == pytest.approx(1.0, abs=0.04)
    assert np.abs(expected - true).sum() < 1.6 * np.sqrt(true).sum()


def totals(
    flight: Flight, truth: Flight, beamlets: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Expected and true noise of each voxel."""
    sensor = load_preset("spl100").model_copy(update={"beamlets": beamlets})
    beams = geometry.beams(flight.table, flight.trajectory)
    stats = line_statistics.merge([line_statistics.observe(flight.table, beams, SETTINGS)])
    (part,) = voxel_noise.deposit(
        flight.table, beams, line_noise.fit(stats, SETTINGS, sensor), SETTINGS
    )
    true = np.zeros(part.amount.shape)
    index = [
        np.floor_divide(truth.table[k][truth.noise], 10_000) - part.corner[a]
        for a, k in enumerate("xyz")
    ]
    np.add.at(true, tuple(index), 1)
    return voxel_noise.density(part.amount, SETTINGS) * 1000.0, true


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 40)), min_size=1, max_size=20))
def test_blinded_lengths_add_up_to_their_union(rows: list[tuple[int, int]]) -> None:
    rows = sorted(rows, key=lambda row: row[0])
    channel, range_m = (np.array(v) for v in zip(*rows, strict=True))
    blind = np.empty(len(rows))
    blind_behind(run_starts(channel), range_m.astype(float), 5.0, blind)
    for c in np.unique(channel):
        metres = {r + k for d, r in rows if d == c for k in range(5)}
        assert blind[channel == c].sum() == pytest.approx(len(metres))
