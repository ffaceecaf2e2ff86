"""Where flightlines lie apart, a candidate is judged by the returns of its own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.afterpulse.own_flightline import CHANCE, PASS_S, bounded, weigh_own
from spl_batch.airborne.afterpulse.weighted_counts import UNIT, columns
from tests.airborne.afterpulse.test_afterpulse_decision import (
    echo_of,
    followers,
    inner,
    plate,
    survey,
)


@given(st.integers(0, 2**32 - 1), st.integers(1, 120))
@settings(max_examples=30, deadline=None)
def test_sums_are_those_of_a_plain_loop(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.integers(0, [5000, 3000, 4000], (n, 3)).astype(np.int64)
    time, channel = rng.integers(0, 5, n) * 25.0, rng.integers(0, 3, n).astype(np.uint8)
    weight = rng.integers(0, UNIT + 1, n).astype(np.int16)
    radii = np.array([[1500, 1500], [1500, 300]])
    listed = columns(xyz.T, 1500)
    o = listed.order
    out = np.empty((n, 2, 2), np.int64)
    tilt = np.where(rng.random((n, 1)) < 0.5, rng.uniform(-1.5, 1.5, (n, 2)), 0.0)
    weigh_own(
        xyz.T.take(o, axis=1).astype(np.int32), time[o], channel[o], weight[o], listed.starts,
        listed.shape, listed.edge, np.arange(n, dtype=np.int32), radii, tilt, PASS_S, out,
    )  # fmt: skip
    for q, row in enumerate(o):
        d = (xyz - xyz[row]).astype(np.float64)
        others = ~((time == time[row]) & (channel == channel[row]))
        mine = np.abs(time - time[row]) <= PASS_S
        up = d[:, 2] - d[:, :2] @ tilt[q]
        for k, (a, b) in enumerate(radii):
            left = np.maximum(1 - (d[:, 0] ** 2 + d[:, 1] ** 2) / a**2 - (up / b) ** 2, 0)
            worth = others * weight * left**2 * UNIT
            # kernels are rounded down
            assert out[q, k, 0] == pytest.approx(worth.sum(), abs=UNIT * n)
            assert out[q, k, 1] == pytest.approx(worth[mine].sum(), abs=UNIT * n)


def test_support_is_bounded_by_the_own_flightlines_share() -> None:
    sums = np.array([[[80, 40], [20, 9]], [[80, 40], [20, 1]], [[80, 8], [20, 2]], [[5, 0]] * 2])
    most = CHANCE * 1 * 80 / 40
    np.testing.assert_allclose(bounded(sums), [20, most, 20, 5])


@pytest.mark.parametrize("aside_s", [0.0, 300.0])
def test_a_lower_flightline_makes_no_surface_behind_a_higher_one(aside_s: float) -> None:
    """What its own flightline sees behind a surface is one; what the other sees is its surface."""
    upper, lower = plate(12, 20.0, 0.1, 1), plate(12, 19.7, 0.1, 2)
    first = np.concatenate([upper, lower])
    rows = inner(upper, 60)
    table, density = survey(first, followers(first, rows, 0.3, spread=0.1), afterpulse=0.9)
    line = np.concatenate([np.zeros(len(upper)), np.ones(len(lower)), np.zeros(len(rows))])
    table = table.with_columns(gps_time=table["gps_time"] * 1e-3 + aside_s * line)
    late = echo_of(table, density)[len(first) :]
    assert late.mean() > 0.8 if aside_s else late.mean() < 0.2
