"""Planar patches that two flightlines share, and by how much the later lies above the earlier.

A patch is a square of an absolute grid, 5 m or where returns are few 10 or 20 m, in which the
returns of both flightlines lie on one plane, but for a step between them. All signal counts: where
two flightlines lie apart, ground is chosen from the lower one.

Planes are fitted by least squares, with slopes that both flightlines share and a height of each.
Strips are compared as in H.-G. Maas (2002, *Methods for measuring height and planimetry
discrepancies in airborne laserscanner data*, PE&RS 68(9), 933-940): heights, where slopes tell the
horizontal part. He takes points of a triangulation; whole patches have a known noise.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.strips.patch_moments import add_moments, doubled
from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "point_source_id")
"""Columns of the points that patches are made of."""

EDGE_M: Final = 5.0
"""Edge of the smallest patch [m]."""

LEVELS: Final = 3
"""Sizes of patches [count]: each has twice the edge of the one before."""

SQUARE_M: Final = EDGE_M * 2 ** (LEVELS - 1)
"""Edge of the largest patch [m]: a region is looked at in whole squares of it."""

FEWEST: Final = 12
"""Returns that each flightline has in a patch, at least [count]."""

THICKEST_M: Final = 0.25
"""Standard deviation of the returns about the plane of a patch, at most [m]."""

STEEPEST: Final = 1.2
"""Slope of a patch, at most [rise/run]."""

SPREAD: Final = 0.15
"""Standard deviation of a flightline's returns in each direction, at least [edges of the patch]:
0.29 where they lie evenly."""

MOST_PASSES: Final = 40
"""Passes of a ground cell that are compared, those with most returns [count]: more than fly over
one place. Memory and pairs grow with them."""

FLAT: Final = 0.176
"""Slope up to which a patch counts for differences of heights: 10 degrees, as the USGS Lidar Base
Specification has it [rise/run]."""

STEP_M: Final = 0.005
"""Thicknesses that are told apart where the largest differences are kept [m]."""

MOST: Final = 256
"""Patches of a pair that a ground cell keeps [count]: more tell no more of it."""

Patches = dict[str, NDArray[Any]]
"""Columns of patches, see :func:`find_patches`."""


@dataclass(frozen=True, slots=True)
class Passes:
    """What was flown over a region in one go."""

    psid: NDArray[np.int64]  #: (s,): point source id of each pass, rising.
    #: (s,): second in which it begins there, rising for an id; NaN where its points have no time.
    time_s: NDArray[np.float64]
    returns: NDArray[np.int64]  #: (s,): points of each [count].
    lowest: NDArray[np.int64]  #: (s,): height of its lowest point [quanta].

    @property
    def left_out(self) -> int:
        """Passes that could have patches, but are beyond :data:`MOST_PASSES` [count]."""
        return max(int((self.returns >= FEWEST).sum()) - MOST_PASSES, 0)

    def of(self, table: PointTable) -> NDArray[np.int32]:
        """Pass of each point of one of the tables that they were found in: (n,) int32."""
        found = np.empty(len(table), np.int32)
        for one, mine in _by_id(table):
            passes, second = np.flatnonzero(self.psid == one), np.floor(table["gps_time"][mine])
            begins = self.time_s[passes]
            timed = passes[np.isfinite(begins)]
            place = np.searchsorted(self.time_s[timed], second, side="right") - 1
            found[mine] = np.where(
                np.isfinite(second), timed[place] if len(timed) else 0, passes[0]
            )
        return found


class _Seen(NamedTuple):
    """Points of one point source id, by second; NaN for those without a time."""

    second: NDArray[np.float64]
    returns: NDArray[np.int64]
    lowest: NDArray[np.int64]


def find_passes(tables: Iterable[PointTable], gap_s: float) -> Passes:
    """Divide points by point source id and, where one has long pauses, by time.

    Parameters
    ----------
    tables : iterable of PointTable
        Points with ``gps_time``, ``point_source_id`` and ``z``, table by table.
    gap_s : float
        A pause of more than this parts two passes [s].
    """
    seen: dict[int, list[_Seen]] = {}
    for of_table in map(_seen, tables):
        for one, found in of_table.items():
            seen.setdefault(one, []).append(found)
    passes: list[tuple[int, float, int, int]] = []
    for one in sorted(seen):
        second, count, lowest = (np.concatenate(some) for some in zip(*seen[one], strict=True))
        begins, place = np.unique(second, return_inverse=True)  # NaN comes last, and once
        opens = np.diff(begins, prepend=-np.inf) > gap_s
        opens |= np.isnan(begins)
        number = (np.cumsum(opens) - 1)[place]
        returns = np.zeros(int(opens.sum()), np.int64)
        np.add.at(returns, number, count)
        low = np.full(len(returns), np.iinfo(np.int64).max)
        np.minimum.at(low, number, lowest)
        mine = zip(begins[opens].tolist(), returns.tolist(), low.tolist(), strict=True)
        # those without a time first
        passes += [(one, *rest) for rest in sorted(mine, key=lambda rest: not np.isnan(rest[0]))]
    psid, time_s, returns_of, lowest_of = zip(*passes, strict=True) if passes else ((), (), (), ())
    return Passes(
        np.array(psid, np.int64),
        np.array(time_s, np.float64),
        np.array(returns_of, np.int64),
        np.array(lowest_of, np.int64),
    )


def _by_id(table: PointTable) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Each point source id of a table, and its points."""
    psid = table["point_source_id"]
    for one in np.flatnonzero(np.bincount(psid)).tolist():
        yield one, np.flatnonzero(psid == one)


