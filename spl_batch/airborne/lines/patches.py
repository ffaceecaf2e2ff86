"""Planar patches that two flightlines share, and by how much the later lies above the earlier.

A patch is a square of an absolute grid, 5 m or where returns are few 10 or 20 m, in which the
returns of both flightlines lie on one plane, but for a step between them. All signal counts: where
two flightlines lie apart, ground is chosen from the lower one.

Planes are fitted by least squares, with slopes that both flightlines share and a height of each.
Strips are compared as in H.-G. Maas (2002, *Methods for measuring height and planimetry
discrepancies in airborne laserscanner data*, PE&RS 68(9), 933-940): heights, where slopes show the
horizontal part. He takes points of a triangulation; whole patches have a known noise.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.store.flown_lines import LINES
from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.lattice.row_order import distinct
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, inside, quanta

COLUMNS_NEEDED: Final = ("x", "y", "z", "line")
"""Columns of the points that patches are made of."""

EDGE_M: Final = 5.0
"""Edge of the smallest patch [m]."""

LEVELS: Final = 3
"""Sizes of patches [count]: each has twice the edge of the one before."""

SQUARE_M: Final = EDGE_M * 2 ** (LEVELS - 1)
"""Edge of the largest patch [m]: a region is looked at in whole squares of it."""

MIN_RETURNS_PER_PATCH: Final = 12
"""Returns that each flightline has in a patch, at least [count]."""

THICKEST_M: Final = 0.25
"""Standard deviation of the returns about the plane of a patch, at most [m]."""

STEEPEST: Final = 1.2
"""Slope of a patch, at most [rise/run]."""

SPREAD: Final = 0.15
"""Standard deviation of a flightline's returns in each direction, at least [edges of the patch]:
0.29 where they lie evenly."""

MOST: Final = 256
"""Patches of a pair that a ground cell keeps [count]: more make it no better known."""

Patches = dict[str, NDArray[Any]]
"""Columns of patches, see :func:`find_patches`."""


class Squares(NamedTuple):
    """Squares of one size in which flightlines have returns, one by one, then line by line."""

    row: NDArray[np.int64]  #: (k,): from the south of the region [count].
    column: NDArray[np.int64]  #: (k,): from its west [count].
    line: NDArray[np.int64]  #: (k,): flightline, by its number.
    #: (k, 10): count and sums of x, y, z, xx, xy, yy, xz, yz, zz of its returns [quanta]. In sums x
    #: and y count from the middle of the largest square around, so that they may be added up.
    moments: NDArray[np.int64]

    def take(self, rows: NDArray[np.intp]) -> "Squares":
        """Some of them."""
        return Squares(*(column[rows] for column in self))


def find_patches(table: PointTable, core: Bounds) -> tuple[Patches, NDArray[np.int64]]:
    """Patches of a ground cell that two flightlines share, and pairs that overlap.

    Columns of a patch: ``first, second``, numbers of its flightlines, the lesser first; ``x, y``,
    its middle [m]; ``edge_m``; ``rise``, the second above the first [m]; ``variance`` of it [m2];
    ``east, north``, slope [rise/run], and ``ee, en, nn``, its covariance; ``thickness``, standard
    deviation about the plane [m]; ``returns``, those of both [count]. Pairs overlap, (m, 2), that
    have :data:`MIN_RETURNS_PER_PATCH` returns each in one of the largest squares. ``table``: signal
    returns of :func:`region`; squares that begin in ``core`` are the cell's [quanta].
    """
    whole = region(core)
    squares = squares_of(table, whole)
    found = list(_shared_by(squares, EDGE_M, whole))
    for level in range(1, LEVELS):
        squares = in_fours(squares)
        found += _shared_by(squares, EDGE_M * 2**level, whole)
    met = squares.take(np.flatnonzero(squares.moments[:, 0] >= MIN_RETURNS_PER_PATCH))
    pairs = [met.line[np.stack(rows, axis=1)] for rows in _meetings(met)]
    overlaps = np.unique(np.concatenate([np.empty((0, 2), np.int64), *pairs]), axis=0)
    patches = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
    return _chosen(patches), overlaps


def rows_of(columns: Mapping[str, NDArray[Any]], rows: NDArray[np.intp]) -> Patches:
    """Some rows of columns by name."""
    return {name: values[rows] for name, values in columns.items()}


def region(core: Bounds) -> Bounds:
    """Whole squares whose south-west corners lie in a core [quanta]."""
    square = quanta(SQUARE_M)
    return Bounds(*(-(-end // square) * square for end in core))


def squares_of(table: PointTable, whole: Bounds) -> Squares:
    """Smallest squares of a region, of whole largest ones, that hold returns of flightlines."""
    lowest = table["z"].astype(np.int64).min(initial=2**31)
    table = table.take(inside(table["x"], table["y"], whole))
    x, y, z = table["x"] - whole.xmin, table["y"] - whole.ymin, table["z"] - lowest
    line, lines = distinct(table["line"])
    edge, largest = quanta(EDGE_M), quanta(SQUARE_M)
    columns = (whole.xmax - whole.xmin) // edge
    held, square = distinct((y // edge * columns + x // edge) * max(len(line), 1) + lines)
    x, y = (axis % largest - largest // 2 for axis in (x, y))
    sums = np.zeros((len(held), 10), np.int64)
    products = (np.ones_like(x), x, y, z, x * x, x * y, y * y, x * z, y * z, z * z)
    for total, values in zip(sums.T, products, strict=True):
        np.add.at(total, square, values)
    held, lines = np.divmod(held, max(len(line), 1))
    return Squares(*np.divmod(held, max(columns, 1)), line[lines].astype(np.int64), sums)


def in_fours(squares: Squares) -> Squares:
    """Squares of twice the edge, each of four."""
    row, column = squares.row // 2, squares.column // 2
    columns = int(column.max(initial=0)) + 1
    held, part = distinct((row * columns + column) * LINES + squares.line)
    sums = np.zeros((len(held), 10), np.int64)
    np.add.at(sums, part, squares.moments)
    place, line = np.divmod(held, LINES)
    return Squares(*np.divmod(place, columns), line, sums)


def _meetings(squares: Squares) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Flightlines that share a square, two by two: rows of the one and of the other."""
    place = squares.row * 2**32 + squares.column
    for apart in range(1, len(place)):
        first = np.flatnonzero(place[apart:] == place[:-apart])
        if not len(first):
            return
        yield first, first + apart


