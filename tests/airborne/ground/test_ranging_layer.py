"""The ranging spread that ground is looked for with."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.ranging_layer import SIGMA_M, reckoned_m, scatter_counts

Float = NDArray[np.float64]


def cloud(rng: np.random.Generator, sigma_m: float, overgrown: float) -> tuple[Float, Float, Float]:
    """Tilted ground of 24 returns per m2, a share of its cells under heath [m]."""
    x, y = rng.uniform(0, 60, (2, 24 * 60 * 60))
    z = 0.3 * x + rng.normal(0, sigma_m, len(x))
    heath = rng.random((60, 60)) < overgrown
    under = heath[y.astype(int), x.astype(int)]
    z[under] += rng.gamma(1.0, 0.2, int(under.sum()))
    return x, y, z


@pytest.mark.parametrize(
    ("sigma_m", "overgrown", "found"),
    [(0.05, 0.5, 0.05), (0.035, 0.5, 0.035), (0.015, 0.5, SIGMA_M), (0.05, 0.95, SIGMA_M)],
)
def test_bare_cells_tell_what_ranges_scatter(
    sigma_m: float, overgrown: float, found: float
) -> None:
    counts = scatter_counts(*cloud(np.random.default_rng(1), sigma_m, overgrown))
    assert reckoned_m(0.05, counts) == pytest.approx(found, rel=0.12)
    assert reckoned_m(0.15, counts) == 0.15
    assert reckoned_m(0.0, counts) == reckoned_m(0.02, counts) == SIGMA_M


def test_counts_of_parts_add_up() -> None:
    x, y, z = cloud(np.random.default_rng(2), 0.03, 0.3)
    west = x < 23.0
    parts = [scatter_counts(*(v[some] for v in (x, y, z))) for some in (west, ~west)]
    assert np.array_equal(sum(parts), scatter_counts(x, y, z))
    assert reckoned_m(0.05, scatter_counts(x[:0], y[:0], z[:0])) == SIGMA_M
