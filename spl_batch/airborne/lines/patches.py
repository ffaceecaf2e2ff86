"""Planar patches that two flightlines share, and by how much the later lies above the earlier.

A patch is a square of an absolute grid, 5 m or where returns are few 10 or 20 m, in which the
returns of both flightlines lie on one plane, but for a step between them. All signal counts: where
two flightlines lie apart, ground is chosen from the lower one.

Planes are fitted by least squares, with slopes that both flightlines share and a height of each.
Strips are compared as in H.-G. Maas (2002, *Methods for measuring height and planimetry
discrepancies in airborne laserscanner data*, PE&RS 68(9), 933-940): heights, where slopes tell the
horizontal part. He takes points of a triangulation; whole patches have a known noise.
"""

import math
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

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

MOST_LINES: Final = 40
"""Flightlines of a ground cell that are compared, those with most returns [count]: more than fly
over one place. Memory and pairs grow with them."""

FLAT: Final = 0.176
"""Slope up to which a patch counts for differences of heights: 10 degrees, as the USGS Lidar Base
Specification has it [rise/run]."""

MOST: Final = 256
"""Patches of a pair that a ground cell keeps [count]: more tell no more of it."""

Patches = dict[str, NDArray[Any]]
"""Columns of patches, see :func:`find_patches`."""


class Seen(NamedTuple):
    """Flightlines of a region."""

    #: (s,): numbers of those that are compared, rising.
    numbers: NDArray[np.intp]
    returns: NDArray[np.int64]  #: (s,): points of each [count].
    left_out: int  #: Flightlines that could have patches, beyond :data:`MOST_LINES` [count].


def seen_lines(line: NDArray[np.uint16]) -> Seen:
    """Flightlines that have points enough for patches; ``line``: (n,), of each point."""
    returns = np.bincount(line)
    able = np.flatnonzero(returns >= MIN_RETURNS_PER_PATCH)
    most = np.sort(able[np.argsort(-returns[able], kind="stable")[:MOST_LINES]])
    return Seen(most, returns[most], len(able) - len(most))


def find_patches(
    table: PointTable, seen: Seen, core: Bounds
) -> tuple[Patches, set[tuple[int, int]]]:
    """Patches of a ground cell that two flightlines share, and pairs that overlap.

    Columns of a patch: ``first, second``, flightlines by their place in ``seen``; ``x, y``, its
    middle [m]; ``edge_m``; ``rise``, the second above the first [m]; ``variance`` of it [m2];
    ``east, north``, slope [rise/run], and ``ee, en, nn``, its covariance; ``thickness``, standard
    deviation about the plane [m]; ``returns``, those of both [count]. Pairs overlap that have
    :data:`MIN_RETURNS_PER_PATCH` returns each in one of the largest squares. ``table``: signal
    returns of :func:`region`; squares that begin in ``core`` are the cell's [quanta].
    """
    whole, count = region(core), len(seen.numbers)
    edge = quanta(EDGE_M)
    columns, rows = (whole.xmax - whole.xmin) // edge, (whole.ymax - whole.ymin) // edge
    none = np.zeros((0, 0), np.bool_)
    unseen = np.zeros((0, 0, 10), np.int64)
    _, fitted = _fitted(unseen, unseen, EDGE_M)
    found = [_rows(fitted, none, (0, 0), whole, EDGE_M)]
    if count < 2 or not rows or not columns:
        return found[0], set()
    place = np.full(int(table["line"].max()) + 1, -1, np.int64)
    place[seen.numbers] = np.arange(count)
    corner = (whole.xmin, whole.ymin, int(table["z"].min()))
    x, y, z = (table[axis].astype(np.int64) - low for axis, low in zip("xyz", corner, strict=True))
    moments = moments_of((x, y, z), place[table["line"]], (count, rows, columns))
    pairs = list(combinations(range(count), 2))
    free: NDArray[np.bool_] = np.ones((len(pairs), rows, columns), np.bool_)
    for level in range(LEVELS):
        size = EDGE_M * 2**level
        if level:
            moments = in_fours(moments).sum(axis=(2, 4))
            free = np.asarray(in_fours(free).all(axis=(2, 4)))
        for k, pair in enumerate(pairs):
            planar, fitted = _fitted(moments[pair[0]], moments[pair[1]], size)
            found.append(_rows(fitted, planar & free[k], pair, whole, size))
            free[k] &= ~planar
    full = moments[..., 0] >= MIN_RETURNS_PER_PATCH
    overlaps = {(a, b) for a, b in pairs if (full[a] & full[b]).any()}
    together = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
    return _thinned(together), overlaps