def _seen(table: PointTable) -> dict[int, _Seen]:
    """Points of a table by point source id and second."""
    found = {}
    for one, mine in _by_id(table):
        time, z = table["gps_time"][mine], table["z"][mine].astype(np.int64)
        timed = np.isfinite(time)
        parts = []
        if not timed.all():
            low = z[~timed].min(keepdims=True)
            parts.append(_Seen(np.array([np.nan]), np.array([np.count_nonzero(~timed)]), low))
        if timed.any():
            held, place = _distinct(np.floor(time[timed]))
            low = np.full(len(held), np.iinfo(np.int64).max)
            np.minimum.at(low, place, z[timed])
            parts.append(_Seen(held, np.bincount(place, minlength=len(held)), low))
        found[one] = _Seen(*(np.concatenate(some) for some in zip(*parts, strict=True)))
    return found


def find_patches(
    tables: Iterable[PointTable],
    passes: Passes,
    core: Bounds,
    overlaps: set[tuple[int, int]] | None = None,
) -> Patches:
    """Patches of a ground cell that two passes share.

    Parameters
    ----------
    tables : iterable of PointTable
        Signal returns with :data:`COLUMNS_NEEDED` of :func:`region`, table by table: those in which
        the passes were found.
    core : Bounds
        What the cell owns: patches in squares that begin in it [quanta].
    overlaps : set of (int, int), optional
        Gets the pairs of passes with :data:`FEWEST` returns each in one of the largest squares.

    Returns
    -------
    dict of str to (p,) ndarray
        ``first, second``: passes, the one with less point source id and time first; ``x, y``:
        middle [m]; ``edge_m``; ``rise``: the second above the first [m]; ``variance`` of it [m2];
        ``east, north``: slope [rise/run], and ``ee, en, nn``, its covariance; ``thickness``:
        standard deviation about the plane [m]; ``returns``: those of both [count]; ``beyond``: 1
        for one that is kept beyond the sample of its pair, as the largest ``rise`` of those of up
        to 10 degrees and its thickness, else 0.
    """
    whole = region(core)
    edge, joined = quanta(EDGE_M), 2 ** (LEVELS - 1)
    columns, rows = (whole.xmax - whole.xmin) // edge, (whole.ymax - whole.ymin) // edge
    chosen = _compared(passes)
    strips = len(chosen)
    found: list[Patches] = []
    if strips < 2 or not rows or not columns:
        return _joined(found)
    number = np.full(len(passes.psid), -1, np.int16)
    number[chosen] = np.arange(strips)
    corner = np.array([whole.xmin, whole.ymin, passes.lowest[chosen].min()], np.int64)
    moments = np.zeros((strips, rows, columns, 10), np.int64)

    def add(table: PointTable) -> None:
        strip = number[passes.of(table)]
        mine = strip >= 0
        x, y, z = (np.ascontiguousarray(table[axis][mine], np.int64) for axis in "xyz")
        add_moments(x, y, z, strip[mine], corner, edge, joined, moments)

    for _ in map(add, tables):  # a table is held by nothing while the next one is read
        pass
    order = sorted(range(strips), key=lambda k: (passes.psid[chosen[k]], passes.time_s[chosen[k]]))
    free = {pair: np.ones((rows, columns), np.bool_) for pair in combinations(order, 2)}
    for level in range(LEVELS):
        size = EDGE_M * 2**level
        for pair, room in free.items():
            planar, fitted = _fitted(moments[pair[0]], moments[pair[1]], size)
            named = (chosen[pair[0]], chosen[pair[1]])
            found.append(_rows(fitted, planar & room, named, whole, size))
            free[pair] = room & ~planar
        if level + 1 < LEVELS:
            moments = doubled(moments)
            free = {pair: _all_four(room) for pair, room in free.items()}
    if overlaps is not None:
        full = moments[..., 0] >= FEWEST
        overlaps |= {(chosen[a], chosen[b]) for a, b in free if (full[a] & full[b]).any()}
    return _thinned(_joined(found))


