"""Differential cell count."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import poisson

from spl_batch.airborne.beams.differential_cell_count import dcc_keep, dcc_threshold


def slow_dcc(ranges: list[float], gate: float, coarse: float, fine: float) -> list[bool]:
    cells = [math.floor(r / coarse) for r in ranges]
    best = min(set(cells), key=lambda c: (-cells.count(c), c))
    near = [abs(c - best) <= 1 for c in cells]
    outside = max(len(ranges) - sum(near), 0.5)
    noise = outside * fine / max(gate - 3 * coarse, coarse)
    signal = sum(near) / 3
    threshold = (signal + math.log(max(gate / fine, 1))) / math.log(1 + signal / noise)
    bins = [math.floor(r / fine) for r in ranges]
    inside = [b for b, ok in zip(bins, near, strict=True) if ok]
    return [ok and inside.count(b) >= threshold for b, ok in zip(bins, near, strict=True)]


@settings(deadline=None)
@given(
    st.lists(st.floats(2900, 3200) | st.sampled_from([-1e5, 1e5]), min_size=1, max_size=60),
    st.sampled_from([40.0, 85.0, 300.0]),
)
def test_against_plain_python(ranges: list[float], gate: float) -> None:
    keep = np.empty(len(ranges), dtype=np.bool_)
    dcc_keep(np.array(ranges), gate, 30.0, 5.0, keep)
    assert keep.tolist() == slow_dcc(ranges, gate, 30.0, 5.0)


@pytest.mark.parametrize(("signal", "noise", "bins"), [(12.0, 0.3, 60.0), (4.0, 1.0, 17.0)])
def test_threshold_is_the_likelihood_ratio(signal: float, noise: float, bins: float) -> None:
    k = np.arange(60)
    with_signal = poisson.logpmf(k, signal + noise) - math.log(bins)
    likely = with_signal > poisson.logpmf(k, noise)
    assert np.flatnonzero(likely)[0] == math.ceil(dcc_threshold(signal, noise, bins))
