"""Noise over bright and dark ground: which ground a beamlet looks at, and its gain."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.noise import gains, line_noise, line_statistics, voxel_noise
from spl_batch.airborne.noise.ground_cells import (
    CELL_M,
    PARTS,
    STRIDE,
    cells,
    look_through,
    signal_of,
)
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.constants import QUANTUM_M
from tests.flightlines import Flight, cut, fly, relief

Floats = NDArray[np.float64]

SETTINGS = NoiseSettings()
PARCEL_M = 40.0


def parcels(x: Floats, y: Floats) -> Floats:
    """Fields four times as bright as those beside them."""
    even = (np.floor(x / PARCEL_M) + np.floor(y / PARCEL_M)) % 2 == 0
    return np.where(even, 1.6, 0.4)


def model_of(flight: Flight, shots: int | None = None) -> LineModel:
    """Fitted to a whole flightline, or to stretches of it, last one first."""
    tables = [flight.table] if shots is None else cut(flight.table, shots)[::-1]
    parts = [
        line_statistics.observe(table, geometry.beams(table, flight.trajectory), SETTINGS)
        for table in tables
    ]
    return line_noise.fit(line_statistics.merge(parts), SETTINGS, load_preset("spl100"))


def test_a_beamlet_looks_where_it_comes_to_the_signal() -> None:
    flight = fly(surface=relief, shots=120, detection=0.3)
    table, beams = flight.table, geometry.beams(flight.table, flight.trajectory)
    signal = signal_of(table, beams, SETTINGS)
    found = cells(table, beams, signal.below)
    assert np.median(np.abs(signal.below[~flight.noise])) < 2.0
    point = np.column_stack([table[axis] * QUANTUM_M for axis in "xyz"])
    for row in run_starts(table["gps_time"], table["channel"])[:-1:7].tolist():
        place = point[row] + beams.direction[row] * signal.below[row] / beams.direction[row, 2]
        assert place[2] == pytest.approx(point[row, 2] + signal.below[row])
        i, j = np.floor(place[:2] / CELL_M).astype(int).tolist()
        assert found[row] == i * STRIDE + j


def test_looks_are_numbered_by_interval_and_cell() -> None:
    flight = fly(shots=180)
    table, beams = flight.table, geometry.beams(flight.table, flight.trajectory)
    signal = signal_of(table, beams, SETTINGS)
    cell = cells(table, beams, signal.below)
    row, looks = look_through(table, beams, signal)
    np.testing.assert_array_equal(looks["look_cell"][row], cell)
    pairs = {*zip((table["shot"] // 60).tolist(), cell.tolist(), strict=True)}
    assert len(pairs) == len(set(row.tolist())) == len(looks["look_cell"]) == looks["looks"].sum()
    shots = len(run_starts(table["gps_time"])) - 1
    # each shot shares out one whole, but for what a division leaves
    assert looks["look_number"].sum() == pytest.approx(shots * PARTS, rel=1e-4)


@pytest.mark.parametrize("shots", [60, 300])
def test_stretches_add_up_to_the_flightline_in_any_order(shots: int) -> None:
    flight = fly(shots=1200, first_shot=12_360, albedo=parcels, surface=relief)
    whole, parts = model_of(flight), model_of(flight, shots)
    for name in ("cell", "ground", "rate", "gain"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    assert whole.mean_rate == parts.mean_rate
    signal = signal_of(flight.table, geometry.beams(flight.table, flight.trajectory), SETTINGS)
    for model in (whole, parts):
        below = model.signal_at(flight.table["shot"]) - flight.table["z"] * QUANTUM_M
        np.testing.assert_array_equal(below, signal.below)


def test_even_ground_has_a_gain_of_one() -> None:
    model = model_of(fly(shots=6000, noise_per_m=4e-4))
    assert len(model.cell) > 100
    assert np.abs(model.ground - 1).max() < 0.02


def test_chance_is_drawn_to_the_cells_around() -> None:
    rng = np.random.default_rng(4)
    n, side = 400, np.arange(20)
    cell = np.sort((side[:, None] * STRIDE + side).ravel())
    true = np.where(np.arange(n) < n // 2, 2.0, 0.5)
    expected = np.full(n, 30.0)
    counted = rng.poisson(true * expected).astype(np.float64)
    found = gains.ground_gains(cell, counted, expected)
    assert float((found * expected).sum()) == pytest.approx(float(expected.sum()))
    scaled = true / true.mean()
    assert np.std(found / scaled - 1) < np.std(counted / expected / true - 1)
    assert np.mean(found[: n // 2]) == pytest.approx(2.0 / 1.25, rel=0.05)
    assert np.mean(found[n // 2 :]) == pytest.approx(0.5 / 1.25, rel=0.1)
    even = rng.poisson(expected).astype(np.float64)
    assert np.abs(gains.ground_gains(cell, even, expected) - 1).max() < 0.1


def test_signal_between_the_buffers_makes_no_bright_ground() -> None:
    rng = np.random.default_rng(7)
    farther, between = rng.poisson(30.0, (2, 50))
    between[20] += 200
    outside = np.zeros((50, 2, 4), np.int32)
    outside[:, 0, 0], outside[:, 0, 3] = farther, farther + between
    merged = {
        "look_cell": np.arange(50), "interval": np.array([0]), "looks": np.array([50]),
        "look_number": np.full(50, PARTS), "look_outside": outside,
    }  # fmt: skip
    expected = np.array([[1500.0], [3000.0]])
    _, found = gains.ground(merged, np.array([0]), expected, (0, 3), np.ones(2))
    np.testing.assert_allclose(found, 1.0, atol=0.2)
    between[:25] *= 2
    outside[:, 0, 0], outside[:, 0, 3] = 2 * farther, 2 * farther + between
    outside[25:, 0] //= 2
    _, found = gains.ground(merged, np.array([0]), expected, (0, 3), np.ones(2))
    assert found[:20].mean() > 1.5 * found[30:].mean()


def test_bright_and_dark_parcels_have_the_noise_that_they_send_back() -> None:
    flight = fly(shots=9000, albedo=parcels, noise_per_m=8e-4)
    beams = geometry.beams(flight.table, flight.trajectory)
    model = model_of(flight)
    gain = gains.looked_at(flight.table, beams, model)
    part, one_rate = (
        voxel_noise.deposit(flight.table, beams, model, SETTINGS, ground)[0]
        for ground in (gain, None)
    )
    assert part.squares is not None
    assert one_rate.squares is not None
    corner = np.array(part.corner)
    point = np.column_stack([flight.table[axis] * QUANTUM_M for axis in "xyz"])
    true = np.zeros(part.amount.shape)
    np.add.at(true, tuple((np.floor(point[flight.noise] / 10.0).astype(int) - corner).T), 1)
    centre = (np.stack(np.indices(true.shape), -1) + corner + 0.5) * 10.0
    inner = np.abs(centre[..., :2] % PARCEL_M - PARCEL_M / 2).max(axis=-1) < 10.0
    inner &= np.abs(centre[..., 2] - 40.0) < 40.0
    for albedo in (1.6, 0.4):
        here = inner & (parcels(centre[..., 0], centre[..., 1]) == albedo)
        found, without = (
            1000.0 * voxel_noise.density(p.amount, SETTINGS)[here].sum() / true[here].sum()
            for p in (part, one_rate)
        )
        assert found == pytest.approx(1, abs=0.12)
        assert abs(without - 1) > 0.25
        times = part.squares[here].sum() / one_rate.squares[here].sum()
        assert times == pytest.approx(albedo, rel=0.25)