def _compared(passes: Passes) -> list[int]:
    """Passes that can have patches, those with most returns where there are many."""
    returns = passes.returns
    able = np.flatnonzero(returns >= FEWEST)
    most = able[np.argsort(-returns[able], kind="stable")[:MOST_PASSES]]
    return sorted(most.tolist())


def region(core: Bounds) -> Bounds:
    """Whole squares whose south-west corners lie in a core [quanta]."""
    square = quanta(SQUARE_M)
    return Bounds(*(-(-end // square) * square for end in core))


def _distinct(values: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """Whole numbers without repetition, rising, and where each of the given ones is."""
    low, high = float(values.min()), float(values.max())
    if high - low > 1e6:
        return np.unique(values, return_inverse=True)
    step = (values - low).astype(np.intp)
    there = np.bincount(step) > 0
    return low + np.flatnonzero(there), (np.cumsum(there) - 1)[step]


def _all_four(room: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Squares of twice the edge of which no part is taken."""
    rows, columns = room.shape
    return np.asarray(room.reshape(rows // 2, 2, columns // 2, 2).all(axis=(1, 3)))


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
        planar &= (one["n"] >= FEWEST) & (other["n"] >= FEWEST)
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


def _joined(found: list[Patches]) -> Patches:
    if not found:
        names = ("x", "y", "edge_m", "rise", "variance", "east", "north", "ee", "en", "nn")
        empty = {name: np.empty(0) for name in (*names, "returns", "thickness", "beyond")}
        return {"first": np.empty(0, np.int32), "second": np.empty(0, np.int32), **empty}
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def _thinned(patches: Patches) -> Patches:
    """No more than :data:`MOST` patches of each pair, of all slopes, and the largest differences.

    Which patches are smooth is known when those of all cells are together: of each thickness, in
    steps of :data:`STEP_M`, the largest difference is kept.
    """
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
    others = np.setdiff1d(np.flatnonzero(slope <= FLAT), rows)
    step = np.floor(patches["thickness"][others] / STEP_M).astype(np.int64)
    order = np.lexsort((-np.abs(patches["rise"][others]), step, pair[others]))
    changes = np.diff(pair[others][order], prepend=-1) | np.diff(step[order], prepend=-1)
    beyond = others[order[changes != 0]]
    kept = {name: values[np.append(rows, beyond)] for name, values in patches.items()}
    return {**kept, "beyond": np.repeat(np.array([0, 1], np.uint8), [len(rows), len(beyond)])}
