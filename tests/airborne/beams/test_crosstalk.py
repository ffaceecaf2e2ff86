"""Crosstalk is found by its pairs side by side, and nothing else looks like it."""

import numpy as np
import pytest

from spl_batch.airborne.beams.crosstalk import (
    EVERY,
    chance,
    observe,
    set_off,
    share_of_returns,
    told,
)
from spl_batch.airborne.beams.crosstalk_pairs import count_pairs
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.lattice.tables import BeamTable, PointTable

SENSOR = load_preset("spl100")
PITCH = SENSOR.beamlet_pitch_urad * 1e-6
INTERVAL = 20 * EVERY


def directions(channel):
    """Unit vectors of an array of 10 x 10 that looks down."""
    row, column = (PITCH * (number - 4.5) for number in np.divmod(channel, 10))
    return np.stack([row, column, np.full(len(channel), -1.0)], axis=1)


def line(rng, *, chance=0.0, noise=8.0, shots=2000, wire=0.0, lean=0.13):
    """Ground at 2500 m, noise in 200 m, crosstalk, and in some of the shots a wire 40 m up."""
    channels, ranges, number = [], [], []
    for shot in range(shots):
        lit = np.flatnonzero(rng.random(100) < 0.6)
        far = rng.integers(0, 100, rng.poisson(noise))
        away = 2500 + rng.uniform(-100, 100, len(far))
        if rng.random() < wire:
            over = 10 * rng.integers(0, 10) + np.flatnonzero(rng.random(10) < 0.5)
            far = np.append(far, over)
            away = np.append(away, 2460 + lean * (over % 10) + rng.normal(0, 0.05, len(over)))
        channel = np.append(lit, far)
        range_m = np.append(2500 + lean * (lit % 10) + rng.normal(0, 0.05, len(lit)), away)
        for step, edge in ((-1, 0), (1, 9), (-10, None), (10, None)):
            hit = rng.random(len(channel)) < chance
            hit &= (
                channel % 10 != edge
                if edge is not None
                else (channel + step) // 10 % 10 == (channel + step) // 10
            )
            channel, range_m = (
                np.append(channel, channel[hit] + step),
                np.append(range_m, range_m[hit] + rng.normal(0, 0.03, hit.sum())),
            )
        channels.append(channel)
        ranges.append(range_m)
        number.append(np.full(len(channel), EVERY * shot))
    channel, range_m, shot = map(np.concatenate, (channels, ranges, number))
    n = len(shot)
    table = PointTable({"gps_time": shot / 60_000, "shot": shot.astype(np.int64)})
    beams = BeamTable(np.zeros((n, 3)), directions(channel), range_m, np.ones(n, np.bool_))
    return observe(table, beams, SENSOR, INTERVAL)


@pytest.mark.parametrize("noise", [0.5, 8.0])
def test_crosstalk_is_told_with_its_chance(noise):
    (remark,) = told(chance([line(np.random.default_rng(3), chance=0.05, noise=noise)]))
    assert remark.badness == pytest.approx(0.05, rel=0.15)
    assert "% of all returns" in remark.text
    assert share_of_returns(0.05) == pytest.approx(0.18 / 1.18)


def test_nothing_is_told_without_it_whatever_the_noise():
    for seed, noise in enumerate((0.0, 0.5, 8.0, 60.0)):
        assert not chance([line(np.random.default_rng(seed), noise=noise, shots=600)])


def test_wires_over_a_third_of_a_flightline_are_no_crosstalk():
    rng = np.random.default_rng(4)
    parts = [line(rng, noise=0.3, shots=400, wire=share) for share in (0.0, 0.5, 0.0)]
    for k, part in enumerate(parts):
        part["crosstalk"][:, 0] += 1000 * k
    assert parts[1]["crosstalk"][:, 2].sum() > 100, "the wire has returns side by side"
    assert not chance(parts)
    assert not chance(parts[::-1])


