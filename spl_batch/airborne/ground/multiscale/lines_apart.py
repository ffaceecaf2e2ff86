"""Ground of flightlines that lie above or below the others: by how much, place by place.

The surface of the ground follows one flightline where two lie apart, mostly the lower one, and the
ground of the other is no part of its thin layer. Where another flightline shows bare ground the
returns of this one tell how far it is off: in squares of 8 m most of them fill a thin layer at
another height. Plants do not look like that, as all flightlines see them in the same places. A
flightline is apart where half of the squares around, in 48 m, say so, by more than ranges scatter,
and half of those in the whole ground cell: else it is a field that grew between two flights. Its
returns are then compared with the surface at its own height.

Offsets are measured in each square, as a shift to the side raises a flightline on one slope and
lowers it on the next, and a roll grows across the track. Squares under trees take what those around
them tell. Everything is counted in squares of the absolute grid; what a place is told depends on
the points within a block of 16 m around its own.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.multiscale.near_surface import Near
from spl_batch.airborne.ground.multiscale.ranging_layer import BLOCK_M, Spread
from spl_batch.airborne.ground.multiscale_surface import ABOVE_SIGMA
from spl_batch.airborne.ground.point_spacing import Squares, added_up
from spl_batch.numerics.compiled import njit

SQUARE_M: Final = 8.0
"""Edge of the squares that offsets are measured in [m]: half a block's."""

CELL_M: Final = 2.0
"""Edge of the cells in which another flightline shows bare ground [m]."""

FAR_M: Final = 1.0
STEP_M: Final = 0.01
STEPS: Final = 200
"""Returns count up to so far from the surface, by such steps, so many in all [m, m, count]."""

FEWEST: Final = 20
"""Returns of a square that tell an offset, at least [count]."""

FEWEST_BARE: Final = 3
"""Returns of a cell that show bare ground, at least [count]."""

THIN: Final = 0.7
"""Share of the returns near the surface that a thin layer holds, at least."""

FEWEST_SQUARES: Final = 8
"""Squares of a block and those around that tell that a flightline is apart, at least [count]: a
fifth of them."""

