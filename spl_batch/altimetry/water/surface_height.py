"""Where the surface of each cell lies: above a shallow floor, not between both.

A reef a metre below a lagoon draws the mean of what lies near its surface down, and is taken for
it where it is brighter. Photons show two layers then, and few between them.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.levelness import beside

_BIN: Final = 100
_BINS: Final = 36
"""Height of a bin of a surface and what lies just below it [quanta], and bins [count]."""

_NOWHERE: Final = _BIN * _BINS
"""Height of a photon over a surface that is not there [quanta]: beyond all bins."""

_APART: Final = 4
"""Bins from a shallow floor to the surface above it, at least [count]."""

_DIP: Final = 4
"""Times as many photons as between both that the surface has, at least."""

_THIN: Final = 3
_IN_BOTH: Final = 0.8
"""Bins from the middle of either to its end, and share of photons that lie in both: swell has as
many between its crests and its troughs."""

_PIECES: Final = 2
_TOGETHER: Final = 0.6
_CHANCE: Final = 0.8
"""Pieces of a cell [count], and overlap of two layers along the track, at least: less by so much
over the root of the fainter one's photons. Crests and troughs of swell lie side by side."""

_AROUND: Final = 10
_SEEN: Final = 2
"""Cells to each side that tell of a surface, and photons that show it where they do [count]."""

_SHOWN: Final = 4
_FAINT: Final = 0.1
_BRIGHT: Final = 0.3
"""Photons that show a layer, at least [count], and as a share of the other's: of a surface above a
brighter floor, and of a floor below a brighter surface. A fainter floor draws no level down."""


