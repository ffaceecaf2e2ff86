"""Ground of each cell of a profile, from photons that may be signal.

[W17] 4.3 compares an "extracted ground surface" with lidar and leaves open how it was extracted;
there is no equation of it to follow. :func:`lowest_layers` is a vote of photons for lines, slope by
slope (R. Duda and P. Hart, *Use of the Hough transformation to detect lines and curves in
pictures*, Commun. ACM 15, 1972), that keeps the lowest line with votes enough where the Hough
transform keeps the one with most: canopy often outvotes the ground. :func:`fit_ground` is Tukey's
bisquare (A. Beaton and J. Tukey, Technometrics 16, 1974) by iteratively re-weighted least squares,
as [W17] ch. 7 fits planes; its limit of 4.685 deviations is 95 % efficient on normal errors
(P. Holland and R. Welsch, Commun. Stat. A6, 1977), and a deviation is a normalised median.

Along-track positions stay whole numbers until a cell's middle is taken off, so no result
depends on where a piece of track begins.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import sort

_ROUNDS: int = 6
_TUKEY: float = 4.685
_MAD: float = 1.4826
_LEAST_SPREAD_M: float = 0.05
_QUANTA_PER_M: float = 1000.0


class Cells(NamedTuple):
    """Photons by cell: each is seen with the one before and the one after it."""

    along: NDArray[np.int64]  #: (n,): photons in order along the track [quanta].
    height_m: NDArray[np.float64]  #: (n,): their heights.
    #: (c,): rows of the photons of a cell and its two neighbours; middle of each cell [quanta].
    first: NDArray[np.int64]
    stop: NDArray[np.int64]
    centre: NDArray[np.int64]


@njit()
def lowest_layers(along, height_m, first, stop, centre, thick_m, share, steps, slope_max, least):  # type: ignore[no-untyped-def]
    """Height at the middle [m] and slope of the lowest dense layer of each cell, (c, 2); or NaN.

    For each slope the photons are sheared and counted in bins of a third of a layer.
    The slope whose fullest layer holds most photons wins, the gentlest of equals; of its
    layers the lowest is taken that holds ``share`` of that, and ``least`` photons. ``thick_m``,
    ``share`` and ``steps``, slopes tried to each side of level ground, are (c,).
    """
    out = np.empty((len(first), 2))
    for c in range(len(first)):
        out[c, 0] = out[c, 1] = np.nan
        n = stop[c] - first[c]
        if n < least:
            continue
        bins = np.empty(n, np.int64)
        fullest, bin_m = least - 1, thick_m[c] / 3.0
        for step in range(2 * steps[c] + 1):
            # 0, 1, -1, 2, -2, ...: the gentlest first.
            turn = (step + 1) // 2 if step % 2 else -(step // 2)
            slope = slope_max * turn / steps[c]
            base, counts = _count(along, height_m, first[c], centre[c], slope, bin_m, bins)
            most = 0
            for b in range(1, len(counts) - 1):
                most = max(most, counts[b - 1] + counts[b] + counts[b + 1])
            if most > fullest:
                fullest = most
                b = _lowest(counts, max(share[c] * most, float(least)))
                out[c, 0] = (base + b - 0.5) * bin_m
                out[c, 1] = slope
    return out


@njit()
def _count(along, height_m, first, centre, slope, bin_m, bins):  # type: ignore[no-untyped-def]
    """Number of the lowest bin, and photons by bin of sheared height, an empty one around."""
    least, most = np.int64(1 << 62), np.int64(-(1 << 62))
    for i in range(len(bins)):
        dx = (along[first + i] - centre) / _QUANTA_PER_M
        bins[i] = np.int64(np.floor((height_m[first + i] - slope * dx) / bin_m))
        least, most = min(least, bins[i]), max(most, bins[i])
    counts = np.zeros(most - least + 3, np.int64)
    for i in range(len(bins)):
        counts[bins[i] - least + 1] += 1
    return least, counts


@njit()
def _lowest(counts, least):  # type: ignore[no-untyped-def]
    """Middle bin of the lowest layer of three that holds ``least``, at its fullest."""
    for b in range(1, len(counts) - 1):
        here = counts[b - 1] + counts[b] + counts[b + 1]
        if here < least:
            continue
        top = b
        while top < min(len(counts) - 2, b + 2):
            above = counts[top] + counts[top + 1] + counts[top + 2]
            if above <= here:
                break
            here, top = above, top + 1
        return top
    return 1


@njit()
def fit_ground(along, height_m, first, stop, centre, layers, thick_m, half_m, least):  # type: ignore[no-untyped-def]
    """Line and parabola through the photons of each cell's layer: bisquare weights, six rounds.

    ``layers``: (c, 2), as of :func:`lowest_layers`; ``half_m``: half the length of what is compared
    with the line in the middle [m]; ``least``: photons of a height. Gives (c, 9): of the line
    height at the middle [m], slope [m/m], standard error of the height [m]; photons in the layer;
    the same three of the parabola; height of a line through the cell's own photons, and its error
    [m]. NaN where photons are too few.
    """
    out = np.empty((len(first), 9))
    for c in range(len(first)):
        out[c] = np.nan
        if np.isnan(layers[c, 0]):
            continue
        x, z = np.empty(stop[c] - first[c]), np.empty(stop[c] - first[c])
        n = 0
        for row in range(first[c], stop[c]):
            dx = (along[row] - centre[c]) / _QUANTA_PER_M
            if abs(height_m[row] - layers[c, 0] - layers[c, 1] * dx) <= thick_m[c]:
                x[n], z[n] = dx, height_m[row]
                n += 1
        if n >= least:
            _fit(x[:n], z[:n], layers[c, 0], layers[c, 1], 1, out[c])
            out[c, 3] = n
            if n >= 3 * least:
                _fit(x[:n], z[:n], out[c, 0], out[c, 1], 2, out[c, 4:7])
            own = np.abs(x[:n]) <= half_m
            if 2 * least <= np.count_nonzero(own) < n:
                near = np.empty(3)
                _fit(x[:n][own], z[:n][own], out[c, 0], out[c, 1], 1, near)
                out[c, 7], out[c, 8] = near[0], near[2]
    return out


@njit()
def _fit(x, z, level, slope, degree, out):  # type: ignore[no-untyped-def]
    """Bisquare line or parabola through points: level and slope at zero, error of the level."""
    weight, off = np.empty(len(x)), np.empty(len(x))
    bend = 0.0
    spread = _spread(x, z, level, slope, bend, off)
    total = lever = 0.0
    for _ in range(_ROUNDS):
        total = sx = sz = sq = 0.0
        for i in range(len(x)):
            r = (z[i] - level - slope * x[i] - bend * x[i] ** 2) / (_TUKEY * spread)
            weight[i] = (1.0 - r * r) ** 2 if abs(r) < 1.0 else 0.0
            total += weight[i]
            sx += weight[i] * x[i]
            sz += weight[i] * z[i]
            sq += weight[i] * x[i] ** 2
        if total <= 0.0:
            break
        mx, mz, mq = sx / total, sz / total, sq / total
        sxx = sxz = sxq = 0.0
        for i in range(len(x)):
            sxx += weight[i] * (x[i] - mx) ** 2
            sxz += weight[i] * (x[i] - mx) * (z[i] - mz)
            sxq += weight[i] * (x[i] - mx) * (x[i] ** 2 - mq)
        # Photons within about a metre of each other give no slope.
        known = sxx > total
        slope = sxz / sxx if known else slope
        lever = mx * mx / sxx if known else 0.0
        level = mz - slope * mx
        bend = 0.0
        if degree == 2 and known:
            # x^2 less its part along a line: what is left of it is a parabola's own.
            turn = sxq / sxx
            sqq = sqz = 0.0
            for i in range(len(x)):
                own = x[i] ** 2 - mq - turn * (x[i] - mx)
                sqq += weight[i] * own**2
                sqz += weight[i] * own * z[i]
            if sqq > total:
                bend = sqz / sqq
                here = turn * mx - mq
                level += bend * here
                slope -= bend * turn
                lever += here * here / sqq
        spread = _spread(x, z, level, slope, bend, off)
    out[0], out[1] = level, slope
    # Two or three numbers are fitted; away from the middle of its photons a line is less sure.
    fitted = len(x) / max(len(x) - degree - 1, 1)
    out[2] = spread * np.sqrt(fitted * (1.0 / max(total, 1.0) + lever))


@njit()
def _spread(x, z, level, slope, bend, off):  # type: ignore[no-untyped-def]
    """Normalised median of the absolute distances from a line or parabola [m]."""
    n = len(x)
    for i in range(n):
        off[i] = abs(z[i] - level - slope * x[i] - bend * x[i] ** 2)
    sort(off)
    median = (off[(n - 1) // 2] + off[n // 2]) / 2.0
    return max(_MAD * median, _LEAST_SPREAD_M)


_TWICE: Final = 2.0
"""Error of a parabola over the line's, at most: where few photons lie near the middle it swings.
Spread evenly, photons make it 1.5."""

_OWN: Final = 2.0**2
_AROUND: Final = 3.0
_ALONE: Final = 5.0**2
"""How much a parabola contradicts the line: in the cell, in those around on average, and in a
cell alone; [variances]."""

_LEAST2_M2: Final = 1e-8
"""Least variance of the difference [m2]."""


def around(
    index: NDArray[np.int64], reach: int, *values: NDArray[np.int64]
) -> list[NDArray[np.int64]]:
    """Sums over so many cells to each side, (c,) int64: those of whole numbers have no order."""
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    sums = [np.concatenate([[0], np.cumsum(v)]) for v in values]
    return [total[stop] - total[first] for total in sums]


def with_bends(
    index: NDArray[np.int64], fits: NDArray[np.float64], reach: int
) -> NDArray[np.float64]:
    """Ground of each cell by line or parabola, (c, 5) float64.

    Height [m], slope [m/m], standard error of the height [m], photons [count], and by how much more
    than chance the cell's own photons are off it, squared [m2], of either sign. ``index``: cells,
    in order; ``fits``: by :func:`fit_ground`; ``reach``: cells to each side that are asked.
    """
    line, photons, bent, near = fits[:, :3], fits[:, 3], fits[:, 4:7], fits[:, 7:]
    known = bent[:, 2] < _TWICE * line[:, 2]
    chance2 = np.maximum(bent[:, 2] ** 2 - line[:, 2] ** 2, _LEAST2_M2)
    against = np.where(known, (bent[:, 0] - line[:, 0]) ** 2 / chance2, 0.0)
    # A cell alone may be far off.
    counted = np.rint(np.minimum(against, _ALONE) * 1e6).astype(np.int64)
    total, cells = around(index, reach, counted, known.astype(np.int64))
    others = (total - counted) * 1e-6 / np.maximum(cells - 1, 1)
    bends = known & ((against > _ALONE) | ((against > _OWN) & (others > _AROUND)))
    out = np.where(bends[:, None], bent, line)
    off2 = (near[:, 0] - out[:, 0]) ** 2 - np.maximum(near[:, 1] ** 2 - out[:, 2] ** 2, 0.0)
    return np.column_stack([out, photons, off2])
