"""How far the k-th neighbour is: the source's law, ours for signal, and the kernel of both."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate
from scipy.special import gammaincc, gammaln

from spl_batch.altimetry.filter.posterior import noise_posterior, ratios, with_prior


def noise_pdf(k: int, x: np.ndarray) -> np.ndarray:
    """Density of the k-th neighbour of noise over the noise expected within it [W17 Eq. 4.4]."""
    return np.exp((k - 1) * np.log(x) - x - gammaln(k))


def signal_pdf(k: int, x: np.ndarray, contrast: float) -> np.ndarray:
    """The same of signal, by the table that the filter reads."""
    table = ratios(k, contrast)
    columns = np.arange(table.within.shape[1])
    row = np.interp((np.log(x) - table.first) * table.step, columns, table.within[k - 1])
    return np.exp(row) * noise_pdf(k, x)


@pytest.mark.parametrize("k", [1, 3, 20])
def test_signal_is_the_mean_of_the_law_over_contrasts(k: int) -> None:
    x = np.geomspace(1e-6, 100.0, 60)
    contrast = np.geomspace(1.0, 500.0, 4001)
    laws = noise_pdf(k, contrast[:, None] * x) * contrast[:, None]
    mean = integrate.trapezoid(laws, np.log(contrast), axis=0) / np.log(500.0)
    known = mean > 1e-200
    np.testing.assert_allclose(signal_pdf(k, x, 500.0)[known], mean[known], rtol=1e-3, atol=1e-12)
    wide = np.geomspace(1e-12, 400.0, 40_001)
    whole = integrate.trapezoid(signal_pdf(k, wide, 500.0) * wide, np.log(wide))
    assert whole == pytest.approx(1.0, abs=1e-4)


def slow_posterior(x: np.ndarray, beyond: float, prior: float, contrast: float) -> float:
    """The same without a table: ``x`` is the noise expected within each neighbour."""
    total = 0.0
    steps = np.geomspace(1.0, contrast, 2001)
    for k, one in enumerate(x, 1):
        if np.isfinite(one):
            at = np.array([one])
            ratio = signal_pdf(k, at, contrast)[0] / noise_pdf(k, at)[0]
        else:
            mean = integrate.trapezoid(gammaincc(k, steps * beyond), np.log(steps))
            ratio = mean / np.log(contrast) / gammaincc(k, beyond)
        total -= np.log1p(np.exp(prior) * ratio)
    return total / len(x)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 6), st.floats(-4.0, 1.0))
def test_the_kernel_is_the_slow_posterior(seed: int, found: int, prior: float) -> None:
    rng = np.random.default_rng(seed)
    area = np.full((5, 6), np.inf)
    area[:, :found] = np.sort(rng.uniform(0.05, 4.0, (5, found)), axis=1)
    noise = rng.uniform(0.1, 2.0, 5)
    result = noise_posterior(np.log(area), 4.0, noise, with_prior(ratios(6, 200.0), prior))
    expected = [
        slow_posterior(row * n, 4.0 * n, prior, 200.0) for row, n in zip(area, noise, strict=True)
    ]
    np.testing.assert_allclose(result, expected, rtol=5e-3, atol=1e-4)


def test_dense_photons_are_ordered_where_their_product_underflows() -> None:
    area = np.array([np.arange(1, 21) * 1e-6, np.arange(1, 21) * 1e-7])
    score = noise_posterior(np.log(area), 1.0, np.ones(2), with_prior(ratios(20, 1e6), -5.0))
    assert np.isfinite(score).all()
    assert score[1] < score[0] < -6.0