def _shared_by(squares: Squares, edge_m: float, whole: Bounds) -> Iterator[Patches]:
    """Patches among all squares of one size, those in which smaller ones were found as well."""
    squares = squares.take(np.flatnonzero(squares.moments[:, 0] >= MIN_RETURNS_PER_PATCH))
    sides = _centred(squares.moments)
    evenly = np.flatnonzero(_narrowest(sides) >= (SPREAD * edge_m) ** 2)
    squares, sides = squares.take(evenly), rows_of(sides, evenly)
    none = np.empty(0, np.intp)
    for first, second in ((none, none), *_meetings(squares)):
        found = _fitted(rows_of(sides, first), rows_of(sides, second))
        planar = np.flatnonzero(
            (found["thickness"] <= THICKEST_M)
            & (np.hypot(found["east"], found["north"]) <= STEEPEST)
        )
        mine = squares.take(first[planar])
        yield {
            "first": mine.line,
            "second": squares.line[second[planar]],
            "x": whole.xmin / QUANTA_PER_M + (mine.column + 0.5) * edge_m,
            "y": whole.ymin / QUANTA_PER_M + (mine.row + 0.5) * edge_m,
            "edge_m": np.full(len(planar), edge_m),
            **rows_of(found, planar),
        }


def _centred(moments: NDArray[np.int64]) -> dict[str, NDArray[np.float64]]:
    """Count, means [m] and sums about them [m2] of each square."""
    n, x, y, z, xx, xy, yy, xz, yz, zz = moments.T.astype(np.float64)
    found = {
        "x": x / n, "y": y / n, "z": z / n,
        "xx": xx - x * x / n, "xy": xy - x * y / n, "yy": yy - y * y / n,
        "xz": xz - x * z / n, "yz": yz - y * z / n, "zz": zz - z * z / n,
    }  # fmt: skip
    scaled = {k: v * QUANTUM_M ** len(k) for k, v in found.items()}
    return {"n": n, **scaled}


def _narrowest(side: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Variance of the returns in the direction in which they spread least [m2]."""
    half = (side["xx"] - side["yy"]) / 2
    root = np.hypot(half, side["xy"])
    narrow: NDArray[np.float64] = ((side["xx"] + side["yy"]) / 2 - root) / side["n"]
    return narrow


def _fitted(one: dict[str, NDArray[np.float64]], other: dict[str, NDArray[np.float64]]) -> Patches:
    """Planes of squares with slopes in common, by what :func:`_centred` gives of both sides."""
    xx, xy, yy, xz, yz, zz = (one[k] + other[k] for k in ("xx", "xy", "yy", "xz", "yz", "zz"))
    returns = one["n"] + other["n"]
    determinant = xx * yy - xy * xy
    east = (yy * xz - xy * yz) / determinant
    north = (xx * yz - xy * xz) / determinant
    square = np.maximum(zz - east * xz - north * yz, 0.0) / (returns - 4)
    scale = square / determinant
    ee, en, nn = yy * scale, -xy * scale, xx * scale
    dx, dy = other["x"] - one["x"], other["y"] - one["y"]
    rise = other["z"] - one["z"] - east * dx - north * dy
    variance = square * (1 / one["n"] + 1 / other["n"])
    variance += dx * dx * ee + 2 * dx * dy * en + dy * dy * nn
    return {
        "rise": rise, "variance": variance, "east": east, "north": north,
        "ee": ee, "en": en, "nn": nn, "thickness": np.sqrt(square), "returns": returns,
    }  # fmt: skip


def _chosen(patches: Patches) -> Patches:
    """Patches pair by pair: none around a smaller one, and no more than :data:`MOST` of each."""
    pair, edge_m = patches["first"] * LINES + patches["second"], patches["edge_m"]
    free = np.ones(len(pair), np.bool_)
    for size_m in (EDGE_M * 2**level for level in range(1, LEVELS)):
        i, j = (np.floor(patches[axis] / size_m).astype(np.int64) for axis in "xy")
        # A ground cell has fewer than 2**15 squares along an edge.
        place = (pair * 2**15 + i % 2**15) * 2**15 + j % 2**15
        held = place[edge_m < size_m]
        free &= (edge_m != size_m) | ~np.isin(place, held)
    order = np.lexsort([patches[key] for key in ("x", "y", "edge_m", "second", "first")])
    order = order[free[order]]
    slope = np.hypot(patches["east"], patches["north"])
    keep = []
    for mine in np.split(order, np.flatnonzero(np.diff(pair[order])) + 1):
        chosen = np.argsort(slope[mine], kind="stable")
        if len(mine) > MOST:  # half of them the steepest
            evenly = np.linspace(0, len(mine) - MOST // 2 - 1, MOST // 2).astype(int)
            chosen = np.concatenate([chosen[evenly], chosen[-MOST // 2 :]])
        keep.append(mine[np.sort(chosen)])
    return rows_of(patches, np.concatenate(keep))
