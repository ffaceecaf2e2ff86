"""The law of afterpulses is found in shots of one hard plane, whatever the sensor says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.afterpulse import afterpulse_law, candidates, lag_counts
from spl_batch.airborne.afterpulse.afterpulse_law import sensor_law
from spl_batch.airborne.afterpulse.lag_counts import (
    LAG_EDGES_M,
    SPREAD_STEP_M,
    SPREADS,
    STEP_M,
    law_at,
    no_counts,
    ranging_spread,
    rate_behind,
)
from spl_batch.airborne.afterpulse.law_warnings import disagreements, expected_and_seen, uneven
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.sensors.sensor import Sensor, load_preset
from spl_batch.airborne.settings import AfterpulseSettings
from spl_batch.airborne.simulate.detector import Receiver, draw_lag, truncated_exponential
from spl_batch.lattice.tables import BeamTable
from tests.airborne.afterpulse.test_candidates import shots

SENSOR = load_preset("spl100")


def flat(x: np.ndarray, _: np.ndarray) -> np.ndarray:
    return 30.0 + 0.1 * x


def observed(number: int = 400, **keys: float) -> dict[str, np.ndarray]:
    table, trajectory, _ = shots(flat, number=number, **keys)  # type: ignore[arg-type]
    table = table.with_columns(shot=np.rint(table["gps_time"] / 2e-5).astype(np.int64))
    return candidates.observe(table, geometry.beams(table, trajectory), SENSOR)


def counted(
    lags: np.ndarray, parents: int, spread_m: float = 0.05, noise: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Counts of so many returns of hard planes, some of which are followed."""
    counts, k = no_counts(), int(spread_m / SPREAD_STEP_M)
    counts.planes[k] = parents // 30
    counts.entries[k, 0] = parents
    for followers in (lags, [] if noise is None else noise):
        counts.followers[k] += np.histogram(followers, LAG_EDGES_M)[0]
    return {f"afterpulse_{name}": value for name, value in counts._asdict().items()}


def test_the_share_of_afterpulses_is_found() -> None:
    share = 0.25
    parts = [observed(afterpulses=share, seed=s) for s in range(2)]
    assert parts[0]["afterpulse_entries"].sum() > 3000
    law = afterpulse_law.fit(parts, 1e-3, SENSOR)
    assert law.probability == pytest.approx(share, abs=0.02)
    # Lags of these shots have no end: two in a hundred pass the 3 m that the sensor states.
    assert 3.0 <= law.longest_m < 6.0
    again = afterpulse_law.fit(parts[::-1], 1e-3, SENSOR)
    np.testing.assert_array_equal(law.density, again.density)
    assert law[:-1] == again[:-1]


def test_without_hard_surfaces_the_sensor_is_believed() -> None:
    rng = np.random.default_rng(5)
    heights = iter(rng.uniform(0, 12, 100_000))
    table, trajectory, _ = shots(lambda x, _: np.full(len(x), 30 + next(heights)), number=40)
    table = table.with_columns(shot=np.rint(table["gps_time"] / 2e-5).astype(np.int64))
    part = candidates.observe(table, geometry.beams(table, trajectory), SENSOR)
    assert part["afterpulse_entries"].sum() == 0
    law, stated = afterpulse_law.fit([part], 1e-3, SENSOR), sensor_law(SENSOR)
    assert law.probability == pytest.approx(SENSOR.afterpulse_probability, rel=1e-3)
    assert law.sigma_m == SENSOR.range_sigma_m
    np.testing.assert_allclose(law.density[:50], stated.density[:50], rtol=0.05)
    assert disagreements(law, SENSOR) == ()
    assert observed(channels=False, number=20)["afterpulse_entries"].sum() == 0  # type: ignore[arg-type]