def test_patches_of_ground_between_towers_are_no_crosstalk_however_long_the_flightline():
    rng = np.random.default_rng(6)
    part = line(rng, noise=0.3, shots=400)["crosstalk"]
    # As many pairs, and as many of them side by side, as among towers of 45 to 60 m.
    part[:, 1:] = [100, 9, 12]
    whole = np.tile(part, (200, 1))
    whole[:, 0] = np.arange(len(whole))
    assert not chance([{"crosstalk": whole}])


def test_a_flightline_without_shots_tells_nothing():
    assert not told(chance([{"crosstalk": np.empty((0, 4), np.int64)}]))


def one_shot(*returns):
    """Which of some returns (channel, range [m]) are set off; another shot with as many follows."""
    channel, range_m = (np.tile(values, 2) for values in zip(*returns, strict=True))
    n = len(channel)
    table = PointTable({"gps_time": np.repeat([1.0, 1.1], n // 2)})
    beams = BeamTable(np.zeros((n, 3)), directions(channel), range_m, np.ones(n, np.bool_))
    found = set_off(table, beams, SENSOR)
    order = np.random.default_rng(1).permutation(n // 2)
    mixed = np.append(order, order + n // 2)
    again = set_off(table, beams.take(mixed), SENSOR)
    assert found[: n // 2].sum() == found[n // 2 :].sum() == again[: n // 2].sum()
    return found[: n // 2].tolist()


@pytest.mark.parametrize(
    ("returns", "others"),
    [
        ([(44, 2450.0), (45, 2450.05)], 1),
        ([(44, 2450.0), (45, 2450.05), (34, 2450.1), (43, 2449.98), (54, 2450.0)], 4),
        ([(44, 2450.0), (55, 2450.0)], 0),
        ([(44, 2450.0), (45, 2450.3)], 0),
        ([(44, 2450.0), (46, 2450.0)], 0),
        ([(44, 2450.0), (45, 2450.0), (80, 2450.4), (81, 2450.4)], 2),
        ([(k, 2500.0) for k in range(20)], 0),
        ([(44, 2450.0)], 0),
    ],
)
def test_of_returns_side_by_side_that_stand_alone_one_stays_evidence(returns, others):
    assert sum(one_shot(*returns)) == others


def test_no_returns_set_nothing_off():
    nothing = BeamTable(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.bool_))
    assert len(set_off(PointTable({"gps_time": np.zeros(0)}), nothing, SENSOR)) == 0


def test_pairs_agree_with_counting_all_of_them():
    rng = np.random.default_rng(5)
    sizes = rng.integers(1, 40, 60)
    starts = np.append(0, np.cumsum(sizes))
    channel = rng.integers(0, 100, starts[-1])
    range_m = (
        2500 + rng.choice([0.0, 45.0, 46.0, -60.0], starts[-1]) + rng.normal(0, 0.3, starts[-1])
    )
    direction = directions(channel)
    apart = (np.array([0.6, 1.25, 2.3]) * PITCH) ** 2
    counts = np.zeros((3, 3), np.int64)
    row = np.arange(60) % 3
    count_pairs(starts, range_m, direction, row, 30.0, 0.15, apart, counts)
    wanted = np.zeros((3, 3), np.int64)
    for s in range(60):
        at = np.sort(range_m[starts[s] : starts[s + 1]])
        inside = (at[:, None] <= at) & (at <= at[:, None] + 2.0)
        begin = int(np.argmax(inside.sum(axis=1)))
        low, high = at[begin], at[begin] + 0.0
        high = at[inside[begin]].max()
        mine = range_m[starts[s] : starts[s + 1]]
        far = (mine < low - 30) | (mine > high + 30)
        wanted[row[s], 0] += far.sum()
        lines = direction[starts[s] : starts[s + 1]][far]
        square = ((lines[:, None] - lines) ** 2).sum(axis=2)
        same = np.triu(abs(mine[far][:, None] - mine[far]) <= 0.15, 1)
        wanted[row[s], 1] += (same & (square >= apart[0]) & (square <= apart[1])).sum()
        wanted[row[s], 2] += (same & (square > apart[1]) & (square <= apart[2])).sum()
    assert wanted.min() > 0
    assert np.array_equal(counts, wanted)
