"""Bloom is found in the shots that have it, and in no others."""

import numpy as np
import pytest

from spl_batch.airborne.beams.bloom import (
    BEHIND_M,
    FILLED,
    SPREAD,
    WINDOW,
    find_bloom,
    find_unnumbered,
)
from spl_batch.airborne.beams.bloom_shots import BINS, OFTEN, PART, SURE, _most_in_two
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.lattice.tables import BeamTable, PointTable

SIGMA_M = 0.05


def shot(rng, *, bright=None, electrons=9.0, seen=0.66, lean=1.3, ground=2500.0, behind=0.0):
    """Ranges and channels of one shot: a leaning plane, afterpulses behind it, and a bloom."""
    channel = np.arange(1, 101)
    plane = ground + lean * ((channel - 1) % 10 / 9 - 0.5)
    lit = rng.random(100) < seen
    ranges, channels = [plane[lit]], [channel[lit]]
    late = lit & (rng.random(100) < behind)
    ranges.append(plane[late] + rng.exponential(0.7, late.sum()) + 0.3)
    channels.append(channel[late])
    if bright is not None:
        reached = channel[rng.random(100) < -np.expm1(-electrons)]
        ranges.append(np.full(len(reached), bright))
        channels.append(reached)
    ranges = np.concatenate(ranges)
    return ranges + rng.normal(0, SIGMA_M, len(ranges)), np.concatenate(channels)


def found(shots):
    time = np.concatenate([np.full(len(r), k / 60_000) for k, (r, _) in enumerate(shots)])
    channel = np.concatenate([c for _, c in shots])
    ranges = np.concatenate([r for r, _ in shots])
    n = len(ranges)
    beams = BeamTable(np.zeros((n, 3)), np.zeros((n, 3)), ranges, np.ones(n, np.bool_))
    number = np.rint(time * 60_000).astype(np.int64)
    table = PointTable({"gps_time": time, "channel": channel.astype(np.uint8), "shot": number})
    return find_bloom(table, beams, run_starts(time), 100, SIGMA_M, 60), time, ranges


@pytest.mark.parametrize("above", [1.5, 6.0])
def test_a_bright_point_is_found_and_the_ground_behind_it_stays(above):
    rng = np.random.default_rng(1)
    shots = [shot(rng) for _ in range(20)]
    shots[7] = shot(rng, bright=2500.0 - above)
    bloom, time, ranges = found(shots)
    assert bloom.shots == 1
    assert set(time[bloom.returns]) == {7 / 60_000}
    assert np.abs(ranges[bloom.returns] - (2500.0 - above)).max() <= WINDOW * SIGMA_M
    assert 90 <= bloom.returns.sum() <= 100 + 30
    assert set(time[bloom.of_shots]) == {7 / 60_000}
    assert bloom.of_shots.sum() == (time == 7 / 60_000).sum()


