"""A polynomial through all pixels, shrunk towards a plane as far as noise explains it.

The plane's three numbers are free. Those of the higher terms, Legendre polynomials in both image
coordinates, have a normal prior whose variance falls from order to order. The result is a mean over
sizes and falls of that prior, weighted by how likely the pixels are under each, the plane's numbers
and the terms integrated out [M92]: the most likely one alone is far off now and then. So a level
surface keeps the plane's small error, and a wave gets its curvature.

- **[M92]** D. MacKay: *Bayesian interpolation*. Neural Computation 4, 1992.
"""

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SIZES = 10.0 ** np.arange(-5.0, -0.9, 0.25)
"""Standard deviations of the prior of order 2 that are tried, over the mean value [1]."""

FALLS = (0.1, 0.2, 0.4, 0.8)
"""Factors from one order's standard deviation to the next that are tried [1]."""


def shrunk_polynomial(value: Floats, weight: Floats, x: Floats, y: Floats, order: int) -> Floats:
    """Value and slopes of the most likely surface: (rows, cols, 3) float64.

    Parameters
    ----------
    value, weight : (rows, cols) float64
        Read where the inverse variance in ``weight`` is > 0.
    x, y : (rows, cols) float64
        Coordinates, of mean 0.
    order : int
        Highest order; 0 gives zeros, as do too few pixels for a plane.
    """
    known = weight > 0
    terms = [(p, q) for p in range(order + 1) for q in range(order + 1 - p)]
    terms.sort(key=sum)
    while len(terms) > 3 and int(known.sum()) < 2 * len(terms):
        highest = sum(terms[-1])
        terms = [t for t in terms if sum(t) < highest]
    if order < 1 or int(known.sum()) < 6:
        return np.zeros((*value.shape, 3))
    size = max(float(np.abs(x).max()), float(np.abs(y).max()))
    u, v = x / size, y / size
    root = np.sqrt(weight[known])
    design = _products(u[known], v[known], terms) * root[:, None]
    wanted = value[known] * root
    numbers = _most_likely(design, wanted, np.array([sum(t) for t in terms]))
    return np.stack(
        [
            _products(u, v, terms) @ numbers,
            _products(u, v, terms, along_u=True) @ numbers / size,
            _products(u, v, terms, along_v=True) @ numbers / size,
        ],
        axis=-1,
    )


def _most_likely(design: Floats, wanted: Floats, orders: NDArray[np.int64]) -> Floats:
    """Numbers of all terms; rows of the design are over their standard deviations."""
    plane, triangle = np.linalg.qr(design[:, :3])
    bent = design[:, 3:] - plane @ (plane.T @ design[:, 3:])
    left = wanted - plane @ (plane.T @ wanted)
    free = len(wanted) - design.shape[1]
    # Not by BLAS, whose sums over pixels may depend on the number of its threads.
    moments, right = np.einsum("ki,kj->ij", bent, bent), np.einsum("ki,k->i", bent, left)
    # Small and well scaled: quicker than the singular values of all pixels.
    best = np.linalg.lstsq(moments, right)[0]
    # Weights that promise too much must not buy curvature: what is left sets the scale.
    noise = max(float(((left - bent @ best) ** 2).sum()) / free, 1.0)
    moments, right = moments / noise, right / noise
    mean = float(np.abs(wanted).sum() / np.abs(design[:, 0]).sum())
    # A plane alone is likely as exp(0); it counts as much as the falls of one size.
    costs, found = [0.0] * len(FALLS), [np.zeros(len(best))] * len(FALLS)
    for fall in FALLS:
        for size in SIZES:
            prior = mean * size * fall ** (orders[3:] - 2.0)
            scaled = np.eye(len(best)) + prior[:, None] * moments * prior
            numbers = prior * np.linalg.solve(scaled, prior * right)
            costs.append(float(np.linalg.slogdet(scaled)[1] - right @ numbers))
            found.append(numbers)
    likely = np.exp(-0.5 * (np.array(costs) - min(costs)))
    chosen = likely @ np.array(found) / likely.sum()
    flat = np.linalg.solve(triangle, plane.T @ (wanted - design[:, 3:] @ chosen))
    return np.concatenate([flat, chosen])


def _products(
    u: Floats,
    v: Floats,
    terms: list[tuple[int, int]],
    *,
    along_u: bool = False,
    along_v: bool = False,
) -> Floats:
    """Products of Legendre polynomials, or their derivatives: (..., terms) float64."""
    count = max(map(sum, terms)) + 1
    basis = np.eye(count)
    values = [[legendre.legval(w, row) for row in basis] for w in (u, v)]
    slopes = [[legendre.legval(w, legendre.legder(row)) for row in basis] for w in (u, v)]
    first = slopes[0] if along_u else values[0]
    second = slopes[1] if along_v else values[1]
    products: Floats = np.stack([first[p] * second[q] for p, q in terms], axis=-1)
    return products
