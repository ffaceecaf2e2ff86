"""Noise-sized neighbourhoods: areas of the ellipses that reach the first neighbours of a point.

An ellipse is ``aspect`` times as long as high and leans with the layer that is seen around. Photons
lie in columns along the track, by height in each, so that one search serves photons and points of
any slope; distances are exact.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

COLUMN_M: Final = 10.0
"""Width of a column of photons [m]."""

_BOX_M: Final = 4.0
_MOST_BOXES: Final = 512
"""Height of a box of a column, and boxes of a column at most [m, count]."""

SLOPES: Final = np.array(
    [0.0, 0.05, -0.05, 0.1, -0.1, 0.2, -0.2, 0.35, -0.35, 0.5, -0.5, 0.75, -0.75, 1.0, -1.0]
)
"""Slopes that a layer may have [m/m]."""

LAYER_M: Final = 10.0
"""Heights of a cell that lean alike [m]."""

_BIN_M: float = 0.75
_LEVEL_GAIN: float = 1.3
"""Pairs of a leaning layer, over those of a level one, that make it lean."""

_CELLS: Final = 2
"""Cells to each side whose photons show how a layer leans [count]."""


class Columns(NamedTuple):
    """Photons by column along the track, and by height in each."""

    x_m: NDArray[np.float64]  #: (n,): along the track, from the first column's start.
    z_m: NDArray[np.float64]  #: (n,): height.
    start: NDArray[np.int64]  #: (c b + 1,): first photon of each box of each column, upwards.
    low_m: float  #: Foot of the lowest box.
    box_m: float  #: Height of a box.
    boxes: int  #: b, boxes of a column.


def columns(x_m: NDArray[np.float64], z_m: NDArray[np.float64]) -> Columns:
    """Put photons into columns; ``x_m`` is 0 or more."""
    low_m = float(z_m.min(initial=0.0))
    span_m = float(z_m.max(initial=0.0)) - low_m
    box_m = max(_BOX_M, span_m / _MOST_BOXES)
    boxes = int(span_m / box_m) + 1
    at = (x_m // COLUMN_M).astype(np.int64)
    box = at * boxes + np.minimum((z_m - low_m) / box_m, boxes - 1).astype(np.int64)
    count = np.bincount(box, minlength=(int(at.max(initial=0)) + 1) * boxes)
    order = np.lexsort((x_m, z_m, at))
    start = np.concatenate([[0], np.cumsum(count)])
    return Columns(x_m[order], z_m[order], start, low_m, box_m, boxes)


def log_areas(
    photons: Columns,
    points: tuple[NDArray[np.float64], NDArray[np.float64]],
    slope: NDArray[np.float64],
    shape: tuple[int, float, float],
    *,
    own: bool,
) -> NDArray[np.float64]:
    """Logarithm of the area [m2] within the k-th neighbour of each point, (q, K) float64.

    Infinite where it lies beyond the reach. ``points``: along the track and in height [m];
    ``slope``: (q,), of each ellipse; ``shape``: K, length over height, reach along the track [m];
    ``own``: whether the points are those of photons: each is no neighbour of itself.
    """
    most, aspect, reach_m = shape
    near = np.full((len(slope), most + own), np.inf)
    _nearest(*photons, *points, slope, aspect, (reach_m / aspect) ** 2, near)
    # Photons at one position are a millimetre apart at least.
    areas: NDArray[np.float64] = np.pi * aspect * np.maximum(near[:, int(own) :], 1e-6)
    return np.log(areas, out=areas)


@njit()
def _nearest(x, z, start, low_m, box_m, boxes, at_x, at_z, slope, aspect, cap, out):  # type: ignore[no-untyped-def]
    """Squared distances in ascending order: columns outwards until none can hold a nearer one."""
    last, count = out.shape[1] - 1, (len(start) - 1) // boxes
    near = np.empty(out.shape[1])
    for q in range(len(at_x)):
        near[:] = cap
        found = 0
        middle = np.int64(at_x[q] // COLUMN_M)
        ellipse = at_x[q], at_z[q], slope[q], 1.0 / aspect
        for side in range(2):
            step = 1 if side == 0 else -1
            c = middle - side
            while 0 <= c < count:
                low, high = c * COLUMN_M - at_x[q], (c + 1) * COLUMN_M - at_x[q]
                away = max(low, -high, 0.0) / aspect
                if away * away >= near[last]:
                    break
                lean0, lean1 = slope[q] * low, slope[q] * high
                base, top = at_z[q] + min(lean0, lean1), at_z[q] + max(lean0, lean1)
                box = np.int64(((base + top) / 2.0 - low_m) / box_m)
                first = start[c * boxes + min(max(box, 0), boxes - 1)]
                rows = start[c * boxes], first, start[(c + 1) * boxes]
                found += _column(x, z, rows, ellipse, (base, top), near)
                c += step
        for k in range(min(found, last + 1)):
            out[q, k] = near[k]


@njit(inline="always")
def _column(x, z, rows, ellipse, span, near):  # type: ignore[no-untyped-def]
    """Sort photons of a column into the nearest ones, upwards and downwards; how many were."""
    at_x, at_z, slope, narrow = ellipse
    base, top = span
    last, found = len(near) - 1, 0
    low, first, high = rows
    for way in range(2):
        i = first if way == 0 else first - 1
        while low <= i < high:
            beyond = z[i] - top if way == 0 else base - z[i]
            if beyond > 0.0 and beyond * beyond >= near[last]:
                break
            dx = x[i] - at_x
            dz = z[i] - at_z - slope * dx
            squared = (dx * narrow) ** 2 + dz * dz
            if squared < near[last]:
                k = last
                while k > 0 and near[k - 1] > squared:
                    near[k] = near[k - 1]
                    k -= 1
                near[k] = squared
                found += 1
            i += 1 if way == 0 else -1
    return found


@njit()
def leaning(x, z, first, cell_m):  # type: ignore[no-untyped-def]
    """Slope of each layer of each cell, as row of :data:`SLOPES`: (cells, layers) int8.

    That in which most pairs of photons share a height: one steeper than level needs more of them.
    ``x``, ``z``: photons in order along the track, heights from the lowest layer's foot [m];
    ``first``: (cells + 1,), first photon of each cell.
    """
    cells, layers = len(first) - 1, int(z.max() // LAYER_M) + 1
    out = np.zeros((cells, layers), np.int8)
    room = np.int64(np.ceil(cell_m * (_CELLS + 1) / _BIN_M)) + 1
    counts = np.zeros(np.int64(layers * LAYER_M / _BIN_M) + 2 * room + 2, np.int64)
    layer = np.empty(len(counts), np.int64)
    for b in range(len(counts)):
        layer[b] = np.int64(min(max((b - room + 0.5) * _BIN_M / LAYER_M, 0.0), layers - 1.0))
    best = np.empty(layers)
    pairs = np.empty(layers)
    for c in range(cells):
        begin, end = first[max(c - _CELLS, 0)], first[min(c + _CELLS + 1, cells)]
        middle = (c + 0.5) * cell_m
        for s in range(len(SLOPES)):
            for i in range(begin, end):
                counts[np.int64((z[i] - SLOPES[s] * (x[i] - middle)) / _BIN_M + room)] += 1
            pairs[:] = 0.0
            for b in range(len(counts)):
                pairs[layer[b]] += counts[b] * (counts[b] - 1) // 2
                counts[b] = 0
            for i in range(layers):
                if s == 0:
                    best[i] = pairs[i] * _LEVEL_GAIN
                elif pairs[i] > best[i]:
                    best[i] = pairs[i]
                    out[c, i] = s
    return out
