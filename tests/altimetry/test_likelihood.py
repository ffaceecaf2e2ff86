"""How far the k-th neighbour is: the source's law, ours for signal, and the kernel of both."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate
from scipy.spatial import cKDTree
from scipy.special import gammaincc, gammaln

from spl_batch.altimetry.filter.likelihood import ratios
from spl_batch.altimetry.filter.posterior import noise_posterior

UNIT = 4096


def noise_pdf(k: int, x: np.ndarray) -> np.ndarray:
    """Density of the k-th neighbour of noise over the noise expected within it [W17 Eq. 4.4]."""
    return np.exp((k - 1) * np.log(x) - x - gammaln(k))


def signal_pdf(k: int, x: np.ndarray, contrast: float) -> np.ndarray:
    """The same of signal, by the table that the filter reads."""
    table = ratios(k, contrast)
    columns = np.arange(table.within.shape[1])
    row = np.interp((np.log(x) - table.first) * table.step, columns, table.within[k - 1])
    return np.exp(row) * noise_pdf(k, x)


@pytest.mark.parametrize("k", [1, 2])
def test_neighbours_of_uniform_points_follow_eq_4_4(k: int) -> None:
    """W17 Fig. 4-2: 10 000 points in a square of 10 m."""
    rng = np.random.default_rng(3)
    points = rng.uniform(0.0, 10.0, (10_000, 2))
    inner = points[(np.abs(points - 5.0) < 4.5).all(axis=1)]
    distance = cKDTree(points).query(inner, k=k + 1)[0][:, k]
    edges = np.quantile(distance, np.linspace(0.0, 1.0, 21))
    alpha = 100.0
    expected = []
    for low, high in pairwise(edges):
        r = np.linspace(low, high, 50)
        # f(r) dr = f(x) dx with x = alpha pi r^2
        density = noise_pdf(k, np.maximum(alpha * np.pi * r**2, 1e-12)) * 2 * alpha * np.pi * r
        expected.append(integrate.trapezoid(density, r))
    assert np.abs(np.array(expected) - 0.05).max() < 0.008


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


def slow_posterior(
    uv: np.ndarray,
    cap: np.ndarray,
    scale: np.ndarray,
    prior: np.ndarray,
    neighbours: int,
    contrast: float,
) -> np.ndarray:
    """The same by sorting every distance and without a table."""
    out = np.zeros(len(uv))
    steps = np.geomspace(1.0, contrast, 2001)
    for i in range(len(uv)):
        d2 = ((uv - uv[i]).astype(np.float64) ** 2).sum(axis=1)
        d2 = np.sort(np.delete(d2, i))
        d2 = np.maximum(d2[d2 <= cap[i] ** 2][:neighbours], 1.0)
        for k in range(1, neighbours + 1):
            if k <= len(d2):
                x = scale[i] * d2[k - 1]
                ratio = signal_pdf(k, np.array([x]), contrast)[0] / noise_pdf(k, np.array([x]))[0]
            else:
                x = scale[i] * cap[i] ** 2
                chance = gammaincc(k, steps * x)
                mean = integrate.trapezoid(chance, np.log(steps)) / np.log(contrast)
                ratio = mean / gammaincc(k, x)
            out[i] -= np.log1p(np.exp(prior[i]) * ratio) / neighbours
    return out


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 60), st.floats(0.05, 1.0))
def test_the_kernel_is_the_slow_posterior(seed: int, n: int, alpha: float) -> None:
    rng = np.random.default_rng(seed)
    spread = UNIT * rng.uniform(0.5, 4.0)
    uv = rng.normal(0.0, spread, (n, 2)).astype(np.int32)
    scale = np.full(n, np.pi * alpha / UNIT**2)
    prior = rng.uniform(-4.0, 1.0, n)
    table = ratios(6, 200.0)
    query = rng.uniform(size=n) < 0.7
    cap = rng.integers(UNIT // 4, 2 * UNIT, n)
    found = noise_posterior(
        uv, query, cap, scale, prior, table.within, table.beyond, (table.first, table.step)
    )
    expected = slow_posterior(uv, cap, scale, prior, 6, 200.0)[query]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4)


def test_a_product_that_underflows_still_tells_photons_apart() -> None:
    """Twenty posteriors of dense signal multiply to less than the smallest float."""
    table = ratios(20, 1e6)
    rng = np.random.default_rng(1)
    dense = rng.normal(0.0, 3.0, (200, 2))
    denser = rng.normal(0.0, 1.0, (200, 2)) + 4000.0
    uv = np.rint(np.concatenate([dense, denser])).astype(np.int32)
    n = len(uv)
    found = noise_posterior(
        uv,
        np.ones(n, np.bool_),
        np.full(n, 2 * UNIT),
        np.full(n, np.pi / UNIT**2),
        np.full(n, -5.0),
        table.within,
        table.beyond,
        (table.first, table.step),
    )
    product = np.prod(np.exp(np.repeat(found[:, None], 20, axis=1).astype(np.float32)), axis=1)
    assert (product == 0.0).all()
    assert np.isfinite(found).all()
    assert found[200:].mean() < found[:200].mean()
