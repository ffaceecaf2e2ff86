"""Dependent returns take over labels as a plain loop over beamlets does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.beams.dependent_returns import (
    DEPENDENT_MIN,
    LAG_M,
    dependents,
    follow,
)
from spl_batch.airborne.beams.shot_runs import beamlets_of
from spl_batch.airborne.filter.denoise import denoise
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_BACKGROUND, NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from tests.airborne.filter.test_denoise import as_table


def beamlets(seed: int, n: int) -> tuple[PointTable, np.ndarray, np.ndarray]:
    """A few beamlets with several returns each, who depends, and labels."""
    rng = np.random.default_rng(seed)
    xyz = np.stack([np.zeros(n), np.zeros(n), rng.permutation(4 * n)[:n] * 700], axis=1)
    table = as_table(
        xyz,
        gps_time=rng.integers(0, 3, n).astype(np.float64),
        channel=rng.integers(0, 3, n).astype(np.uint8),
    )
    return table, rng.random(n) < 0.5, rng.choice([0, 0, 1, 255], n).astype(np.uint8)


def slow_follow(table: PointTable, dependent: np.ndarray, label: np.ndarray) -> np.ndarray:
    """From the highest return of each beamlet down."""
    out = label.copy()
    for i in np.argsort(-table["z"].astype(np.int64)):
        above = [
            j
            for j in range(len(out))
            if table["gps_time"][j] == table["gps_time"][i]
            and table["channel"][j] == table["channel"][i]
            and table["z"][j] > table["z"][i]
        ]
        if not dependent[i] or not above:
            continue
        front = min(above, key=lambda j: table["z"][j])
        near = table["z"][front] - table["z"][i] <= round(1000 * LAG_M)
        if near and out[front] != NOISE_NOT_ASSESSED:
            out[i] = out[front]
    out[dependent & (out == NOISE_BACKGROUND)] = NOISE_AFTERPULSE
    return out


@given(st.integers(0, 2**32 - 1), st.integers(0, 60))
@settings(max_examples=50, deadline=None)
def test_labels_are_taken_over_from_the_return_in_front(seed: int, n: int) -> None:
    table, dependent, label = beamlets(seed, n)
    usable = dependent | (np.arange(n) % 4 > 0)
    found = follow(table, beamlets_of(table), usable, dependent, label)
    rows = np.flatnonzero(usable)
    expected = slow_follow(table.take(rows), dependent[rows], label[rows])
    np.testing.assert_array_equal(found[rows], expected)
    np.testing.assert_array_equal(found[~usable], label[~usable])


def test_who_depends() -> None:
    table = as_table(np.zeros((3, 3)))
    assert not dependents(table).any()
    echo = np.array([0.0, DEPENDENT_MIN - 0.01, DEPENDENT_MIN + 0.01], np.float32)
    np.testing.assert_array_equal(dependents(table.with_columns(afterpulse=echo)), [0, 0, 1])


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_echoes_of_noise_do_not_vouch_for_each_other(share: float) -> None:
    rng = np.random.default_rng(6)
    n = 8000
    side = (n / 0.1) ** (1 / 3) * 1000
    noise = rng.uniform(0, side, (n, 3))
    echo = noise - rng.uniform([0, 0, 300], [200, 200, 2500], (n, 3))
    table = as_table(
        np.rint(np.concatenate([noise, echo])),
        gps_time=np.tile(np.arange(n, dtype=np.float64), 2),
        afterpulse=np.repeat(np.array([0.0, share], np.float32), n),
    )
    density = np.full(2 * n, 0.1)
    inner = np.all([np.abs(table[a] - side / 2) < 0.4 * side for a in "xyz"], axis=0)
    label = denoise(table, density, inner, FilterSettings())["noise_class"]
    kept = (label == NOISE_SIGNAL).mean()
    # alpha is 0.001, and what is kept comes in clusters.
    assert (kept < 0.003) if share else (kept > 0.005)