def test_without_channel_numbers_beams_tell_the_same_bloom():
    rng = np.random.default_rng(13)
    shots = [shot(rng, behind=0.2) for _ in range(40)]
    shots[7], shots[30] = (shot(rng, bright=2497.0, electrons=some) for some in (9.0, 1.0))
    numbered, time, ranges = found(shots)
    channel = np.concatenate([channels for _, channels in shots])
    sensor = Sensor(beamlets=100, beamlet_pitch_urad=200.0)
    direction = np.column_stack([(channel - 1) % 10, (channel - 1) // 10, 0 * channel]) * 200e-6
    direction[:, 2] = -np.sqrt(1.0 - (direction**2).sum(axis=1))
    n = len(ranges)
    beams = BeamTable(np.zeros((n, 3)), direction, ranges, np.ones(n, np.bool_))
    number = np.rint(time * 60_000).astype(np.int64)
    table = PointTable({"gps_time": time, "channel": np.zeros(n, np.uint8), "shot": number})
    bloom = find_unnumbered(table, beams, sensor, SIGMA_M, 60)
    assert bloom.shots == numbered.shots == 2
    assert np.array_equal(bloom.returns, numbered.returns)
    assert np.array_equal(bloom.of_shots, numbered.of_shots)


@pytest.mark.parametrize("electrons", [0.7, 1.0, 2.0])
def test_a_point_that_lights_a_part_of_the_channels_is_found(electrons):
    rng = np.random.default_rng(9)
    shots = [shot(rng) for _ in range(300)]
    for k in range(0, 300, 30):
        shots[k] = shot(rng, bright=2497.0, electrons=electrons)
    bloom, time, _ = found(shots)
    assert bloom.shots >= 9
    assert set(np.rint(time[bloom.returns] * 60_000).astype(int) % 30) == {0}


def test_a_surface_that_lets_light_pass_is_no_bloom_where_shots_around_see_it_too():
    """As clear water below the sensor, with its bottom; alone, such a shot could be a point."""
    rng = np.random.default_rng(10)
    shots = [shot(rng) for _ in range(240)]
    for k in range(60, 120):
        shots[k] = shot(rng, bright=2497.0, electrons=1.0)
    shots[200] = shots[80]
    bloom, time, _ = found(shots)
    assert set(time[bloom.returns]) == {200 / 60_000}


def test_surfaces_are_no_bloom_however_bright_and_square_to_the_beam():
    rng = np.random.default_rng(2)
    shots = [
        shot(rng, seen=seen, lean=lean, behind=behind)
        for seen in (0.3, 0.7, 0.97)
        for lean in (0.0, 1.3)
        for behind in (0.0, 0.25)
    ]
    assert found(shots)[0].shots == 0


def test_a_roof_beside_ground_is_no_bloom():
    rng = np.random.default_rng(3)
    ranges, channels = shot(rng, seen=0.98, lean=0.0)
    ranges[channels > 85] -= 5.0
    assert found([(ranges, channels)])[0].shots == 0


@pytest.mark.parametrize("leaves", [0.1, 0.45, 0.9])
@pytest.mark.parametrize("seen", [0.85, 0.97])
@pytest.mark.parametrize("lean", [0.0, 0.3, 1.3])
def test_ground_under_thin_trees_is_no_bloom(leaves, seen, lean):
    """A slope that faces the scan is seen at one range, with leaves before it."""
    rng = np.random.default_rng(6)
    shots = []
    for _ in range(60):
        ground, channel = shot(rng, seen=seen, lean=lean, behind=0.1)
        struck = np.flatnonzero(rng.random(100) < leaves) + 1
        ranges = np.concatenate([ground, 2500.0 - rng.uniform(3.0, 10.0, len(struck))])
        shots.append((ranges, np.concatenate([channel, struck])))
    assert found(shots)[0].shots == 0


@pytest.mark.parametrize("top", [0.6, 0.8])
def test_a_level_hedge_square_to_the_beam_is_no_bloom(top):
    rng = np.random.default_rng(7)
    shots = []
    for _ in range(60):
        ground, channel = shot(rng, lean=0.0, seen=0.5)
        struck = np.flatnonzero(rng.random(100) < top) + 1
        leaves = 2498.0 + rng.uniform(0.0, 0.4, len(struck))
        shots.append((np.concatenate([leaves, ground]), np.concatenate([struck, channel])))
    assert found(shots)[0].shots == 0


@pytest.mark.parametrize("most", [20, 60])
def test_a_shot_is_judged_alike_in_any_company(most):
    """How a flightline is cut into stretches depends on the memory, and must decide nothing."""
    rng = np.random.default_rng(8)
    ranges, channels = shot(rng, bright=2498.0)
    part = channels <= most
    alone = found([(ranges[part], channels[part])])[0].shots
    assert alone == (most >= FILLED * 100)
    assert alone == found([(ranges[part], channels[part]), shot(rng)])[0].shots


def test_few_channels_tell_nothing():
    rng = np.random.default_rng(4)
    ranges, channels = shot(rng, bright=2498.0)
    few = channels <= 10
    assert found([(ranges[few], channels[few])])[0].shots == 0


def test_what_is_found_agrees_with_looking_at_each_window():
    rng = np.random.default_rng(5)
    shots = []
    for _ in range(60):
        r, c = shot(rng, bright=2500.0 + rng.uniform(-3, 3), electrons=rng.uniform(0.2, 3.0))
        shots.append((r, c))
        shots.extend(shot(rng, lean=9.0) for _ in range(9))
    bloom, time, _ = found(shots)
    width = WINDOW * SIGMA_M
    for k, (r, c) in enumerate(shots):
        inside = max(
            ((low <= r) & (r <= low + width) for low in np.sort(r)),
            key=lambda window: window.sum(),
        )
        low = r[inside].min()
        near = (r > low + width) & (r <= low + width + BEHIND_M)
        held, passed = set(c[inside]), set(c[inside]) & set(c[near])
        n = len(held)
        least = max(PART * n, OFTEN * n + SURE * np.sqrt(OFTEN * (1 - OFTEN) * n))
        sharp = np.std(r[inside]) <= SPREAD * SIGMA_M
        want = sharp and n >= FILLED * 100 and len(passed) >= least
        assert bool(bloom.returns[time == k / 60_000].any()) == want
    assert 15 < bloom.shots < 55


@pytest.mark.parametrize("spread_m", [0.5, 30.0, 3000.0])
def test_what_two_bins_hold_is_no_less_than_what_any_window_does(spread_m):
    rng, bins = np.random.default_rng(12), np.zeros(BINS, np.int32)
    for _ in range(200):
        near, width = np.sort(2500.0 + spread_m * rng.random(100)), 0.3
        fullest = max(np.count_nonzero((near >= low) & (near - low <= width)) for low in near)
        assert _most_in_two(near, width, bins) >= fullest
        assert not bins.any()
