"""Floors that lean within a cell, and the line that they make along the track.

A steep floor fills many depths of a cell with few photons each: no level box holds more than noise
does, and neighbourhoods that are long and level hold few photons of it. Sheared by its slope it is
one thin layer again. So the photons of a cell are sheared by slope after slope and counted by
layers, as ground is sought (:mod:`spl_batch.altimetry.ground.cell_ground`). The layer that holds
most beyond noise is a floor where it meets that of the cell beside it: the depths that it passes
through are none of the noise's, and neighbourhoods below the surface follow its line. To take a
line off heights changes no area, so noise is as dense as before.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

_SLOPES: int = 10  # to each side, a tenth apart: a cell's ends move by a layer from one to the next
_HALF_M: float = 0.5  # half-thickness of a layer
_SD: float = 4.0
_LEAST: float = 2.0  # standard deviations, and photons, that a layer is over the noise

_MEET_M: Final = 1.0
"""How far the layers of two cells are apart where they meet, at most [m]."""

_STRONG: Final = 2.0
"""Photons more than it needs that one of two layers that meet holds at least [count]."""

_FAR_CELLS: Final = 500
"""Cells from a floor beyond which nothing follows it [count]."""


class Below(NamedTuple):
    """Photons below the surface of cells."""

    number: NDArray[np.int64]  #: (n,): cells, in order.
    cell: NDArray[np.intp]  #: (p,): row of each photon's cell.
    inside_m: NDArray[np.float64]  #: (p,): along the track, from the middle of the cell [m].
    depth_m: NDArray[np.float64]  #: (p,): depth below the surface and its waves [m].


def leaning_floor(photons: Below, noise: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Depth in the middle of each cell and slope of the floor seen there, (n, 2) [m, m/m].

    NaN where none is, or where no cell beside it has one that meets it, either of them clear.

    Parameters
    ----------
    noise : (n, d) float64
        Photons of noise that each metre of depth lets expect [count].
    """
    index, cell, inside_m, depth_m = photons
    order = np.argsort(cell, kind="stable")
    edges = np.searchsorted(cell[order], np.arange(len(index) + 1))
    layers = np.empty((len(index), 3))
    leaning_layers(inside_m[order], depth_m[order], edges, noise, cell_m, layers)
    first, last = (layers[:, 0] + side * layers[:, 1] * cell_m / 2.0 for side in (-1.0, 1.0))
    strong = layers[:, 2] >= _STRONG
    meet = (np.diff(index) == 1) & (strong[:-1] | strong[1:])
    meet &= np.abs(last[:-1] - first[1:]) <= _MEET_M
    alone = ~(np.append(meet, False) | np.append(False, meet))
    layers[alone] = np.nan
    return layers[:, :2]