MOST_LINES: Final = 64
"""Flightlines of a ground cell that are told apart [count]; where more meet, none is."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Lines(NamedTuple):
    """Which flightline each of some points is of.

    Parameters
    ----------
    number : (n,) int16
        Place of its flightline in ``keys``; of no meaning where more than :data:`MOST_LINES` meet.
    keys : (m,) int64
        Flightlines, rising; no more than one too many.
    """

    number: NDArray[np.int16]
    keys: Index

    @property
    def several(self) -> bool:
        """Whether there is more than one, and each can be told apart."""
        return 1 < len(self.keys) <= MOST_LINES

    def some(self, chosen: Mask | Index) -> "Lines":
        """Those of chosen points."""
        return Lines(self.number[chosen], self.keys)


class Apart(NamedTuple):
    """How far flightlines lie above the surface.

    Parameters
    ----------
    keys : (m,) int64
        Flightlines that are apart somewhere, rising.
    told_m : (m, rows, columns) float64
        Offset for the returns of a square [m]; NaN where the flightline fits or nothing is known.
    measured_m : (m, rows, columns) float64
        Offset of the squares that tell one [m], else NaN.
    first : (int, int)
        Row and column of the first square.
    """

    keys: Index
    told_m: Float
    measured_m: Float
    first: tuple[int, int]


def lines_of(psid: NDArray[np.uint16], time_s: NDArray[np.float64] | None, span_s: float) -> Lines:
    """Flightlines of n points.

    Parameters
    ----------
    psid : (n,) uint16
        Point source id.
    time_s : (n,) float64 or None
        Time, where ids do not tell flightlines; NaN for points without one [s].
    span_s : float
        Points of an id whose times lie in different spans of this length are of two [s].
    """
    number, keys = np.zeros(len(psid), np.int16), np.empty(MOST_LINES + 1, np.int64)
    span = np.full(len(psid), -1, np.int64)
    if time_s is not None:
        timed = np.isfinite(time_s)
        span[timed] = np.floor(time_s[timed] / span_s).astype(np.int64)
    count = _number(psid, span, keys, number)
    keys = keys[:count]
    order = np.argsort(keys)
    rank = np.empty(count, np.int16)
    rank[order] = np.arange(count)
    return Lines(rank[number], keys[order])


@njit()
def _number(psid: NDArray[np.uint16], span: Index, keys: Index, out: NDArray[np.int16]) -> int:
    """Fill the flightlines as they come, and that of each point, until one is too many."""
    count, last = 0, 0
    for i in range(len(psid)):
        key = (np.int64(psid[i]) << 44) + span[i]
        if count == 0 or keys[last] != key:
            last = 0
            while last < count and keys[last] != key:
                last += 1
            if last == count:
                keys[last] = key
                count += 1
                if count == len(keys):
                    return count
        out[i] = last
    return count


def seen_lines(
    near: Near, place: tuple[Float, Float], lines: Lines, sigma: Spread
) -> dict[int, Squares]:
    """What points near a surface show of their flightlines: counts by squares and height.

    Parameters
    ----------
    near : Near
        Points near the surface that are evidence, of whole blocks.
    place : two (n,) float64
        Eastings and northings of all points [m].
    lines : Lines
        Their flightlines.
    sigma : Spread
        Standard deviation of a range.

    Returns
    -------
    dict of int to Squares
        By the key of a flightline; ``sums`` is (rows, columns, STEPS) int32. Only returns in cells
        of :data:`CELL_M` count in which another flightline shows bare ground.
    """
    if not len(near.at) or len(lines.keys) > MOST_LINES:
        return {}
    x, y = (v[near.at] for v in place)
    number = lines.number[near.at]
    ends = [[int(np.floor(end / BLOCK_M)) for end in (v.min(), v.max())] for v in (y, x)]
    rows, columns = (high - low + 1 for low, high in ends)
    (south, _), (west, _) = ends
    blocks = sigma.over((south, west), (rows, columns))
    per_block = round(BLOCK_M / CELL_M)
    cells = np.zeros((len(lines.keys), rows * per_block, columns * per_block, 2), np.int32)
    corner = (south * BLOCK_M, west * BLOCK_M)
    _count_cells(near.off, x, y, number, ABOVE_SIGMA * blocks, corner, cells)
    bare = (cells[..., 0] >= FEWEST_BARE) & (cells[..., 0] >= THIN * cells[..., 1])
    others = bare.sum(axis=0) - bare > 0
    counts = np.zeros((len(lines.keys), 2 * rows, 2 * columns, STEPS), np.int32)
    _count_heights(near.off, x, y, number, others, corner, counts)
    return {
        key: Squares(of_line, (2 * south, 2 * west))
        for key, of_line in zip(lines.keys.tolist(), counts, strict=True)
    }


@njit()
def _count_cells(
    off: Float, x: Float, y: Float, number: NDArray[np.int16], thin_m: Float,
    corner: tuple[float, float], out: NDArray[np.int32],
) -> None:  # fmt: skip
    """Add points within the layer of the surface, and all near it, by flightline and cell."""
    for i in range(len(off)):
        if abs(off[i]) < FAR_M:
            north, east = y[i] - corner[0], x[i] - corner[1]
            r, c = int(north / CELL_M), int(east / CELL_M)
            out[number[i], r, c, 1] += 1
            if abs(off[i]) <= thin_m[int(north / BLOCK_M), int(east / BLOCK_M)]:
                out[number[i], r, c, 0] += 1


@njit()
def _count_heights(
    off: Float, x: Float, y: Float, number: NDArray[np.int16], others: Mask,
    corner: tuple[float, float], out: NDArray[np.int32],
) -> None:  # fmt: skip
    """Add points by flightline, square and height, in cells in which others show bare ground."""
    for i in range(len(off)):
        if abs(off[i]) < FAR_M:
            north, east = y[i] - corner[0], x[i] - corner[1]
            if others[number[i], int(north / CELL_M), int(east / CELL_M)]:
                step = min(int((off[i] + FAR_M) / STEP_M), STEPS - 1)
                out[number[i], int(north / SQUARE_M), int(east / SQUARE_M), step] += 1


def lines_apart(
    seen: Sequence[Mapping[int, Squares]], lines: Sequence[Lines], sigma: Spread
) -> Apart | None:
    """Flightlines that lie apart, and how far; None if all fit.

    Parameters
    ----------
    seen : sequence of mapping
        What :func:`seen_lines` found in each part of a ground cell.
    lines : sequence of Lines
        Flightlines of each part: whether too many meet is asked of the cell.
    sigma : Spread
        Standard deviation of a range.
    """
    if len({key for part in lines for key in part.keys.tolist()}) > MOST_LINES:
        return None
    keys = sorted({key for part in seen for key in part})
    of_lines = {key: added_up([part[key] for part in seen if key in part]) for key in keys}
    found = {key: offsets(counts, sigma) for key, counts in of_lines.items()}
    found = {key: of for key, of in found.items() if np.isfinite(of[0]).any()}
    if not found:
        return None
    first = tuple(min(of_lines[key].first[k] for key in found) for k in (0, 1))
    size = [
        max(of_lines[key].first[k] + of_lines[key].sums.shape[k] for key in found) - first[k]
        for k in (0, 1)
    ]
    grids = np.full((2, len(found), *size), np.nan)
    for k, (key, both) in enumerate(found.items()):
        r, c = (a - b for a, b in zip(of_lines[key].first, first, strict=True))
        rows, columns = both[0].shape
        grids[:, k, r : r + rows, c : c + columns] = both
    return Apart(np.array([*found], np.int64), grids[0], grids[1], (first[0], first[1]))


def offsets(heights: Squares, sigma: Spread) -> tuple[Float, Float]:
    """How far a flightline lies above the surface, by squares of whole blocks.

    Parameters
    ----------
    heights : Squares
        Its returns by height, as :func:`seen_lines` counts them.
    sigma : Spread
        Standard deviation of a range.

    Returns
    -------
    told_m, measured_m : (rows, columns) float64
        As :class:`Apart` has them.
    """
    rows, columns, _ = heights.sums.shape
    corner = heights.first[0] // 2, heights.first[1] // 2
    blocks = sigma.over(corner, (rows // 2, columns // 2))
    sigma_m = np.repeat(np.repeat(blocks, 2, axis=0), 2, axis=1)
    measured = np.full((rows, columns), np.nan)
    _layers(heights.sums, np.rint(ABOVE_SIGMA * sigma_m / STEP_M).astype(np.int64), measured)
    known = np.isfinite(measured)
    off = np.abs(np.where(known, measured, 0.0)) > sigma_m
    squares, away = (_around(_by_block(of), 3) for of in (known, off))
    apart = (away >= FEWEST_SQUARES) & (2 * away >= squares)
    # A field that grew between two flights lies above the other flightline as well.
    apart &= 2 * np.count_nonzero(off) >= np.count_nonzero(known)
    held = _around(known, 5)
    filled = _around(np.where(known, measured, 0.0), 5) / np.maximum(held, 1.0)
    filled[held == 0.0] = np.nan
    told = np.where(known, measured, filled)
    told[~np.repeat(np.repeat(apart, 2, axis=0), 2, axis=1)] = np.nan
    return told, measured


def _by_block(squares: Mask) -> Index:
    """How many of the four squares of each block."""
    rows, columns = squares.shape
    found: Index = squares.reshape(rows // 2, 2, columns // 2, 2).sum(axis=(1, 3))
    return found


def _around(grid: NDArray[np.generic], edge: int) -> Float:
    """Sum over a square of cells around each."""
    summed: Float = ndimage.correlate(
        grid.astype(np.float64), np.ones((edge, edge)), mode="constant"
    )
    return summed


@njit()
def _layers(counts: NDArray[np.int32], half: Index, out: Float) -> None:
    """Height of the fullest layer of each square, where it holds most of the returns [m]."""
    rows, columns, _ = counts.shape
    for r in range(rows):
        for c in range(columns):
            of_square, reach = counts[r, c], half[r, c]
            n = of_square.sum()
            if n >= FEWEST:
                middle = _fullest(of_square, reach)
                inside, total = 0, 0
                for s in range(max(middle - reach, 0), min(middle + reach + 1, len(of_square))):
                    inside += of_square[s]
                    total += of_square[s] * s
                if inside >= THIN * n:
                    out[r, c] = (total / inside + 0.5) * STEP_M - FAR_M


@njit()
def _fullest(counts: NDArray[np.int32], reach: int) -> int:
    """Lowest step around which most are counted, as far as ``reach``."""
    best, most, inside = 0, -1, 0
    for s in range(-reach, len(counts)):
        if s + reach < len(counts):
            inside += counts[s + reach]
        if s - reach > 0:
            inside -= counts[s - reach - 1]
        if s >= 0 and inside > most:
            best, most = s, inside
    return best


def at_own_height(
    near: Near, place: tuple[Float, Float], lines: Lines, apart: Apart
) -> Near:  # fmt: skip
    """Points of flightlines that are apart, with heights above the surface at their own height.

    Parameters
    ----------
    near : Near
        Points near the surface.
    place : two (n,) float64
        Eastings and northings of all points [m].
    lines : Lines
        Their flightlines.
    apart : Apart
        How far these lie above the surface.
    """
    which = np.full(len(lines.keys), -1, np.int64)
    at = np.searchsorted(apart.keys, lines.keys)
    same = apart.keys.take(at, mode="clip") == lines.keys
    which[same] = at[same]
    off = np.full(len(near.at), np.nan)
    _lower(
        near.at, near.off, *place, which[lines.number],
        apart.told_m, apart.measured_m, apart.first, off,
    )  # fmt: skip
    chosen = np.isfinite(off)
    return Near(near.at[chosen], off[chosen], near.slope[chosen])


@njit()
def _lower(
    at: Index, off: Float, x: Float, y: Float, line: Index,
    told_m: Float, measured_m: Float, first: tuple[int, int], out: Float,
) -> None:  # fmt: skip
    """Fill heights less the offset, which is interpolated between the middles of squares."""
    _, rows, columns = told_m.shape
    for k in range(len(at)):
        i = at[k]
        m = line[i]
        if m < 0:
            continue
        north, east = y[i] / SQUARE_M - first[0], x[i] / SQUARE_M - first[1]
        r, c = int(np.floor(north)), int(np.floor(east))
        if not (0 <= r < rows and 0 <= c < columns) or np.isnan(told_m[m, r, c]):
            continue
        south, west = int(np.floor(north - 0.5)), int(np.floor(east - 0.5))
        total, weights = 0.0, 0.0
        for a in range(south, south + 2):
            for b in range(west, west + 2):
                if not (0 <= a < rows and 0 <= b < columns):
                    continue
                value = told_m[m, r, c] if a == r and b == c else measured_m[m, a, b]
                if not np.isnan(value):
                    weight = (1.0 - abs(north - 0.5 - a)) * (1.0 - abs(east - 0.5 - b))
                    total += weight * value
                    weights += weight
        out[k] = off[k] - total / weights
