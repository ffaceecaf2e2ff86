"""Clouds and fog in the gate, and their density by height.

A cloud sends back light from every height that it fills: its photons come as noise does, only
denser. One density for the whole gate calls them signal, or makes the noise elsewhere too high.

Three things keep a cloud apart from trees and hills. It floats: it begins more than
:data:`CLEAR_M` above the ground, and nothing joins it to the ground, cell by cell. It is thick.
And its photons are no nearer to one another than chance brings them: counts in boxes scatter as
those of a Poisson process do, where a slope or a crown fills some boxes and leaves the others
(index of dispersion, R. Fisher, *Statistical Methods for Research Workers*, 1925). Fog near the
ground cannot be told from trees by photons, and stays signal: a reader is told of it, by
:mod:`~spl_batch.altimetry.noise.mist`.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.noise.layers_above import (
    BIN_M,
    GROUND_CELLS,
    NEAR_M,
    PATCH_CELLS,
    Above,
    Foot,
    even,
    shown_around,
    sure,
)
from spl_batch.altimetry.photon_table import along_track
from spl_batch.constants import QUANTA_PER_M

BINS: Final = 64
"""Bins of a cloud; what reaches higher counts as sky [count]."""

JOINED_CELLS: Final = GROUND_CELLS + 2 * PATCH_CELLS
"""Cells along which what is joined to the ground is followed [count]."""

CLEAR_M: Final = 45.0
"""A cloud begins farther above the ground than this: trees may have bare stems [m]."""

_BRIGHT: Final = 5.0
"""Times the sky's noise that a cloud holds at least which hides the ground."""

_THICK: Final = 2
"""Bins that a cloud fills at least [count]."""

_CLUMPED: Final = 1.2
"""Squared coefficient of variation of a cloud's density among boxes, at most."""


class Fog(NamedTuple):
    """What cells show of a cloud."""

    #: (n,): its lower end [quanta].
    low: NDArray[np.int32]
    #: (n, BINS): photons by height above that, sky included [1/m2]; 0 where there is no cloud.
    density: NDArray[np.float32]


def find_fog(layers: Above, ground: Foot) -> Fog:
    """Find the cloud of each cell, if there is one.

    Parameters
    ----------
    layers, ground : Above, Foot
        What stands above the ground, and that.
    """
    runs, n = layers.runs, len(layers.number)
    fog = Fog(np.zeros(n, np.int32), np.zeros((n, BINS), np.float32))
    cloud = (runs.stop - runs.first >= _THICK) & sure(layers) & even(layers, _CLUMPED)
    # Where ground is seen in the distance alone, noise may hide how a slope climbs from there.
    bright = runs.total(layers.seen) > _BRIGHT * runs.total(layers.sky)
    cloud &= ground.near[runs.row] | bright
    if cloud.any():
        cloud &= _floating(layers)
    cloud &= shown_around(layers, cloud)
    for run in np.flatnonzero(cloud)[::-1]:
        i, first, stop = int(runs.row[run]), int(runs.first[run]), int(runs.stop[run])
        area = np.maximum(layers.seen_m2[i, first:stop], 1e-9)
        _put(fog, i, int(layers.foot[i]) + first, layers.seen[i, first:stop] / area)
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


def extent(fog: Fog) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lower and upper end of each cell's cloud, (n,) int64 each [quanta]; equal where none is."""
    first = fog.low.astype(np.int64)
    return first, first + _filled(fog) * BIN_M * QUANTA_PER_M


def _filled(fog: Fog) -> NDArray[np.int64]:
    """Bins up to the last one that a cloud fills, (n,) int64; 0 where there is none."""
    filled = fog.density > 0.0
    last: NDArray[np.int64] = BINS - filled[:, ::-1].argmax(axis=1)
    return np.where(filled.any(axis=1), last, 0)


def fog_told(index: NDArray[np.int64], fog: Fog, cell_m: float) -> dict[str, float]:
    """What a reader is told of the clouds along a beam; empty where there is none.

    Photons are those that a run counts in them.
    """
    bins = _filled(fog)
    low_m = fog.low / QUANTA_PER_M
    photons = fog.density.sum(axis=1, dtype=np.float64) * BIN_M * cell_m
    return told(index, np.stack([low_m, low_m + BIN_M * bins, photons]), cell_m)


def told(index: NDArray[np.int64], layer: NDArray[np.float64], cell_m: float) -> dict[str, float]:
    """How much of a track has a layer, from where to where, and how high most of it lies.

    Parameters
    ----------
    index : (n,) int64
        Cells.
    layer : (3, n) float64
        Lower and upper end of each cell's layer [m], and its photons [count]; none is no layer.
    """
    at = np.flatnonzero(layer[2])
    if not len(at):
        return {}
    low_m, high_m, photons = layer[:, at]
    return {
        **along_track(index[at], cell_m),
        "low_m": float(np.median(low_m)),
        "high_m": float(np.median(high_m)),
        "photons": float(photons.sum()),
    }


def _floating(layers: Above) -> NDArray[np.bool_]:
    """Runs that nothing joins to the ground, within reach along the track: (r,) bool.

    A run begins on the ground or low above it, or is joined to such a one by those of cells beside
    each other: a wooded slope climbs out of its valley step by step.
    """
    runs, index, foot = layers.runs, layers.number, layers.foot
    low, high = foot[runs.row] + runs.first, foot[runs.row] + runs.stop
    grounded = runs.first * BIN_M + NEAR_M < CLEAR_M
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
