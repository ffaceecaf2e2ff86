"""Clouds and fog in the gate, and their density by height.

A cloud sends back light from every height that it fills: its photons come as noise does, only
denser. One density for the whole gate calls them signal, or makes the noise elsewhere too high.

Three things keep a cloud apart from trees and hills. It floats: it begins more than
:data:`CLEAR_M` above the ground, and nothing joins it to the ground, cell by cell. It is thick.
And its photons are no nearer to one another than chance brings them: counts in boxes scatter as
those of a Poisson process do, where a slope or a crown fills some boxes and leaves the others
(index of dispersion, R. Fisher, *Statistical Methods for Research Workers*, 1925). Fog that touches
the ground cannot be told from trees by photons, and stays signal.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.altimetry.water.layers_of_cells import common_metre
from spl_batch.altimetry.water.level_water import REACH_CELLS, sums_around
from spl_batch.constants import QUANTA_PER_M

BIN_M: Final = 3
"""Thickness that a cloud's density is told by [m]."""

BINS: Final = 64
"""Bins of a cloud; what reaches higher counts as sky [count]."""

PATCH_CELLS: Final = 5
"""Cells to each side that a cloud is seen over [count]."""

GROUND_CELLS: Final = 50
"""Cells to each side that ground is looked for below a cloud that hides it [count]."""

JOINED_CELLS: Final = GROUND_CELLS + 2 * PATCH_CELLS
"""Cells along which what is joined to the ground is followed [count]."""

CLEAR_M: Final = 45.0
"""A cloud begins farther above the ground than this: trees may have bare stems [m]."""

_SEARCHED: Final = 160
"""Bins above the ground that are looked at [count]."""

_NEAR_M: Final = 1.5
"""What is nearer to the ground belongs to it [m]."""

_STACK: Final = 3
"""Bins that are looked at together [count]."""

_BRIGHT: Final = 5.0
"""Times the sky's noise that a cloud holds at least which hides the ground."""

_THICK: Final = 2
"""Bins that a cloud fills at least [count]."""

_LEAST: Final = 10
"""Photons that show a cloud in a patch [count]."""

_SD: Final = 3.0
_SURE_SD: Final = 6.0
"""Standard deviations of the sky's noise that a stack, and a cloud, exceed."""

_CLUMPED: Final = 1.2
"""Squared coefficient of variation of a cloud's density among boxes, at most."""

_SURFACE: Final = (4, 0.3)
"""Photons, and share of a cell's signal, that its fullest metre holds where it is a surface."""


class Fog(NamedTuple):
    """What cells show of a cloud."""

    #: (n,): its lower end [quanta].
    low: NDArray[np.int32]
    #: (n, BINS): photons by height above that, sky included [1/m2]; 0 where there is no cloud.
    density: NDArray[np.float32]


def find_fog(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    mode: NDArray[np.int64],
    high: NDArray[np.int32],
    noise: NDArray[np.float64],
    cell_m: float,
) -> Fog:
    """Find the cloud of each cell, if there is one.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    cell : (p,) intp
        Row of each photon's cell.
    height : (p,) int32
        Photons [quanta].
    mode : (n,) int64
        Half-metre of each cell's fullest metre.
    high : (n,) int32
        Upper end of each cell's gate [quanta].
    noise : (n,) float64
        Photons of each cell that are noise, about [count].
    """
    n = len(index)
    fog = Fog(np.zeros(n, np.int32), np.zeros((n, BINS), np.float32))
    if not n:
        return fog
    foot_q, known, near = _foot(index, cell, height, mode, noise)
    step = BIN_M * QUANTA_PER_M
    foot = foot_q // step
    row = height // step - foot[cell]
    inside = known[cell] & (row >= 0) & (row < _SEARCHED)
    counted = np.bincount(cell[inside] * _SEARCHED + row[inside], minlength=n * _SEARCHED)
    boxes = counted.reshape(n, _SEARCHED)
    gate = high / step - foot
    area = np.clip(gate[:, None] - np.arange(_SEARCHED), 0.0, 1.0) * (
        known[:, None] * cell_m * BIN_M
    )
    seen, seen_m2 = (sums_around(index, values, PATCH_CELLS) for values in (boxes, area))
    sky = _sky(seen, seen_m2) * seen_m2
    layer = _layers(seen, sky)
    if not layer.any():
        return fog
    runs = _runs(layer)
    squares = sums_around(index, boxes**2, PATCH_CELLS)
    cloud = _even(runs, seen, sky, squares, _cells_around(index))
    # Where ground is seen in the distance alone, noise may hide how a slope climbs from there.
    cloud &= near[runs.row] | (runs.total(seen) > _BRIGHT * runs.total(sky))
    if cloud.any():
        cloud &= _floating(runs, index, foot)
    # A patch shows itself in the cells beside it too; what one or two of them show is chance.
    shown = np.bincount(runs.row[cloud], minlength=n)[:, None] > 0
    cloud &= sums_around(index, shown, PATCH_CELLS)[runs.row, 0] > PATCH_CELLS
    for run in np.flatnonzero(cloud)[::-1]:
        i, first, stop = int(runs.row[run]), int(runs.first[run]), int(runs.stop[run])
        _put(
            fog,
            i,
            int(foot[i]) + first,
            seen[i, first:stop] / np.maximum(seen_m2[i, first:stop], 1e-9),
        )
    return fog


