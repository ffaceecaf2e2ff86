"""The law of afterpulses is found in shots of one hard plane, whatever the sensor says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.afterpulse import afterpulse_law, candidates
from spl_batch.airborne.afterpulse.afterpulse_law import (
    BIN_M,
    scale_of_mean,
    sensor_law,
    truncated_mean,
)
from spl_batch.airborne.afterpulse.lag_counts import rate_behind
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.sensors.sensor import Sensor, load_preset
from spl_batch.airborne.simulate.detector import truncated_exponential
from spl_batch.lattice.tables import BeamTable
from tests.airborne.afterpulse.test_candidates import shots

SENSOR = load_preset("spl100")


def flat(x: np.ndarray, _: np.ndarray) -> np.ndarray:
    return 30.0 + 0.1 * x


def observed(number: int = 400, **keys: float) -> dict[str, np.ndarray]:
    table, trajectory, _ = shots(flat, number=number, **keys)  # type: ignore[arg-type]
    table = table.with_columns(shot=np.rint(table["gps_time"] / 2e-5).astype(np.int64))
    return candidates.observe(table, geometry.beams(table, trajectory), SENSOR)


@pytest.mark.parametrize("share", [0.08, 0.25])
def test_the_share_of_afterpulses_is_found(share: float) -> None:
    parts = [observed(afterpulses=share, seed=s) for s in range(2)]
    assert parts[0]["afterpulse_parents"][0] > 3000
    law = afterpulse_law.fit(parts, 1e-3, SENSOR)
    assert law.probability == pytest.approx(share, abs=0.02)
    assert law.scale_m == pytest.approx(0.7, abs=0.08)
    assert law == afterpulse_law.fit(parts[::-1], 1e-3, SENSOR)


def test_background_is_not_taken_for_afterpulses() -> None:
    parts = [observed(afterpulses=0.1, noise_per_m=4e-3, seed=3)]
    law, blind = (afterpulse_law.fit(parts, rate, SENSOR) for rate in (4e-3, 0.0))
    assert law.probability == pytest.approx(0.1, abs=0.015)
    assert blind.probability > law.probability + 0.006


def test_without_hard_surfaces_the_sensor_is_believed() -> None:
    rng = np.random.default_rng(5)
    heights = iter(rng.uniform(0, 12, 100_000))
    table, trajectory, _ = shots(lambda x, _: np.full(len(x), 30 + next(heights)), number=40)
    table = table.with_columns(shot=np.rint(table["gps_time"] / 2e-5).astype(np.int64))
    part = candidates.observe(table, geometry.beams(table, trajectory), SENSOR)
    assert part["afterpulse_parents"][0] == 0
    law = afterpulse_law.fit([part], 1e-3, SENSOR)
    assert law.probability == pytest.approx(SENSOR.afterpulse_probability)
    assert law.scale_m == pytest.approx(SENSOR.afterpulse_scale_m, rel=1e-6)
    assert observed(channels=False, number=20)["afterpulse_parents"][0] == 0  # type: ignore[arg-type]


@pytest.mark.parametrize(("scale", "longest"), [(0.3, 3.0), (0.7, 3.0), (1.0, 3.0), (0.7, 1.8)])
def test_what_the_simulator_draws_is_what_the_fit_finds(scale: float, longest: float) -> None:
    sensor = SENSOR.model_copy(update={"afterpulse_lag_max_m": longest})
    rng, count = np.random.default_rng(7), 40_000
    drawn = [truncated_exponential.py_func(rng, scale, longest - sensor.dead_m)
             for _ in range(count)]  # fmt: skip
    lags = np.histogram(sensor.dead_m + np.array(drawn), bins=round(longest / BIN_M),
                        range=(0.0, longest))[0]  # fmt: skip
    part = {"afterpulse_parents": np.array([200_000]), "afterpulse_lags": lags}
    law = afterpulse_law.fit([part], 0.0, sensor)
    assert law.probability == pytest.approx(0.2, rel=0.01)
    assert law.scale_m == pytest.approx(scale, rel=0.03)
    assert law.longest_m == longest


def test_a_longest_lag_within_the_dead_time_is_refused() -> None:
    with pytest.raises(ValueError, match=r"(?s)afterpulse_lag_max_m.*must exceed .* 0\.240 m"):
        Sensor.model_validate({**SENSOR.model_dump(), "afterpulse_lag_max_m": 0.2})
    with pytest.raises(ValueError, match=r"must exceed the dead time, 4\.497 m"):
        Sensor.model_validate({"name": "slow", "dead_time_ns": 30.0})


@given(st.floats(0.06, 4.0), st.floats(1.0, 6.0))
def test_scale_and_mean_are_inverse(scale: float, window: float) -> None:
    assert scale_of_mean(truncated_mean(scale, window), window) == pytest.approx(scale, rel=1e-3)


def test_truncated_mean_is_that_of_a_sample() -> None:
    sample = np.random.default_rng(1).exponential(0.7, 400_000)
    assert truncated_mean(0.7, 1.5) == pytest.approx(sample[sample < 1.5].mean(), abs=0.003)


@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
@settings(max_examples=40, deadline=None)
def test_rates_add_up_over_all_parents(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    beamlet = np.sort(rng.integers(0, 4, n))
    range_m = rng.uniform(100, 106, n)
    starts = np.searchsorted(beamlet, np.arange(5)).astype(np.int64)
    law = sensor_law(SENSOR)
    found = np.empty(n, np.float32)
    rate_behind(starts, range_m, law.least_m, law.longest_m, law.dead_m, 0.2, 0.5, found)
    for i in range(n):
        lags = range_m[i] - range_m[beamlet == beamlet[i]]
        lags = lags[(lags >= law.least_m) & (lags <= law.longest_m)]
        density = np.exp(-np.maximum(lags - law.dead_m, 0) / 0.5) / 0.5
        total = 0.2 * density.sum() / (1 - np.exp(-(law.longest_m - law.dead_m) / 0.5))
        assert found[i] == pytest.approx(total, rel=1e-5, abs=1e-7)


def test_the_law_integrates_to_its_probability() -> None:
    law = sensor_law(SENSOR)._replace(probability=0.2, scale_m=0.5)
    lag = np.arange(law.dead_m, law.longest_m, 0.001)
    rate = np.empty(2, np.float32)
    total = 0.0
    for step in lag:
        rate_behind(
            np.array([0, 2]), np.array([100.0, 100.0 + step]), law.least_m, law.longest_m,
            law.dead_m, law.probability, law.scale_m, rate,
        )  # fmt: skip
        total += 0.001 * float(rate[1])
    assert total == pytest.approx(0.2, rel=0.01)


def test_rows_without_beams_or_channels_have_no_rate() -> None:
    table, trajectory, _ = shots(flat, number=10)
    beams = geometry.beams(table, trajectory)
    law = sensor_law(SENSOR)
    rate = afterpulse_law.rate(table, beams, law)
    assert (rate > 0).any()
    unknown = BeamTable(
        beams.origin_m, beams.direction, beams.range_m, np.zeros(len(table), np.bool_)
    )
    assert not afterpulse_law.rate(table, unknown, law).any()
    plain = table.with_columns(channel=np.zeros(len(table)))
    assert not afterpulse_law.rate(plain, beams, law).any()
