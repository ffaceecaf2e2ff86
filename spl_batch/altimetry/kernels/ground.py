"""Ground and canopy top of each cell of a profile, from signal photons."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_DENSE: float = 0.3
_STEPS: int = 10
_ROUNDS: int = 6
_TUKEY: float = 4.685
_MAD: float = 1.4826
_LEAST_SPREAD_M: float = 0.05


@njit(nogil=True, cache=True)
def lowest_layers(
    along_m: NDArray[np.float64],
    height_m: NDArray[np.float64],
    first: NDArray[np.int64],
    stop: NDArray[np.int64],
    centre_m: NDArray[np.float64],
    layer_m: float,
    slope_max: float,
    photons_min: int,
    out: NDArray[np.float64],
) -> None:
    """Height and slope of the lowest layer of each cell that is dense.

    For each of 21 slopes the photons are sheared and counted in bins of a third of a layer.
    The slope whose fullest layer holds most photons wins, the gentlest of equals; of its
    layers the lowest is taken that holds 0.3 of that, and ``photons_min``.

    Parameters
    ----------
    along_m, height_m : (n,) float64
        Signal photons in order along the track; distances from any one place [m].
    first, stop : (c,) int64
        Rows of the photons of a cell and its two neighbours.
    centre_m : (c,) float64
        Middle of each cell, from the same place [m].
    layer_m, slope_max : float
        Thickness of a layer [m]; steepest slope [m/m].
    photons_min : int
        Least photons of a layer [count].
    out : (c, 2) float64
        Receives height at the middle [m] and slope [m/m]; NaN where no layer is dense.
    """
    bin_m = layer_m / 3.0
    for c in range(len(first)):
        out[c, 0] = out[c, 1] = np.nan
        x = along_m[first[c] : stop[c]] - centre_m[c]
        z = height_m[first[c] : stop[c]]
        if len(x) < photons_min:
            continue
        fullest = photons_min - 1
        for step in range(2 * _STEPS + 1):
            # 0, 1, -1, 2, -2, ...: the gentlest first.
            turn = (step + 1) // 2 if step % 2 else -(step // 2)
            slope = slope_max * turn / _STEPS
            base, counts = _count(x, z, slope, bin_m)
            most = 0
            for b in range(1, len(counts) - 1):
                most = max(most, counts[b - 1] + counts[b] + counts[b + 1])
            if most > fullest:
                fullest = most
                b = _lowest(counts, max(_DENSE * most, float(photons_min)))
                out[c, 0] = (base + b - 0.5) * bin_m
                out[c, 1] = slope


@njit(nogil=True, cache=True)
def _count(x, z, slope, bin_m):  # type: ignore[no-untyped-def]
    """Number of the lowest bin, and photons by bin of sheared height, an empty one around."""
    level = z - slope * x
    base = np.floor(level.min() / bin_m)
    counts = np.zeros(int(np.floor(level.max() / bin_m) - base) + 3, np.int64)
    for i in range(len(x)):
        counts[int(np.floor(level[i] / bin_m) - base) + 1] += 1
    return base, counts


@njit(nogil=True, cache=True)
def _lowest(counts, least):  # type: ignore[no-untyped-def]
    """Middle bin of the lowest layer of three that holds ``least``, at its fullest."""
    for b in range(1, len(counts) - 1):
        here = counts[b - 1] + counts[b] + counts[b + 1]
        if here < least or counts[b] == 0:
            continue
        top = b
        while top < min(len(counts) - 2, b + 2):
            above = counts[top] + counts[top + 1] + counts[top + 2]
            if above <= here:
                break
            here, top = above, top + 1
        return top
    return 1


@njit(nogil=True, cache=True)
def agree(
    index: NDArray[np.int64],
    cell_m: float,
    reach: int,
    tolerance_m: float,
    found: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Put heights that their neighbours contradict to the median of what these expect.

    Parameters
    ----------
    index : (c,) int64
        Cells, in order.
    cell_m : float
        Length of a cell [m].
    reach : int
        Neighbours to each side that are asked [count].
    tolerance_m : float
        Largest difference that stands [m].
    found : (c, 2) float64
        From :func:`lowest_layers`.
    out : (c, 2) float64
        Receives the same, put right; NaN where nothing was found.
    """
    expected = np.empty(2 * reach + 1)
    for c in range(len(index)):
        out[c] = found[c]
        if np.isnan(found[c, 0]):
            continue
        n = 0
        for other in range(max(c - reach, 0), min(c + reach + 1, len(index))):
            away = index[other] - index[c]
            if other == c or abs(away) > reach or np.isnan(found[other, 0]):
                continue
            slope = (found[other, 1] + found[c, 1]) / 2.0
            expected[n] = found[other, 0] - slope * away * cell_m
            n += 1
        if n >= 2:
            middle = np.median(expected[:n])
            if abs(found[c, 0] - middle) > tolerance_m:
                out[c, 0] = middle


@njit(nogil=True, cache=True)
def fit_ground(
    along_m: NDArray[np.float64],
    height_m: NDArray[np.float64],
    first: NDArray[np.int64],
    stop: NDArray[np.int64],
    centre_m: NDArray[np.float64],
    layer_m: float,
    photons_min: int,
    layers: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Line through the photons of each cell's layer: bisquare weights, six rounds.

    Parameters
    ----------
    along_m, height_m, first, stop, centre_m, layer_m, photons_min
        As in :func:`lowest_layers`.
    layers : (c, 2) float64
        From :func:`agree`.
    out : (c, 4) float64
        Receives height at the middle [m], slope [m/m], standard error of the height [m] and
        photons in the layer [count]; NaN where these are too few.
    """
    for c in range(len(first)):
        out[c] = np.nan
        if np.isnan(layers[c, 0]):
            continue
        x = along_m[first[c] : stop[c]] - centre_m[c]
        z = height_m[first[c] : stop[c]]
        inside = np.abs(z - layers[c, 0] - layers[c, 1] * x) <= layer_m
        n = inside.sum()
        if n >= photons_min:
            _fit(x[inside], z[inside], layers[c, 0], layers[c, 1], out[c])
            out[c, 3] = n


@njit(nogil=True, cache=True)
def _fit(x, z, level, slope, out):  # type: ignore[no-untyped-def]
    """Bisquare line through points: level at zero, slope, standard error of the level."""
    spread = max(_MAD * np.median(np.abs(z - level - slope * x)), _LEAST_SPREAD_M)
    total = 0.0
    for _ in range(_ROUNDS):
        total = sx = sz = 0.0
        weight = np.zeros(len(x))
        for i in range(len(x)):
            r = (z[i] - level - slope * x[i]) / (_TUKEY * spread)
            weight[i] = (1.0 - r * r) ** 2 if abs(r) < 1.0 else 0.0
            total += weight[i]
            sx += weight[i] * x[i]
            sz += weight[i] * z[i]
        if total <= 0.0:
            break
        mx, mz = sx / total, sz / total
        sxx = sxz = 0.0
        for i in range(len(x)):
            sxx += weight[i] * (x[i] - mx) ** 2
            sxz += weight[i] * (x[i] - mx) * (z[i] - mz)
        # Photons within about a metre of each other tell no slope.
        slope = sxz / sxx if sxx > total else slope
        level = mz - slope * mx
        spread = max(_MAD * np.median(np.abs(z - level - slope * x)), _LEAST_SPREAD_M)
    out[0], out[1] = level, slope
    out[2] = spread / np.sqrt(max(total, 1.0))
