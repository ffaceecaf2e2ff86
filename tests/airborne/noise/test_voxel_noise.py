"""Chords and the voxel-spherical model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.beams import geometry
from spl_batch.airborne.noise import line_noise, line_statistics, voxel_noise
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.noise.voxel_chords import (
    chord_length,
    deposit_beamlets,
    steepness,
)
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.lattice.tables import FIXED_POINT, PointTable, VoxelPart
from tests.flightlines import Flight, cut, fly, relief

SEEN = NoiseSettings()
PUBLISHED = NoiseSettings(correction="published")
RADIUS_M = 6.2035


def run(flight: Flight, chosen: NoiseSettings = SEEN) -> tuple[LineModel, VoxelPart]:
    beams = geometry.beams(flight.table, flight.trajectory)
    stats = line_statistics.merge([line_statistics.observe(flight.table, beams, chosen)])
    model = line_noise.fit(stats, chosen, load_preset("spl100"))
    (part,) = voxel_noise.deposit(flight.table, beams, model, chosen)
    return model, part


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000))
def test_chord_against_dense_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    point, line = rng.uniform(-8, 8, 3), rng.normal(size=3)
    line /= np.linalg.norm(line)
    near, far = np.sort(rng.uniform(-15, 15, 2))
    s = np.linspace(near, far, 20_001)
    inside = np.linalg.norm(point + s[:, None] * line, axis=1) <= 6.2
    sampled = inside.mean() * (far - near)
    assert chord_length(*point, *line, near, far, 6.2) == pytest.approx(sampled, abs=5e-3)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000))
def test_steep_beamlets_deposit_what_they_do_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 12
    lean = rng.normal(size=(n, 3)) * rng.choice([0.0, 0.1, 0.5, 2.0], (n, 1)) + (0.0, 0.0, -1.0)
    line = lean / np.linalg.norm(lean, axis=1)[:, None]
    assert (np.abs(line[:, 2]) >= steepness(10.0, RADIUS_M)).any()
    voxel, point = rng.integers(10, 14, (n, 3)), rng.uniform(-5.0, 5.0, (n, 3))
    near, far = np.sort(rng.uniform(-60.0, 60.0, (2, n)), axis=0)
    rows = (voxel, point, line, near, far, rng.uniform(0.0, 1e6, n))
    none, ordinal = np.zeros((0, 0, 0), np.int64), np.arange(n)
    share = rng.integers(1, 40, n)
    amount, one_by_one = np.zeros((2, 25, 25, 25), np.int64)
    squares, counted = np.zeros((2, 25, 25, 25, 16), np.uint16)
    shots, beamlets = np.zeros((2, 25, 25, 25), np.int64)
    deposit_beamlets(*rows, 10.0, RADIUS_M, ordinal, amount, none, none, share, squares)
    # Where beamlets are counted too, none takes the quick way.
    deposit_beamlets(*rows, 10.0, RADIUS_M, ordinal, one_by_one, shots, beamlets, share, counted)
    np.testing.assert_array_equal(shots, beamlets)
    assert (beamlets[one_by_one > 0] > 0).all()
    np.testing.assert_array_equal(amount, one_by_one)
    np.testing.assert_array_equal(squares, counted)


def slow_deposit(
    table: PointTable, flight: Flight, model: LineModel, part: VoxelPart
) -> np.ndarray:
    """Every sphere of the box against every beamlet."""
    beams = geometry.beams(table, flight.trajectory)
    near, far = line_noise.gate_of(table, beams, model)
    key = np.stack([table["gps_time"], table["channel"]], axis=1)
    _, first = np.unique(key, axis=0, return_index=True)
    shot = table["shot"][first]
    centres = np.stack(np.indices(part.amount.shape), axis=-1) + np.array(part.corner)
    centres = (centres + 0.5) * 10.0
    total = np.zeros(part.amount.shape)
    for row, own in zip(first, shot, strict=True):
        seen = np.sum(shot // model.seen_shots == own // model.seen_shots)
        weight = model.rate[np.searchsorted(model.interval, own // 60)]
        weight *= model.seen_shots * model.beamlets / seen
        away = centres - beams.origin_m[row]
        along = away @ beams.direction[row]
        square = RADIUS_M**2 - (np.sum(away**2, axis=-1) - along**2)
        half = np.sqrt(np.maximum(square, 0))
        chord = np.minimum(along + half, far[row]) - np.maximum(along - half, near[row])
        total += weight * np.where(square > 0, np.maximum(chord, 0), 0)
    return total


def test_a_stretch_in_several_boxes_adds_up_to_one(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = fly(shots=240)
    beams = geometry.beams(flight.table, flight.trajectory)
    model, whole = run(flight)
    place = np.column_stack((flight.table["x"], flight.table["y"]))
    gap = int(np.diff(np.sort(place, axis=0), axis=0).max()) - 1
    monkeypatch.setattr(voxel_noise, "FAR_Q", gap)
    parts = voxel_noise.deposit(flight.table, beams, model, SEEN)
    assert len(parts) > 1
    for name in ("amount", "squares"):
        total = getattr(whole, name).astype(np.int64)
        for part in parts:
            box = tuple(
                slice(a - c, a - c + n)
                for a, c, n in zip(part.corner, whole.corner, part.amount.shape, strict=True)
            )
            total[box] -= getattr(part, name)
        assert not total.any(), name


def test_deposit_against_every_sphere() -> None:
    flight = fly(shots=240, first_shot=12_360, detection=0.1)
    model, _ = run(flight)
    few = flight.table.take((flight.table["shot"] >= 12_420) & (flight.table["shot"] < 12_424))
    (part,) = voxel_noise.deposit(few, geometry.beams(few, flight.trajectory), model, SEEN)
    slow = slow_deposit(few, flight, model, part)
    assert part.amount / FIXED_POINT == pytest.approx(slow, abs=2e-5)
    assert slow.sum() > 1


@pytest.mark.parametrize(
    "scene",
    [
        {},
        {"surface": relief},
        {"surface": relief, "gate_kind": "surface"},
        {"gate_kind": "height", "gate_m": 280, "gate_ahead_m": 200},
        {"gate_m": 85},
        {"detection": 0.01, "noise_per_m": 7e-5, "shots": 9000},
        {"gains": np.where(np.arange(100) % 9 == 0, 0.05, 1.0)},
    ],
)
def test_expected_over_true(scene: dict[str, object]) -> None:
    flight = fly(**scene)  # type: ignore[arg-type]
    _, part = run(flight)
    expected = voxel_noise.density(part.amount, SEEN) * 1000.0
    index = [
        np.floor_divide(flight.table[k][flight.noise], 10_000) - part.corner[a]
        for a, k in enumerate("xyz")
    ]
    true = np.zeros(expected.shape)
    np.add.at(true, tuple(index), 1)
    assert expected.sum() / true.sum() == pytest.approx(1.0, abs=0.03)
    upper = np.s_[:, :, expected.shape[2] * 2 // 3 :]
    assert expected[upper].sum() / true[upper].sum() == pytest.approx(1.0, abs=0.06)


def test_published_gamma_overestimates_and_needs_its_sums() -> None:
    flight = fly(shots=1200)
    _, part = run(flight, PUBLISHED)
    assert part.shots is not None
    assert part.beamlets is not None
    density = voxel_noise.density(part.amount, PUBLISHED, shots=part.shots, beamlets=part.beamlets)
    per_shot = part.beamlets.sum() / part.shots.sum()
    assert 1 < per_shot < 100
    assert density.sum() * 1000 / flight.noise.sum() > 1.2
    with pytest.raises(ValueError, match="sums"):
        voxel_noise.density(part.amount, PUBLISHED)


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 6), st.booleans())
def test_parts_add_up_to_the_last_bit(intervals: int, published: bool) -> None:  # noqa: FBT001
    chosen = PUBLISHED if published else SEEN
    flight = fly(shots=500, scan_m=150)
    model, whole = run(flight, chosen)
    sums = {k: np.zeros_like(whole.amount) for k in ("amount", "shots", "beamlets")}
    squares = np.zeros((*whole.amount.shape, 16), dtype=np.int64)
    for table in cut(flight.table, 60 * intervals):
        (part,) = voxel_noise.deposit(
            table, geometry.beams(table, flight.trajectory), model, chosen
        )
        at = tuple(
            slice(c - w, c - w + n)
            for c, w, n in zip(part.corner, whole.corner, part.amount.shape, strict=True)
        )
        for name, total in sums.items():
            values = getattr(part, name)
            if values is not None:
                total[at] += values
        if part.squares is not None:
            squares[at] += part.squares
    assert np.array_equal(sums["amount"], whole.amount)
    if not published:
        assert np.array_equal(squares, whole.squares)
        assert squares.any()
    else:
        assert np.array_equal(sums["shots"], whole.shots)
        assert np.array_equal(sums["beamlets"], whole.beamlets)