def region(core: Bounds) -> Bounds:
    """Whole squares whose south-west corners lie in a core [quanta]."""
    square = quanta(SQUARE_M)
    return Bounds(*(-(-end // square) * square for end in core))


def _fitted(
    first: NDArray[np.int64], second: NDArray[np.int64], edge_m: float
) -> tuple[NDArray[np.bool_], Patches]:
    """Planes of all squares with slopes in common, and which of them are patches."""
    one, other = _centred(first), _centred(second)
    xx, xy, yy, xz, yz, zz = (one[k] + other[k] for k in ("xx", "xy", "yy", "xz", "yz", "zz"))
    returns = one["n"] + other["n"]
    with np.errstate(divide="ignore", invalid="ignore"):
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
        least = (SPREAD * edge_m) ** 2
        planar = (determinant > 0) & (square <= THICKEST_M**2)
        planar &= (one["n"] >= MIN_RETURNS_PER_PATCH) & (other["n"] >= MIN_RETURNS_PER_PATCH)
        planar &= np.hypot(east, north) <= STEEPEST
        for side in (one, other):
            planar &= _narrowest(side) >= least
    columns = {
        "rise": rise, "variance": variance, "east": east, "north": north,
        "ee": ee, "en": en, "nn": nn, "square": square, "returns": returns,
    }  # fmt: skip
    return planar, columns


def _centred(moments: NDArray[np.int64]) -> dict[str, NDArray[np.float64]]:
    """Count, means [m] and sums about them [m2] of each square."""
    n, x, y, z, xx, xy, yy, xz, yz, zz = moments.transpose(2, 0, 1).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
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


def _rows(
    fitted: Patches, chosen: NDArray[np.bool_], pair: tuple[int, int], whole: Bounds, edge_m: float
) -> Patches:
    row, column = np.nonzero(chosen)
    count = len(row)
    values = {name: one[row, column] for name, one in fitted.items()}
    values["thickness"] = np.sqrt(values.pop("square"))
    return {
        "first": np.full(count, pair[0], np.int32),
        "second": np.full(count, pair[1], np.int32),
        "x": whole.xmin / QUANTA_PER_M + (column + 0.5) * edge_m,
        "y": whole.ymin / QUANTA_PER_M + (row + 0.5) * edge_m,
        "edge_m": np.full(count, edge_m),
        **values,
    }


def _thinned(patches: Patches) -> Patches:
    """No more than :data:`MOST` patches of each pair: half of them the steepest."""
    pair = patches["first"].astype(np.int64) * 2**32 + patches["second"]
    slope = np.hypot(patches["east"], patches["north"])
    keep = []
    for one in np.unique(pair):
        mine = np.flatnonzero(pair == one)
        if len(mine) > MOST:
            mine = mine[np.argsort(slope[mine], kind="stable")]
            steep = mine[-MOST // 2 :]
            rest = mine[: -MOST // 2]
            evenly = np.linspace(0, len(rest) - 1, MOST // 2).astype(int)
            mine = np.sort(np.concatenate([rest[evenly], steep]))
        keep.append(mine)
    rows = np.concatenate(keep) if keep else np.empty(0, np.intp)
    return {name: values[rows] for name, values in patches.items()}


def moments_of(
    xyz: tuple[NDArray[np.int64], ...], line: NDArray[np.int64], shape: tuple[int, int, int]
) -> NDArray[np.int64]:
    """Count and sums of x, y, z, xx, xy, yy, xz, yz, zz in squares: (lines, rows, columns, 10).

    ``xyz``: from the south-west of the first square and a height below all points on [quanta]. In
    sums x and y count from the middle of the largest square around, so that they may be added up.
    """
    edge, whole = quanta(EDGE_M), quanta(SQUARE_M)
    index = (line, xyz[1] // edge, xyz[0] // edge)
    mine = np.logical_and.reduce([(k >= 0) & (k < n) for k, n in zip(index, shape, strict=True)])
    at = np.ravel_multi_index([k[mine] for k in index], shape)
    x, y, z = (axis[mine] for axis in xyz)
    x, y = (axis % whole - whole // 2 for axis in (x, y))
    sums = np.zeros((math.prod(shape), 10), np.int64)
    products = (np.ones_like(x), x, y, z, x * x, x * y, y * y, x * z, y * z, z * z)
    for total, values in zip(sums.T, products, strict=True):
        np.add.at(total, at, values)
    return sums.reshape(*shape, 10)


def in_fours(squares: NDArray[Any]) -> NDArray[Any]:
    """Values of squares, (n, rows, columns, ...), by the square of twice the edge that holds them.

    (n, rows / 2, 2, columns / 2, 2, ...).
    """
    n, rows, columns, *each = squares.shape
    return squares.reshape(n, rows // 2, 2, columns // 2, 2, *each)