@pytest.mark.parametrize(("scale", "longest"), [(0.3, 3.0), (0.7, 1.8)])
def test_what_the_simulator_draws_is_what_the_fit_finds(scale: float, longest: float) -> None:
    sensor = SENSOR.model_copy(update={"afterpulse_lag_max_m": longest})
    rng, count = np.random.default_rng(7), 40_000
    drawn = [truncated_exponential.py_func(rng, scale, longest - sensor.dead_m)
             for _ in range(count)]  # fmt: skip
    law = afterpulse_law.fit([counted(sensor.dead_m + np.array(drawn), 200_000)], 0.0, sensor)
    assert law.probability == pytest.approx(0.2, rel=0.01)
    assert law.longest_m == pytest.approx(longest, abs=0.06)
    lag = np.arange(0.3, min(longest, 4 * scale), 0.1)
    window = longest - sensor.dead_m
    true = 0.2 * np.exp(-(lag - sensor.dead_m) / scale) / scale / -np.expm1(-window / scale)
    at = [law_at(float(x), law.dead_m, law.density) for x in lag]
    np.testing.assert_allclose(at, true, rtol=0.12)


@pytest.mark.parametrize(("power", "longest"), [(0.0, 8.0), (1.5, 30.0)])
def test_a_tail_is_followed_as_deep_as_it_goes(power: float, longest: float) -> None:
    receiver = Receiver(SENSOR.dead_m, 0.25, 0.7, longest, 0.4, 4.0 if power == 0 else 0.5, power)
    rng = np.random.default_rng(3)
    parents, noise = 60_000, 2e-3
    lags = np.array([draw_lag.py_func(rng, receiver) for _ in range(parents // 4)])
    behind = rng.exponential(1 / noise, parents - len(lags))
    part = counted(lags, parents, noise=behind)
    law = afterpulse_law.fit([part], noise, SENSOR)
    assert 0.6 * longest < law.longest_m < 1.2 * longest
    assert law.probability == pytest.approx(0.25, abs=0.01)
    late = float(np.mean(lags > 3.0))
    assert law.later_than(3.0) == pytest.approx(late, abs=0.03)
    (said,) = disagreements(law, SENSOR)
    assert (said.code, said.values["longest_m"]) == ("A01", law.longest_m)


def test_stretches_that_do_not_follow_the_law_are_named() -> None:
    rng = np.random.default_rng(6)
    parents, noise = 20_000, 2e-3

    def part(share: float) -> dict[str, np.ndarray]:
        lags = SENSOR.dead_m + rng.exponential(0.7, int(share * parents))
        return counted(lags, parents, noise=rng.exponential(1 / noise, parents - len(lags)))

    spans = [(10.0 * k, 10.0 * k + 10.0) for k in range(4)]
    for shares, odd in (((0.15,) * 4, False), ((0.15, 0.15, 0.15, 0.4), True)):
        parts = [part(share) for share in shares]
        law = afterpulse_law.fit(parts, noise, SENSOR)
        due, seen = zip(*(expected_and_seen(p, law, noise, 3.0) for p in parts), strict=True)
        assert sum(due) == pytest.approx(sum(seen), rel=0.03)
        said = uneven(parts, spans, law, noise, SENSOR)
        assert len(said) == odd
        assert not odd or (said[0].values["first_s"], said[0].values["last_s"]) == (30.0, 40.0)


@pytest.mark.parametrize(("parents", "more"), [(10_000, 1.0), (300_000, 0.3)])
def test_noise_that_falls_along_the_gate_makes_no_tail(parents: int, more: float) -> None:
    rng = np.random.default_rng(1)
    depth = np.arange(0.0, 80.0, 0.02)
    hazard = 1.2e-3 * (1.0 + more * np.maximum(1.0 - depth / 60.0, 0.0))
    behind = np.interp(rng.exponential(1, parents), 0.02 * np.cumsum(hazard), depth, right=99.0)
    lags = SENSOR.dead_m + rng.exponential(0.5, parents // 7)
    lags = lags[lags < 3.0]
    for model in (1.2e-3, 1.6e-3):
        part = counted(lags, parents, noise=behind[len(lags) :])
        law = afterpulse_law.fit([part], model, SENSOR)
        assert disagreements(law, SENSOR) == ()


def test_few_planes_and_the_ground_behind_bright_points_make_no_tail() -> None:
    rng = np.random.default_rng(2)

    def law(parents: int, share: float) -> afterpulse_law.AfterpulseLaw:
        near = SENSOR.dead_m + rng.uniform(0, 2.7, parents // 8)
        late = rng.uniform(3.0, 7.0, round(share * parents))
        rest = rng.exponential(1 / 1.6e-3, parents - len(near) - len(late))
        return afterpulse_law.fit([counted(np.concatenate([near, late]), parents, noise=rest)],
                                  1.6e-3, SENSOR)  # fmt: skip

    for parents in (2_000, 14_000, 140_000):
        assert disagreements(law(parents, 0.0075), SENSOR) == ()
    assert disagreements(law(600, 0.1), SENSOR) == ()
    (said,) = disagreements(law(14_000, 0.03), SENSOR)
    assert said.values["longest_m"] == pytest.approx(7.0, abs=0.5)


@pytest.mark.parametrize(("spread", "found"), [(0.03, 0.05), (0.055, 0.05), (0.155, 0.16)])
def test_the_ranging_spread_is_what_planes_show(spread: float, found: float) -> None:
    rng = np.random.default_rng(1)
    planes = np.zeros(SPREADS, np.int64)
    of_planes = spread * rng.normal(1.0, 0.12, 2000)
    # Half of the planes are overgrown.
    of_planes[::2] += rng.exponential(0.1, 1000)
    np.add.at(planes, (of_planes / SPREAD_STEP_M).astype(int).clip(0, SPREADS - 1), 1)
    assert ranging_spread(planes, SENSOR) == pytest.approx(found, rel=0.1)
    assert ranging_spread(planes * 0, SENSOR) == SENSOR.range_sigma_m


def test_planes_of_heath_tell_no_ranging_spread() -> None:
    rng = np.random.default_rng(2)
    for least, mean in ((0.05, 0.2), (0.15, 0.3)):
        of_planes = least + rng.gamma(2.0, mean / 2.0, 3000)
        planes = np.bincount((of_planes / SPREAD_STEP_M).astype(int).clip(0, SPREADS - 1))
        assert ranging_spread(planes, SENSOR) == SENSOR.range_sigma_m


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_what_follows_a_plane_is_counted_as_by_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, spread = int(rng.integers(12, 60)), 0.06
    channel = np.arange(n, dtype=np.uint8)
    distance = rng.normal(0, 0.06, n)
    chosen = rng.random(n) < 0.5
    lags = 0.1 + rng.exponential(4.0, n)[chosen]
    channel = np.concatenate([channel, channel[chosen]])
    w = np.concatenate([distance, distance[chosen] + lags])
    lag = np.concatenate([np.zeros(n), lags]).astype(np.float32)
    order = np.lexsort([rng.random(len(w)), channel])
    channel, w, lag = channel[order], w[order], lag[order]
    rules = candidates.hard_rules(AfterpulseSettings(), SENSOR, sensor_law(SENSOR))
    counts = no_counts()
    lag_counts._observe(w, channel, lag, w.copy(), spread, 0.7, rules, LAG_EDGES_M, counts)
    entries, followers = np.zeros((2, len(LAG_EDGES_M) - 1), np.int64)
    near = [i for i in range(len(w)) if lag[i] == 0 and abs(w[i]) <= 0.3]
    scale = np.sqrt(sum(w[i] ** 2 for i in near) / (len(near) - 3))
    for i in near:
        begin = int(np.sum(max(2.5 * scale - w[i], 0.0) > LAG_EDGES_M))
        later = sorted(w[(channel == channel[i]) & (w > w[i])] - w[i])
        at = int(np.sum(later[0] >= LAG_EDGES_M)) - 1 if later else 10**6
        entries[begin] += at >= begin
        if begin <= at < len(followers):
            followers[at] += 1
    k = int(0.7 * scale / SPREAD_STEP_M)
    assert counts.planes.sum() == counts.planes[k] == 1
    np.testing.assert_array_equal(counts.entries[k], entries)
    np.testing.assert_array_equal(counts.followers[k], followers)


def test_tilted_planes_spread_by_the_width_of_the_beam_too() -> None:
    sigma_m = width_m = 0.05
    for tilt in (0.0, 0.4, 1.0, 1.7):
        along = np.hypot(sigma_m, width_m * tilt)
        found = along * lag_counts._square(np.array([3.0, 0.6 * tilt, 0.8 * tilt]))
        assert sigma_m <= found <= 1.15 * sigma_m


def test_lags_that_no_dead_time_or_search_admits_are_refused() -> None:
    for facts, said in (
        ({**SENSOR.model_dump(), "afterpulse_lag_max_m": 0.2},
         r"(?s)afterpulse_lag_max_m.*must exceed .* 0\.240 m"),
        ({"name": "slow", "dead_time_ns": 30.0}, r"must exceed the dead time, 4\.497 m"),
        ({"name": "slow", "dead_time_ns": 401.0, "afterpulse_lag_max_m": 70.0},
         r"(?s)dead_time_ns.*must be below 400 ns"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=said):
            Sensor.model_validate(facts)


@pytest.mark.parametrize(("dead_ns", "longest"), [(1.6, 0.241), (1.4, 0.21), (399.0, 70.0)])
def test_any_sensor_that_is_admitted_has_a_law(dead_ns: float, longest: float) -> None:
    sensor = Sensor(dead_time_ns=dead_ns, afterpulse_lag_max_m=longest)
    drawn = np.random.default_rng(5).uniform(sensor.dead_m, longest, 8_000)
    for lags, share in ((drawn, 0.2), (drawn[:0], 0.0)):
        law = afterpulse_law.fit([counted(lags, 40_000)], 1e-4, sensor)
        seen = float(np.mean(lags < LAG_EDGES_M[-1])) if len(lags) else 0.0
        assert law.probability == pytest.approx(share * seen, abs=0.005)
        assert law.longest_m == longest
        assert np.isfinite(law.density).all()
        assert disagreements(law, sensor) == ()


@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
@settings(max_examples=40, deadline=None)
def test_rates_add_up_over_all_parents(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    beamlet = np.sort(rng.integers(0, 4, n))
    range_m = rng.uniform(100, 106, n)
    starts = np.searchsorted(beamlet, np.arange(5)).astype(np.int64)
    law = sensor_law(SENSOR)
    density = rng.uniform(0, 1, len(law.density))
    found = np.empty(n, np.float32)
    rate_behind(starts, range_m, law.least_m, law.longest_m, law.dead_m, density, found)
    nodes = law.dead_m + STEP_M * np.arange(len(density))
    for i in range(n):
        lags = range_m[i] - range_m[beamlet == beamlet[i]]
        lags = lags[(lags >= law.least_m) & (lags <= law.longest_m)]
        total = np.interp(lags, nodes, density).sum()
        assert found[i] == pytest.approx(total, rel=1e-5, abs=1e-7)


def test_the_law_integrates_to_its_probability() -> None:
    law = sensor_law(SENSOR)
    lag = np.arange(law.dead_m, law.longest_m, 0.001)
    total = sum(0.001 * law_at(float(step), law.dead_m, law.density) for step in lag)
    assert total == pytest.approx(law.probability, rel=0.01)


def test_rows_without_beams_or_channels_have_no_rate() -> None:
    table, trajectory, _ = shots(flat, number=10)
    beams = geometry.beams(table, trajectory)
    settings = AfterpulseSettings()
    assert (candidates.assess(table, beams, settings, SENSOR)[1] > 0).any()
    unknown = BeamTable(
        beams.origin_m, beams.direction, beams.range_m, np.zeros(len(table), np.bool_)
    )
    assert not candidates.assess(table, unknown, settings, SENSOR)[1].any()
    plain = table.with_columns(channel=np.zeros(len(table), np.uint8))
    assert not candidates.assess(plain, beams, settings, SENSOR)[1].any()
