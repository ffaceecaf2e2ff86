"""Line noise density, gate and gains of one flightline."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams.shot_runs import interval_rows, lag_behind, run_starts, share_out
from spl_batch.airborne.noise import line_noise, line_statistics
from spl_batch.airborne.noise.gains import active_channels
from spl_batch.airborne.noise.gate import Gate, fit_gate
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.noise.line_noise import choose_region
from spl_batch.airborne.noise.line_statistics import (
    BUFFER_LADDER,
    LONE_MOST,
    LONE_SPACINGS,
    STRAY_SHARE,
    SUPPORT,
)
from spl_batch.airborne.noise.noise_intervals import SUMMARY, densest_window, far_beyond
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.reported import texts
from spl_batch.lattice.tables import PointTable
from tests.flightlines import ALTITUDE_M, Flight, cut, fly, relief

SETTINGS = NoiseSettings()
SENSOR = load_preset("spl100")


def kinds(findings: Iterable[Finding]) -> list[str]:
    return [one.values.get("kind", "") for one in findings]


def model_of(flight: Flight, gate_m: float | None = None) -> LineModel:
    beams = geometry.beams(flight.table, flight.trajectory)
    stats = line_statistics.merge([line_statistics.observe(flight.table, beams, SETTINGS, gate_m)])
    return line_noise.fit(stats, SETTINGS, SENSOR.model_copy(update={"gate_m": gate_m}))


@pytest.mark.parametrize(
    ("scene", "gate_m", "tolerance"),
    [
        ({}, 300, 0.03),
        ({"surface": relief}, 300, 0.03),
        ({"surface": relief, "gate_kind": "surface"}, 300, 0.03),
        ({"gate_m": 85}, 85, 0.03),
        ({"gate_m": 85, "canopy_m": 25}, 85, 0.03),
        ({"detection": 0.01, "noise_per_m": 7e-5, "shots": 9000}, 300, 0.03),
        ({"gate_m": 25, "canopy_m": 8}, 25, 0.06),
        ({"gate_m": 10, "canopy_m": 3}, 10, 0.06),
    ],
)
def test_rate_and_gate(scene: dict[str, object], gate_m: float, tolerance: float) -> None:
    # Gates too short to be told from a scene have to be stated.
    model = model_of(fly(**scene), gate_m if gate_m < 60 else None)  # type: ignore[arg-type]
    truth = scene.get("noise_per_m", 1.3e-3)
    assert model.mean_rate == pytest.approx(truth, rel=tolerance)
    assert model.gate_m == pytest.approx(gate_m, rel=0.02)


def test_gate_cut_at_heights_is_told_from_one_in_range() -> None:
    flight = fly(surface=relief, gate_kind="height", gate_m=280, gate_ahead_m=220, scan_m=900)
    model = model_of(flight)
    assert model.kind == "range"  # one cone angle: the same thing
    tilted = fly(gate_kind="height", gate_m=280, scan_m=200, shots=1500)
    other = fly(gate_kind="height", gate_m=280, scan_m=1100, shots=1500, first_shot=13_845)
    columns = {k: np.concatenate([tilted.table[k], other.table[k]]) for k in tilted.table.columns}
    both = Flight(PointTable(columns), tilted.trajectory, np.empty(0, dtype=np.bool_))
    path = both.trajectory
    long = type(path)(
        path.time_s + np.array([0, 1]), path.xyz_m + np.array([[0, 0, 0], [90, 0, 0]]), 1e6
    )
    model = model_of(Flight(both.table, long, both.noise))
    assert model.kind == "height"
    top, bottom = ALTITUDE_M - (ALTITUDE_M - 40 - 140), 180 - 280
    assert np.median(model.near) == pytest.approx(top, abs=3)
    assert np.median(model.far) == pytest.approx(bottom, abs=3)


def test_points_without_noise_keep_a_negligible_rate() -> None:
    model = model_of(fly(noise_per_m=0.0, canopy_m=25, detection=0.4))
    assert model.mean_rate < 1e-7
    assert (model.gate_m, model.gate_basis) == (pytest.approx(300.0), "assumed")
    assert kinds(model.findings) == ["assumed"]


def test_stated_gate_is_used_and_contradiction_reported() -> None:
    flight = fly(shots=600)
    stated = model_of(flight, 300.0)
    assert (stated.gate_m, stated.gate_basis) == (pytest.approx(300.0, abs=1e-6), "stated")
    wrong = model_of(flight, 150.0)
    assert (wrong.gate_m, wrong.gate_basis) == (pytest.approx(300, abs=2), "estimated")
    assert model_of(flight).gate_basis == "estimated"
    assert wrong.findings[0].values["stated_m"] == 150.0


def windows(extents_m: dict[float, int], *, noise: int) -> tuple[np.ndarray, ...]:
    """Intervals, extremes and counts of noise of windows that fill so much of the range."""
    interval = np.concatenate(
        [64 * w + np.arange(n) for w, n in enumerate(extents_m.values())], dtype=np.int64
    )
    filled = np.repeat([*extents_m], [*extents_m.values()])
    summary = np.zeros((len(interval), len(SUMMARY)))
    column = {name: k for k, name in enumerate(SUMMARY)}
    summary[:, column["cosine"]] = 1.0
    for low, high in (("range_min", "range_max"), ("z_min", "z_max"), ("behind_min", "behind_max")):
        summary[:, column[low]], summary[:, column[high]] = -filled / 2, filled / 2
    outside = np.full((len(interval), 2, len(BUFFER_LADDER)), noise, dtype=np.int32)
    return interval, summary, outside


@pytest.mark.parametrize("stated", [None, 300.0])
@pytest.mark.parametrize("noise", [1000, 0])
def test_a_gate_has_one_length_whatever_is_said_of_it(stated: float | None, noise: int) -> None:
    # The longer window is shorter: the median over windows is none of what intervals have.
    counted = windows({400.0: 64, 520.0: 10}, noise=noise)
    gate = fit_gate(*counted, buffer_m=50.0, gate_m=stated)
    assert gate.length_m == pytest.approx(400.0, abs=0.1)
    if stated is not None:
        assert kinds(gate.warnings) == ["gate"]
    elif not noise:
        assert kinds(gate.warnings) == ["assumed"]
    else:
        assert gate.warnings == ()


@pytest.mark.parametrize("strays", [(-500.0, -430.0), (400.0,)])
def test_lone_returns_far_away_lengthen_no_gate(strays: tuple[float, ...]) -> None:
    flight = fly(shots=180)
    row = np.linspace(0.3, 0.7, len(strays)) * len(flight.table)
    z = flight.table["z"].copy()
    z[row.astype(int)] += np.array([1000 * away for away in strays], np.int32)
    hurt = replace(flight, table=flight.table.with_columns(z=z))
    for gate_m in (None, 300.0):
        sound, found = model_of(flight, gate_m), model_of(hurt, gate_m)
        assert found.mean_rate == pytest.approx(sound.mean_rate, rel=0.002)
        np.testing.assert_allclose(found.near, sound.near, atol=1.5)
        np.testing.assert_allclose(found.far, sound.far, atol=1.5)


@pytest.mark.parametrize(("count", "gate_m"), [(50, None), (1000, None), (8000, 200.0)])
def test_many_stray_returns_lengthen_no_gate(count: int, gate_m: float | None) -> None:
    flight = fly(shots=1500, gate_m=200)
    z = flight.table["z"].copy()
    z[np.linspace(0, len(z) - 1, count).astype(int)] += np.int32(-1_000_000)
    hurt = replace(flight, table=flight.table.with_columns(z=z))
    sound, found = model_of(flight, gate_m), model_of(hurt, gate_m)
    assert found.gate_m == pytest.approx(sound.gate_m, rel=0.01)
    # What is moved is missing from the noise.
    left = 1 - count / len(z)
    assert found.mean_rate == pytest.approx(sound.mean_rate * left, rel=0.02)
    beams = geometry.beams(hurt.table, hurt.trajectory)
    beyond = found.beyond_gate(hurt.table["shot"], beams.range_m, z / 1000.0)
    assert np.array_equal(beyond, (z != flight.table["z"]) & (gate_m is not None))
    # Of the fewer none has more than one other in its interval.
    assert ("strays" in kinds(found.findings)) == (count >= 1000)
    assert "strays" not in kinds(sound.findings)


@pytest.mark.parametrize("below", [30, 12])
def test_noise_beyond_haze_is_not_stray(below: int) -> None:
    rng = np.random.default_rng(4)
    intervals, half, rules = 200, 25.0, (SUPPORT, LONE_MOST, STRAY_SHARE, LONE_SPACINGS)
    thin, haze = rng.uniform(25, 120, (intervals, 30)), rng.uniform(40, 90, (intervals, 300))
    lower, ground = rng.uniform(-120, -25, (intervals, below)), np.zeros((intervals, 100))
    z = np.sort(np.hstack([lower, ground, thin, haze]), axis=1)
    noise = np.tile(np.array([330, below], np.int32), (intervals, 1))
    starts, gone = np.arange(intervals + 1) * z.shape[1], np.zeros(z.shape, np.bool_)
    rows = starts, z.ravel(), np.zeros(intervals), noise, half, rules, np.inf
    assert far_beyond(*rows, gone.ravel()) == 0
    z[:, -5:] += 500.0
    assert far_beyond(*rows, gone.ravel()) == 5 * intervals
    np.testing.assert_array_equal(gone, z > 120)


@pytest.mark.parametrize(("each", "below"), [(0.4, 1.0), (3.0, 0.05)])
def test_all_noise_of_a_sparse_night_lies_in_its_gate(each: float, below: float) -> None:
    """Noise below the ground may be rarer than above it, where few beamlets hear it."""
    rng = np.random.default_rng(3)
    m, half = 64 * 400, 150.0
    extremes = np.empty((2, m))
    for side, share in enumerate((1.0, below)):
        count = rng.poisson(share * each / 2, m)
        noise = half * rng.random(m) ** (1.0 / np.maximum(count, 1))
        extremes[side] = np.where(count > 0, noise, rng.uniform(0.0, 8.0, m))
    interval, summary, outside = windows({2 * half: m}, noise=0)
    summary[:, [4, 8]], summary[:, [5, 9]] = -extremes[0][:, None], extremes[1][:, None]
    summary[:, 6], summary[:, 7] = -extremes[1], extremes[0]
    outside[:] = rng.poisson(np.array([1.0, below])[:, None] * each / 2, (m, 2, 1))
    gate = fit_gate(interval, summary, outside, buffer_m=20.0, gate_m=None)
    assert gate.basis == "estimated"
    lost = (gate.near > -extremes[0]) | (gate.far < extremes[1])
    assert not lost.any()


def test_dead_and_weak_channels() -> None:
    gains = np.ones(100)
    gains[[3, 52]] = 0.0
    gains[[7, 8]] = 0.1
    model = model_of(fly(gains=gains))
    assert model.mean_rate == pytest.approx(1.3e-3 * gains.mean(), rel=0.02)
    assert model.gain[[4, 53]].tolist() == [0.0, 0.0]
    per_channel = model.gain[1:101] * model.mean_rate / 1.3e-3
    assert per_channel[[7, 8]] == pytest.approx([0.1, 0.1], abs=0.04)
    assert per_channel[20:50] == pytest.approx(np.ones(30), abs=0.15)
    (dead,) = (one.values for one in model.findings if one.code == "I07")
    assert (dead["dead"], dead["gaps"]) == (2, [4, 53])


@pytest.mark.parametrize(
    ("live", "gaps"),
    [
        ([2, 3, 5, 8], [4, 6, 7]),
        ([3, 4, 5, 7], [6]),
        ([3, 4, 5, 6], []),
        ([0, 10, 11, 12], [*range(1, 10)]),
    ],
)
def test_dead_channels_are_named(live: list[int], gaps: object) -> None:
    seen = np.zeros(256, dtype=np.int64)
    seen[live] = 100
    (one,) = active_channels(seen, 7)[2]
    assert (one.values["dead"], one.values["gaps"]) == (3, gaps)
    assert (one.values["first"], one.values["last"]) == (live[0], live[-1])
    assert ("have no gaps" in texts([one])[0]) == (not gaps)


def test_rate_follows_the_sky_and_density_the_model() -> None:
    def sky(shot: np.ndarray) -> np.ndarray:
        return 1e-3 * (1 + 0.6 * np.sin(shot / 2000))

    flight = fly(noise_per_m=sky, shots=9000)
    model = model_of(flight)
    middle = model.interval * 60 + 30
    assert model.rate == pytest.approx(sky(middle), rel=0.25)
    density = line_noise.line_density(flight.table, model)
    assert density.dtype == np.float64
    first = flight.table["shot"][0] // 60 == model.interval[0]
    assert first
    assert density[0] == pytest.approx(model.rate[0] * model.gain[flight.table["channel"][0]])


def test_hole_in_the_data_is_no_silence_and_silence_is_no_hole() -> None:
    flight = fly(shots=3000)
    keep = (flight.table["shot"] < 13_005) | (flight.table["shot"] > 14_500)
    holed = Flight(flight.table.take(keep), flight.trajectory, flight.noise[keep])
    assert model_of(holed).mean_rate == pytest.approx(1.3e-3, rel=0.03)
    assert np.diff(model_of(holed).interval).max() > 20
    quiet = model_of(fly(shots=9000, detection=0.0003, noise_per_m=1e-6))
    assert np.all(np.diff(quiet.interval) == 1)
    assert np.sum(quiet.seen_fraction == 0) > 3
    assert kinds(quiet.findings)[-1] == "few"


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 9), st.randoms(use_true_random=False))
def test_cutting_changes_no_bit(intervals: int, order: object) -> None:
    flight = fly(shots=700, surface=relief)
    parts = [
        line_statistics.observe(t, geometry.beams(t, flight.trajectory), SETTINGS)
        for t in cut(flight.table, 60 * intervals)
    ]
    order.shuffle(parts)  # type: ignore[attr-defined]
    model = line_noise.fit(line_statistics.merge(parts), SETTINGS, SENSOR)
    whole = model_of(flight)
    for name, values in whole.to_arrays().items():
        assert np.array_equal(values, model.to_arrays()[name]), name


def test_parts_must_not_share_an_interval() -> None:
    flight = fly(shots=120)
    part = line_statistics.observe(
        flight.table, geometry.beams(flight.table, flight.trajectory), SETTINGS
    )
    with pytest.raises(ValueError, match="share an interval"):
        line_statistics.merge([part, part])


@settings(deadline=None)
@given(st.lists(st.floats(-50, 50), min_size=1, max_size=40), st.floats(0.1, 20))
def test_densest_window_against_trying_all(values: list[float], width: float) -> None:
    ordered = np.sort(np.array(values))
    _, count = densest_window(ordered, width)
    assert count == max(int(np.sum((ordered >= v) & (ordered - v <= width))) for v in ordered)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0, 12)), min_size=1, max_size=30))
def test_lag_is_to_the_nearest_parent(rows: list[tuple[int, float]]) -> None:
    rows = sorted(rows, key=lambda row: row[0])
    channel, range_m = (np.array(v) for v in zip(*rows, strict=True))
    lag = np.empty(len(rows), dtype=np.float32)
    lag_behind(run_starts(channel), range_m.astype(float), 0.2, 5.0, lag)
    for i, (c, r) in enumerate(rows):
        lags = [r - q for d, q in rows if d == c and 0.2 <= r - q <= 5.0]
        assert lag[i] == pytest.approx(min(lags, default=0.0), rel=1e-6)


@settings(deadline=None)
@given(
    st.lists(st.integers(-40, 40), max_size=60),
    st.sets(st.integers(-4, 4), min_size=1),
    st.integers(1, 12),
)
def test_shots_find_their_interval_or_the_one_before(
    shots: list[int], numbers: set[int], length: int
) -> None:
    shot, interval = np.array(shots, np.int64), np.array(sorted(numbers), np.int64)
    row = interval_rows(shot, length, interval)
    before = ([k for k, number in enumerate(interval) if number <= s // length] for s in shots)
    assert row.tolist() == [max(rows, default=0) for rows in before]


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(-30, 30), st.integers(0, 1)), min_size=1, max_size=60),
    st.sampled_from([1, 2, 5]),
    st.lists(st.integers(0, 9), min_size=14, max_size=14),
)
def test_windows_count_the_shots_fired_and_the_beamlets_seen(
    beamlets: list[tuple[int, int]], window: int, ends: list[int]
) -> None:
    # Two shots may share a number: the second of each pair is a little later.
    shot, late = np.array(sorted(beamlets), np.int64).T.copy()
    time = shot + 0.25 * late
    low, high = np.sort(np.array(ends).reshape(2, 7), axis=0)
    row = shot // 10 + 3
    fired, seen = share_out(shot, time, window, 10, row, low, high)
    for i in range(len(shot)):
        mine = shot // window == shot[i] // window
        start = shot[i] // window * window - shot[i] // 10 * 10
        span = min(start + window - 1, high[row[i]]) - max(start, low[row[i]]) + 1
        assert seen[i] == mine.sum()
        assert fired[i] == max(span, len(set(time[mine])))


def test_a_window_that_has_a_beamlet_has_a_shot() -> None:
    # Shots of one time, as a clock that stands gives them, beyond the last that was fired.
    shot, row = np.array([0, 1, 2]), np.zeros(3, np.int64)
    none_fired = np.array([5]), np.array([4])
    fired, seen = share_out(shot, np.full(3, 7.0), 1, 10, row, *none_fired)
    assert fired.tolist() == seen.tolist() == [1, 1, 1]


@pytest.mark.parametrize(("above", "more"), [(2000, "above"), (500, "below")])
def test_a_side_with_more_returns_is_left_out(above: int, more: str) -> None:
    buffers = len(BUFFER_LADDER)
    outside = np.tile(np.array([[above], [1000]], np.int32), (1, 1, buffers)).reshape(1, 2, buffers)
    summary = np.zeros((1, len(SUMMARY)))
    summary[0, [SUMMARY.index("signal_range"), SUMMARY.index("cosine")]] = 2000.0, 1.0
    gate = Gate("range", np.array([1900.0]), np.array([2100.0]), 200.0, (), "stated")
    region = choose_region(outside, np.full((1, 2, buffers), 50.0), np.ones(1), gate, summary)
    (one,) = region.warnings
    assert one.values["times"] == pytest.approx(2.0)
    assert one.values["more"] == more != one.values["side"]
    assert region.sides == ((0.0, 1.0) if more == "above" else (1.0, 0.0))


def test_a_gate_without_room_for_noise_is_named_and_its_rate_is_finite() -> None:
    short, none = (
        model_of(fly(gate_m=length, canopy_m=canopy, shots=300), length)
        for length, canopy in ((10.0, 3.0), (6.0, 0.0))
    )
    assert kinds(short.findings) == kinds(none.findings) == ["full"]
    assert short.mean_rate > 0.0
    assert np.all(none.rate == 0.0)