@njit()
def leaning_layers(
    inside_m: NDArray[np.float64],
    depth_m: NDArray[np.float64],
    edges: NDArray[np.int64],
    noise: NDArray[np.float64],
    cell_m: float,
    out: NDArray[np.float64],
) -> None:
    """The layer of each cell, level or leaning, that stands out of noise most.

    Parameters
    ----------
    inside_m, depth_m : (p,) float64
        Photons of cells one after the other: place from the middle of the cell, and depth [m].
    edges : (n + 1,) int64
        First photon of each cell, and the end.
    noise : (n, d) float64
        Photons of noise that each metre of depth lets expect [count].
    cell_m : float
        Length of a cell [m].
    out : (n, 3) float64
        Receives depth in the middle of the cell [m], slope [m/m], and photons beyond those that
        a layer needs [count]; NaN where no layer stands out.
    """
    n, depths = noise.shape
    count = np.zeros(int((depths + cell_m) / _HALF_M) + 1, np.int64)
    total = np.zeros(depths + 1)
    for c in range(n):
        out[c] = np.nan
        if edges[c + 1] - edges[c] <= _LEAST:
            continue
        for d in range(depths):
            total[d + 1] = total[d] + noise[c, d]
        most = 0.0
        for turn in range(2 * _SLOPES + 1):
            # 0, 1, -1, 2, -2, ...: the gentlest first.
            slope = ((turn + 1) // 2 if turn % 2 else -(turn // 2)) / _SLOPES
            count[:] = 0
            for i in range(edges[c], edges[c + 1]):
                b = int((depth_m[i] - slope * inside_m[i] + cell_m / 2.0) / _HALF_M)
                if 0 <= b < len(count):
                    count[b] += 1
            for b in range(len(count) - 1):
                held = count[b] + count[b + 1]
                if held <= _LEAST + most:
                    continue
                middle = (b + 1) * _HALF_M - cell_m / 2.0
                low, high = _passed(middle, slope, cell_m, depths)
                expected = (total[high] - total[low]) / max(high - low, 1) * 2.0 * _HALF_M
                more = held - expected - _SD * np.sqrt(expected) - _LEAST
                if high > low and more > most:
                    most = more
                    out[c, 0], out[c, 1], out[c, 2] = middle, slope, more


@njit()
def _passed(middle, slope, cell_m, depths):  # type: ignore[no-untyped-def]
    """First metre of depth that a layer passes through, and the one after its last."""
    half = abs(slope) * cell_m / 2.0 + _HALF_M
    return max(int(np.floor(middle - half)), 0), min(int(np.ceil(middle + half)), depths)


def depths_of(line: NDArray[np.float64], depths: int, cell_m: float) -> NDArray[np.bool_]:
    """Metres of depth that a floor passes through in each cell, (n, depths) bool."""
    half = np.abs(line[:, 1]) * cell_m / 2.0 + _HALF_M
    low, high = (np.nan_to_num(line[:, 0] + side * half) for side in (-1.0, 1.0))
    metre = np.arange(depths)
    found: NDArray[np.bool_] = (metre >= np.floor(low)[:, None]) & (metre < np.ceil(high)[:, None])
    return found


def bed(index: NDArray[np.int64], line: NDArray[np.float32], cell_m: float) -> NDArray[np.float64]:
    """Height at both ends of each cell of what follows the floors around, (n, 2) [m].

    Where the lines of two cells meet it is the mean of both, and where a floor has a step so has
    it. Between floors it is straight, beyond them level, and 0 where none is near.

    Parameters
    ----------
    line : (n, 2) float32
        Height of the floor in the middle of each cell, and its slope [m, m/m]; NaN without one.
    """
    out = np.zeros((len(index), 2))
    known = np.flatnonzero(np.isfinite(line[:, 0]))
    if not len(known):
        return out
    own, rise = index[known], line[known, 1].astype(np.float64) * cell_m / 2.0
    start, end = (line[known, 0] + side * rise for side in (-1.0, 1.0))
    meet = np.flatnonzero((np.diff(own) == 1) & (np.abs(start[1:] - end[:-1]) <= _MEET_M))
    start[meet + 1] = end[meet] = (start[meet + 1] + end[meet]) / 2.0
    out[known] = np.stack([start, end], axis=1)
    other = np.flatnonzero(np.isnan(line[:, 0]))
    after = np.searchsorted(own, index[other])
    before, after = np.maximum(after - 1, 0), np.minimum(after, len(own) - 1)
    near = [np.abs(own[one] - index[other]) <= _FAR_CELLS for one in (before, after)]
    # Beyond the first and the last floor both are the same.
    ends = np.where(own[after] > index[other], start[after], end[after])
    gap = np.maximum(own[after] - own[before] - 1, 1)
    for side in (0, 1):
        part = (index[other] + side - own[before] - 1) / gap
        along = end[before] + (start[after] - end[before]) * part
        one = np.where(near[0] & (own[before] < index[other]), end[before], ends)
        within = near[0] & near[1] & (own[before] < index[other]) & (own[after] > index[other])
        out[other, side] = np.where(within, along, np.where(near[0] | near[1], one, 0.0))
    return out