def _put(fog: Fog, row: int, low: int, density: NDArray[np.float64]) -> None:
    """Add a layer of a cell below those that it has; ``low``: its first bin, from height 0."""
    own = fog.density[row]
    above = (int(fog.low[row]) // (BIN_M * QUANTA_PER_M) - low) if own.any() else 0
    moved = np.zeros(BINS, np.float32)
    if above < BINS:
        moved[above:] = own[: BINS - above]
    moved[: len(density)] = density[:BINS]
    fog.low[row] = low * BIN_M * QUANTA_PER_M
    own[:] = moved


def fog_at(
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    low: NDArray[np.int32],
    density: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Density of the cloud where photons are, (n,) float32 [1/m2]; 0 outside of one.

    Parameters
    ----------
    cell, height : (n,) intp, (n,) int32
        Rows of cells, and photons [quanta].
    low, density : (cells,) int32, (cells, BINS) float32
        As of :class:`Fog`.
    """
    found = np.zeros(len(cell), np.float32)
    some = np.flatnonzero(density.max(axis=1, initial=0.0)[cell])
    row = (height[some].astype(np.int64) - low[cell[some]]) // (BIN_M * QUANTA_PER_M)
    inside = (row >= 0) & (row < BINS)
    found[some[inside]] = density[cell[some[inside]], row[inside]]
    return found


def outside(cell: NDArray[np.intp], height: NDArray[np.int32], fog: Fog) -> NDArray[np.intp]:
    """Photons outside of clouds; all of a cell that has no other."""
    clear = fog_at(cell, height, *fog) == 0.0
    some = np.bincount(cell[clear], minlength=len(fog.low)) > 0
    return np.flatnonzero(clear | ~some[cell])


def reached(fog: Fog, low: NDArray[np.int64], length: int) -> NDArray[np.bool_]:
    """Whether a cloud reaches into height bins from ``low`` on, (n, bins) bool."""
    first = fog.low.astype(np.int64)[:, None]
    top = first + _filled(fog)[:, None] * BIN_M * QUANTA_PER_M
    found: NDArray[np.bool_] = (top > first) & (low < top) & (low + length > first)
    return found


def _filled(fog: Fog) -> NDArray[np.int64]:
    """Bins up to the last one that a cloud fills, (n,) int64; 0 where there is none."""
    filled = fog.density > 0.0
    last: NDArray[np.int64] = BINS - filled[:, ::-1].argmax(axis=1)
    return np.where(filled.any(axis=1), last, 0)


def fog_told(index: NDArray[np.int64], fog: Fog, cell_m: float) -> dict[str, float]:
    """What a reader is told of the clouds along a beam; empty where there is none.

    That is how much of the track has one, from where to where, between which heights most of it
    lies, and how many photons a run counts in it.
    """
    bins = _filled(fog)
    at = np.flatnonzero(bins)
    if not len(at):
        return {}
    low_m = fog.low[at] / QUANTA_PER_M
    high_m = low_m + BIN_M * bins[at]
    return {
        "length_m": len(at) * cell_m,
        "from_m": float(index[at[0]] * cell_m),
        "to_m": float((index[at[-1]] + 1) * cell_m),
        "low_m": float(np.median(low_m)),
        "high_m": float(np.median(high_m)),
        "photons": float(fog.density[at].sum(dtype=np.float64) * BIN_M * cell_m),
    }


def _foot(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    mode: NDArray[np.int64],
    noise: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Top of the ground of each cell [quanta], whether it is known, and in the patch: (n,) each.

    It is the height that many cells around share, or the fullest metre where that is a layer;
    between such cells it is interpolated.
    """
    n, half = len(index), QUANTA_PER_M // 2
    common, level = common_metre(index, mode, REACH_CELLS)
    mode = np.where(level, common, mode)
    inside = np.abs(height // half - mode[cell]) <= 1
    there = np.bincount(cell[inside], minlength=n)
    least, share = _SURFACE
    signal = np.bincount(cell, minlength=n) - noise
    surface = level | (there >= np.maximum(least, share * signal))
    if not surface.any():
        return np.zeros(n, np.int64), surface, surface
    ground, known = _between(index, surface, mode * half + half // 2)
    own = sums_around(index, (surface & (there >= least))[:, None], PATCH_CELLS)[:, 0] > 0
    return ground + round(_NEAR_M * QUANTA_PER_M), known, own


def _between(
    index: NDArray[np.int64], some: NDArray[np.bool_], values: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Values of some cells, for the others from the two nearest within reach.

    Returns (n,) int64 and, where there is one, (n,) bool.
    """
    own, value = index[some], values[some]
    at = np.searchsorted(own, index)
    side = np.stack([np.clip(at - 1, 0, None), np.minimum(at, len(own) - 1)])
    apart = np.abs(own[side] - index)
    weight = np.where(apart <= GROUND_CELLS, 1.0 / np.maximum(apart, 1e-9), 0.0)
    total = weight.sum(axis=0)
    mean = (weight * value[side]).sum(axis=0) / np.where(total > 0, total, 1.0)
    return np.rint(mean).astype(np.int64), total > 0


def _sky(seen: NDArray[np.float64], seen_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density of the emptiest quarter of what lies above the ground, (n, 1) float64 [1/m2]."""
    whole = seen_m2 > 0.5 * seen_m2.max(axis=1, keepdims=True)
    density = np.sort(np.where(whole, seen / np.where(whole, seen_m2, 1.0), np.inf), axis=1)
    at = np.minimum(whole.sum(axis=1) // 4, _SEARCHED - 1)
    quarter = np.take_along_axis(density, at[:, None], axis=1)
    return np.where(np.isfinite(quarter), quarter, 0.0)


def _layers(seen: NDArray[np.float64], sky: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Bins of stacks that hold more than the sky: (n, bins) bool."""
    stack = np.ones(_STACK)
    many, few = (
        ndimage.convolve1d(values, stack, axis=1, mode="constant") for values in (seen, sky)
    )
    more = many > few + _SD * np.sqrt(few + 1.0) + 1.0
    # The stack tells of the bins around its middle; at its ends those are empty.
    layer: NDArray[np.bool_] = more & (seen > sky)
    layer[:, 1:-1] |= layer[:, :-2] & layer[:, 2:]
    return layer


def _cells_around(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells of the track within a patch of each, without photons or not: (n,) int64 [count]."""
    first = np.maximum(index - PATCH_CELLS, index[0])
    found: NDArray[np.int64] = np.minimum(index + PATCH_CELLS, index[-1]) - first + 1
    return found


class _Runs(NamedTuple):
    """Stacks of bins that hold more than the sky."""

    row: NDArray[np.int64]  #: (r,): cell of each, in order.
    first: NDArray[np.int64]  #: (r,): its first bin, and the one behind its last.
    stop: NDArray[np.int64]
    which: NDArray[np.int64]  #: (b,): run of each bin, and where the bin is.
    at: tuple[NDArray[np.int64], NDArray[np.int64]]

    def total(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums of values of bins, (r,) float64."""
        total = np.zeros(len(self.row))
        np.add.at(total, self.which, values[self.at])
        return total


def _runs(layer: NDArray[np.bool_]) -> _Runs:
    label, number = ndimage.label(layer, structure=[[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    row, column = np.nonzero(layer)
    which = label[row, column] - 1
    first, stop = np.full(number, layer.shape[1]), np.zeros(number, np.int64)
    np.minimum.at(first, which, column)
    np.maximum.at(stop, which, column + 1)
    own = np.zeros(number, np.int64)
    own[which] = row
    return _Runs(own, first, stop, which.astype(np.int64), (row, column))


def _even(
    runs: _Runs,
    seen: NDArray[np.float64],
    sky: NDArray[np.float64],
    squares: NDArray[np.float64],
    cells: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Runs that are thick and surely there, and whose photons scatter as chance does: (r,) bool."""
    total, noise, square, spread = (runs.total(v) for v in (seen, sky, squares, seen**2))
    k = np.maximum(cells[runs.row], 2)
    boxes = (runs.stop - runs.first) * k
    mean = total / boxes
    dispersion = (square - spread / k) / np.maximum(total, 1.0) * (k / (k - 1))
    chance = _SD * np.sqrt((2.0 + 1.0 / np.maximum(mean, 1e-9)) / boxes)
    even: NDArray[np.bool_] = (runs.stop - runs.first >= _THICK) & (total >= _LEAST)
    even &= total > noise + _SURE_SD * np.sqrt(noise + 1.0)
    even &= dispersion <= 1.0 + _CLUMPED * mean + chance
    return even


def _floating(runs: _Runs, index: NDArray[np.int64], foot: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Runs that nothing joins to the ground, within reach along the track: (r,) bool.

    A run begins on the ground or low above it, or is joined to such a one by those of cells beside
    each other: a wooded slope climbs out of its valley step by step.
    """
    low, high = foot[runs.row] + runs.first, foot[runs.row] + runs.stop
    grounded = runs.first * BIN_M + _NEAR_M < CLEAR_M
    edges = np.searchsorted(runs.row, np.arange(len(index) + 1))
    at = index[runs.row]
    fronts: list[list[int]] = [[] for _ in range(JOINED_CELLS + 1)]
    fronts[0] = np.flatnonzero(grounded).tolist()
    for step, front in enumerate(fronts):
        for run in front:
            i = int(runs.row[run])
            for j in (i - 1, i + 1):
                others = range(edges[j], edges[j + 1]) if 0 <= j < len(index) else ()
                for other in others:
                    away = step + abs(int(at[other] - at[run]))
                    near = low[other] <= high[run] + 1 and low[run] <= high[other] + 1
                    if near and not grounded[other] and away <= JOINED_CELLS:
                        grounded[other] = True
                        fronts[away].append(other)
    return ~grounded