def heights_of(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    level: NDArray[np.int32],
    wet: NDArray[np.bool_],
    half: int,
    piece: NDArray[np.intp],
) -> NDArray[np.int32]:
    """The levels, each put to the mean of its layer or of the one above a shallow floor.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    cell, height : (p,) intp, (p,) int32
        Row of each photon's cell; photons [quanta].
    level, wet : (n,) int32, (n,) bool
        Surface of each cell, about [quanta]; whether there is one.
    half : int
        Half-thickness of a surface [quanta].
    piece : (p,) intp
        Piece of its cell that each photon lies in, by :func:`piece_of`.

    Returns
    -------
    (n,) int32
        As ``level``; unchanged where there is no surface.
    """
    over = height.astype(np.int64) - level[cell]
    rows = np.flatnonzero(wet[cell] & (np.abs(over) <= _BIN * _BINS // 2))
    cell, over = cell[rows], over[rows]
    n = len(level)
    near = np.abs(over) <= half
    total = np.bincount(cell[near], over[near], n)
    mean = total / np.maximum(np.bincount(cell[near], minlength=n), 1)
    around = height[rows, None] - beside(index, np.where(wet, level, np.nan), 1)[cell]
    over = np.where(np.isnan(around), _NOWHERE, around).astype(np.int64)
    up = upper_peak(index, cell, over, piece[rows])
    up = np.where(wet, up, np.nan)
    missed = _beside_others(index, cell, level + up, height[rows], np.where(wet, level, 0))
    up = np.where(np.isfinite(up), up, missed - level)
    found = np.where(wet, level + np.rint(np.where(np.isfinite(up), up, mean)), level)
    return found.astype(np.int32)


def _beside_others(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    upper: NDArray[np.float64],
    height: NDArray[np.int32],
    level: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Surface of cells that show none above their floor, where half of those around do: (n,).

    It lies where theirs does, if photons are there [quanta]; NaN where it does not.
    """
    around = np.sort(beside(index, upper, _AROUND), axis=1)
    known, n = np.isfinite(around).sum(axis=1), len(index)
    usual = around[np.arange(n), np.maximum(known - 1, 0) // 2]
    near = np.abs(height - usual[cell]) <= _THIN * _BIN
    count = np.bincount(cell[near], minlength=n)
    mean = np.bincount(cell[near], height[near], n) / np.maximum(count, 1)
    low = (usual - level >= _APART * _BIN) & (usual - level <= _BIN * _BINS // 2)
    return np.where((known > _AROUND) & low & (count >= _SEEN), mean, np.nan)


def upper_peak(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    over: NDArray[np.int64],
    piece: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Height of the surface above a shallow floor over the level of both, (n,) [quanta].

    NaN where photons do not show two layers, and few between them.

    Parameters
    ----------
    cell : (p,) intp
        Rows of the cells of photons that may be of the surface.
    over : (p, 3) int64
        Their heights over the level of the cell before, of their own, and of the one behind
        [quanta]; :data:`_NOWHERE` where there is none.
    piece : (p,) intp
        Piece of its cell that each lies in.
    """
    n = len(index)
    by_piece = np.zeros((n, 3 * _PIECES, _BINS), np.int32)
    for step in (-1, 0, 1):
        at = np.searchsorted(index, index + step)[cell]
        row = over[:, step + 1] // _BIN + _BINS // 2
        there = (row >= 0) & (row < _BINS)
        along = (1 - step) * _PIECES + piece
        np.add.at(by_piece, (at[there], along[there], row[there]), 1)
    table = by_piece.sum(axis=1)
    three = table.copy()
    three[:, 1:] += table[:, :-1]
    three[:, :-1] += table[:, 1:]
    bins, main = np.arange(_BINS), three.argmax(axis=1)
    over_main = np.where(bins >= main[:, None] + _APART, three, 0).argmax(axis=1)
    below_main = np.where(bins <= main[:, None] - _APART, three, 0).argmax(axis=1)
    faint = _two_layers(table, three, (over_main, main), _FAINT)
    bright = _two_layers(table, three, (main, below_main), _BRIGHT)
    bright &= _together(by_piece, main, below_main)
    surface = np.where(faint, over_main, main)
    near = np.abs(bins - surface[:, None]) <= 2
    counted = np.where(near, table, 0)
    middle = (counted * ((bins - _BINS // 2) * _BIN + _BIN // 2)).sum(axis=1)
    return np.where(faint | bright, middle / np.maximum(counted.sum(axis=1), 1), np.nan)


def piece_of(inside_m: NDArray[np.float64], cell_m: float) -> NDArray[np.intp]:
    """Piece of its cell that each photon lies in, by its place from the cell's middle [m]."""
    piece = np.floor((inside_m / cell_m + 0.5) * _PIECES).astype(np.intp)
    return np.clip(piece, 0, _PIECES - 1)


def _together(
    by_piece: NDArray[np.int32], upper: NDArray[np.intp], lower: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether two layers lie over each other rather than side by side: (n,) bool.

    Parameters
    ----------
    by_piece : (n, pieces, bins) int32
        Photons of each piece and bin.
    upper, lower : (n,) intp
        Bins of the layers.
    """
    bins = np.arange(_BINS)
    counts = [
        np.where((np.abs(bins - layer[:, None]) <= 1)[:, None], by_piece, 0).sum(axis=2)
        for layer in (upper, lower)
    ]
    totals = [np.maximum(count.sum(axis=1), 1) for count in counts]
    shares = [count / total[:, None] for count, total in zip(counts, totals, strict=True)]
    overlap = np.minimum(*shares).sum(axis=1)
    least = _TOGETHER - _CHANCE / np.sqrt(np.minimum(*totals))
    return np.asarray(overlap >= least, np.bool_)


def _two_layers(
    table: NDArray[np.int64],
    three: NDArray[np.int64],
    layers: tuple[NDArray[np.intp], NDArray[np.intp]],
    share: float,
) -> NDArray[np.bool_]:
    """Whether photons show a surface and a floor, and few between them: (n,) bool.

    Parameters
    ----------
    table, three : (n, bins) int64
        Photons of each bin, and of each with the two beside it.
    layers : two (n,) intp
        Bin of the upper and of the lower one.
    share : float
        Photons of the fainter over those of the brighter, at least.
    """
    (upper, lower), rows, bins = layers, np.arange(len(table)), np.arange(_BINS)
    less, more = np.sort([three[rows, upper], three[rows, lower]], axis=0)
    between = (bins >= lower[:, None]) & (bins <= upper[:, None])
    dip = np.where(between, three, three.max(axis=1, keepdims=True)).min(axis=1)
    found = (upper - lower >= _APART) & (less >= np.maximum(_SHOWN, share * more))
    found &= _DIP * dip <= less
    thin = np.minimum(np.abs(bins - upper[:, None]), np.abs(bins - lower[:, None])) <= _THIN
    held = np.where(bins >= lower[:, None] - _THIN, table, 0)
    found &= (held * thin).sum(axis=1) >= _IN_BOTH * held.sum(axis=1)
    return np.asarray(found, np.bool_)
