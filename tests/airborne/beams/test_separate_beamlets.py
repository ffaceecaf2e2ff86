"""Beamlets that files do not number are told apart by where they point."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.afterpulse import candidates
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams.separate_beamlets import number_beamlets, separate_beamlets
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import AfterpulseSettings
from tests.airborne.afterpulse.test_candidates import level, shots

SENSOR = load_preset("spl100")


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_directions_are_numbered_as_by_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 40, 3)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    beams = rng.integers(0, 6, (starts[-1], 2)) * 2e-4 + rng.normal(0, 5e-6, (starts[-1], 2))
    direction = np.column_stack([beams, -np.ones(len(beams))])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    found = np.zeros(len(beams), np.uint8)
    number_beamlets(starts, direction, 5e-5, found)
    for low, high in pairwise(starts):
        seen: list[np.ndarray] = []
        for i in range(low, high):
            off = [float(np.linalg.norm(direction[i] - one)) for one in seen]
            if off and min(off) < 5e-5:
                assert found[i] == int(np.argmin(off)) + 1
            else:
                seen.append(direction[i])
                assert found[i] == len(seen)


@pytest.mark.parametrize("late_s", [0.0, 2e-2])
def test_what_is_found_is_what_channels_tell(late_s: float) -> None:
    # Beams of these shots do not start at one place, which noise far from the ground would show.
    table, track, _ = shots(level, number=20, noise_per_m=0.0)
    beams = geometry.beams(table, track)
    plain = table.with_columns(channel=np.zeros(len(table), np.uint8))
    if late_s:
        # Times of the trajectory that are off turn all lines of sight alike.
        turn = np.array([1.7e-4 * late_s / 2e-2, 0.0, 0.0])
        beams = replace(beams, direction=beams.direction + turn)
    numbered, order = separate_beamlets(plain, beams, SENSOR)
    pairs = set(zip(table["gps_time"], table["channel"], strict=True))
    again = set(zip(numbered["gps_time"], numbered["channel"], strict=True))
    assert len(pairs) == len(again)
    both = {
        *zip(table["gps_time"][order], table["channel"][order], numbered["channel"], strict=True)
    }
    assert len(both) == len(pairs)
    given = candidates.assess(table, beams, AfterpulseSettings(), SENSOR)[0]
    found = candidates.assess(numbered, beams.take(order), AfterpulseSettings(), SENSOR)[0]
    np.testing.assert_allclose(found, given[order], atol=1e-6)


def test_returns_without_a_beam_are_of_none() -> None:
    table, track, _ = shots(level, number=3)
    beams = geometry.beams(table, track)
    beams.known[::5] = False
    numbered, order = separate_beamlets(table, beams, SENSOR)
    assert ((numbered["channel"] == 0) == ~beams.known[order]).all()
    assert sorted(order) == list(range(len(table)))
    assert (np.diff(numbered["gps_time"]) >= 0).all()
