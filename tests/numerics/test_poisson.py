"""The Poisson tail against scipy, relative error in the small tail included."""

import math

import numpy as np
import pytest
from scipy import stats

from spl_batch.numerics.poisson import (
    critical_by_logs,
    noise_tail_probability,
    tail_by_logs,
)

LOGS = np.array([math.lgamma(i + 1.0) for i in range(40)])


def poisson_critical(mean: float, alpha: float, start: int) -> tuple[int, float]:
    """What kernels look up, with logarithms of some factorials."""
    return critical_by_logs(mean, alpha, start, math.log(mean) if mean else 0.0, LOGS)


MEANS = np.array([0.0, 1e-9, 1e-3, 0.3, 1.84, 7.5, 40.0, 333.3, 5000.0])


def test_tail_equals_scipy() -> None:
    mean, count = (a.ravel() for a in np.meshgrid(MEANS, [0, 1, 2, 5, 16, 47, 200, 400, 5300]))
    tail = noise_tail_probability(count.astype(np.int32), mean)
    np.testing.assert_allclose(tail, stats.poisson.sf(count - 1, mean), rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("alpha", [1e-12, 5e-5, 0.001, 0.05, 0.6, 0.999])
def test_critical_count_is_the_smallest_that_passes(alpha: float) -> None:
    for mean in MEANS:
        count, tail = poisson_critical(mean, alpha, 1)
        assert count >= 1
        (wanted,) = noise_tail_probability(np.array([count], np.int32), np.array([mean]))
        assert tail == pytest.approx(wanted, rel=1e-9)
        for start in (2, 7, 60, 6000):
            assert poisson_critical(mean, alpha, start) == (count, tail)
        assert stats.poisson.sf(count - 1, mean) <= alpha
        assert count == 1 or stats.poisson.sf(count - 2, mean) > alpha


@pytest.mark.parametrize("mean", [3e4, 2.5e8])
def test_a_large_mean_is_found_from_far_below(mean: float) -> None:
    count, _ = poisson_critical(mean, 0.01, 1)
    assert count == pytest.approx(stats.poisson.isf(0.01, mean), abs=2)


@pytest.mark.parametrize("mean", [0.3, 7.5, 40.0])
def test_an_alpha_that_is_a_tail_itself_is_met_from_either_side(mean: float) -> None:
    counts = np.arange(1, 90, dtype=np.int32)
    tails = np.array([tail_by_logs(k, mean, math.log(mean), LOGS) for k in counts])
    for count, tail in zip(counts, tails, strict=True):
        for start in (count, count + 1, count + 5):
            assert poisson_critical(mean, tail, start) == (counts[tails <= tail][0], tail)
