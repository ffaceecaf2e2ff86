"""Weighted counts of what other beamlets return around a point, in integers.

Points are listed by square columns of the plane, from the lowest up, so that a count looks
at nine columns and in each at a slice of heights. Weights and kernels are integers: sums do
not depend on the order in which points are met, so neither on tiles nor on blocks.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.columns import first_above
from spl_batch.kernels.kdtree import U0, U1, U2
from spl_batch.kernels.lanes import LANES, UL, ascending, load, number, pack, spread
from spl_batch.kernels.robust_plane import plane_of_moments

UNIT: Final = 1024
"""Weight of a whole return, and of a kernel at its centre."""

WHOLE: Final = 32
"""Weights that are summed at once [count]; a power of two."""

MASS: Final = 8.0 / 35.0
"""Mean of the kernel (1 - d^2)^2 over the ball d < 1."""


class Columns(NamedTuple):
    """Points sorted by column, then height.

    Parameters
    ----------
    order : (n,) int32
        Rows in that order.
    starts : (nx * ny + 1,) int64
        Where columns start in ``order``, then n.
    shape : tuple of int
        nx, ny.
    edge : int
        Edge of a column [quanta].
    """

    order: NDArray[np.int32]
    starts: NDArray[np.int64]
    shape: tuple[int, int]
    edge: int


def columns(
    xyz: NDArray[np.int32],
    edge: int,
    sort: Callable[[NDArray[np.int64]], NDArray[np.intp]] = np.argsort,
) -> Columns:
    """List points by column.

    Parameters
    ----------
    xyz : (3, n) int32
        Coordinates >= 0 [quanta], 1 <= n < 2**31.
    edge : int
        Edge of a column [quanta].
    sort : callable
        Indices that put numbers in order.
    """
    i, j = xyz[0] // edge, xyz[1] // edge
    nx, ny = int(i.max()) + 1, int(j.max()) + 1
    column = i.astype(np.int64) * ny + j
    count = np.bincount(column, minlength=nx * ny)
    height = int(xyz[2].max()) + 1
    column *= height
    column += xyz[2]
    order = sort(column).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    return Columns(order, starts, (nx, ny), edge)


@njit(nogil=True, cache=True)
def _most_around(starts: NDArray[np.int64], shape: tuple[int, int]) -> int:
    """Most points in a column and the eight around it."""
    nx, ny = shape
    most = 0
    for i in range(nx):
        for j in range(ny):
            held = 0
            for k in range(max(i - 1, 0), min(i + 2, nx)):
                held += starts[k * ny + min(j + 2, ny)] - starts[k * ny + max(j - 1, 0)]
            most = max(most, held)
    return most


@njit(nogil=True, cache=True)
def _near(
    xyz: NDArray[np.int32], counts: NDArray[np.bool_], starts: NDArray[np.int64],
    shape: tuple[int, int], edge: int, row: int, wide: int, span: int,
    offsets: NDArray[np.float64],
) -> np.int64:  # fmt: skip
    """List what counts in an upright cylinder around a point: how many they are.

    ``offsets`` (3, m) is filled with their offsets, and beyond them. None is farther than ``span``
    up or down, and ``wide`` <= ``edge`` aside.
    """
    nx, ny = shape
    x, y, z = xyz[U0, row], xyz[U1, row], xyz[U2, row]
    last, size = np.uint64(xyz.shape[1]) - UL, U0
    most, high = spread(np.float64(wide * wide)), spread(np.float64(span))
    for i in range(max((x - wide) // edge, 0), min((x + wide) // edge + 1, nx)):
        for j in range(max((y - wide) // edge, 0), min((y + wide) // edge + 1, ny)):
            low, stop = starts[i * ny + j], starts[i * ny + j + 1]
            begin, end = np.uint64(first_above(xyz, low, stop, z - span)), np.uint64(stop)
            for p in range(begin, end, UL):
                if xyz[U2, p] > z + span:
                    break
                # The last eight of the table, where fewer are left of it.
                at = min(p, last)
                rows = ascending(at)
                dx = load(xyz, (U0, at)) - spread(np.float64(x))
                dy = load(xyz, (U1, at)) - spread(np.float64(y))
                dz = load(xyz, (U2, at)) - spread(np.float64(z))
                taken = load(counts, at) & (rows >= spread(p)) & (rows < spread(end))
                taken = taken & (dx * dx + dy * dy <= most) & (dz <= high)
                pack(offsets, (U0, size), dx, taken)
                pack(offsets, (U1, size), dy, taken)
                pack(offsets, (U2, size), dz, taken)
                size += number(taken)
    return np.int64(size)


@njit(nogil=True, cache=True)
def weigh_around(
    xyz: NDArray[np.int32],
    time: NDArray[np.float64],
    channel: NDArray[np.uint8],
    weight: NDArray[np.int16],
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    edge: int,
    rows: NDArray[np.int32],
    radii: NDArray[np.int64],
    tilt: NDArray[np.float64],
    own: int,
    out: NDArray[np.int64],
) -> None:
    """Kernel sums of the weights around some points.

    Parameters
    ----------
    xyz : (3, n) int32
        Points in the order of :class:`Columns` [quanta].
    time, channel : (n,) float64, uint8
        Their beamlets.
    weight : (n,) int16
        0 to :data:`UNIT`.
    starts, shape, edge
        As in :class:`Columns`.
    rows : (m,) int32
        Points to count around; quickest in ascending order.
    radii : (k, 2) int64
        Horizontal and vertical radius of each kernel [quanta]; the first one contains the
        others, and its horizontal radius is at most ``edge``.
    tilt : (m, 2) float64
        Slopes of the kernels towards x and y.
    own : int
        What a return of the same beamlet above the point counts for [returns / UNIT]; those
        below it do not count.
    out : (m, k) int64
        Filled with the sums of weight x (1 - d^2)^2 x :data:`UNIT`, d the distance in radii.
    """
    wide, high = radii[0, 0], radii[0, 1]
    across, up = 1.0 / radii[:, 0].astype(np.float64) ** 2, 1.0 / radii[:, 1] ** 2.0
    room = _most_around(starts, shape) + 2 * WHOLE
    near, mates, some = np.empty(room, np.uint64), np.empty(room, np.uint64), weight != 0
    flat, square, worth = np.zeros(room), np.zeros(room), np.zeros(room, np.int32)
    first, column = np.zeros(9, np.int64), -1
    spare = _spare_rows(xyz.shape[1])
    if len(spare):
        xyz, time, some = xyz[:, spare], time[spare], some[spare]
    for q in range(len(rows)):
        row, bx, by = rows[q], tilt[q, 0], tilt[q, 1]
        span = high + math.ceil(math.hypot(bx, by) * wide)
        column = _move_up(xyz, starts, shape, edge, row, span, column, first)
        size, fellows = _ellipsoid(
            xyz, time, some, starts, shape, column, first, row, span, across[0], up[0],
            (bx, by), near, mates, flat, square,
        )  # fmt: skip
        for i in range(size):
            worth[i] = weight[near[i]]
        for i in range(fellows):
            p = mates[i]
            dx, dy = np.float64(xyz[U0, p] - xyz[U0, row]), np.float64(xyz[U1, p] - xyz[U1, row])
            rise = np.float64(xyz[U2, p] - xyz[U2, row])
            flat[size], square[size] = dx * dx + dy * dy, (rise - bx * dx - by * dy) ** 2
            worth[size] = weight[p]
            if channel[p] == channel[row]:
                worth[size] = worth[size] * own // UNIT if rise > 0.0 else 0
            size += U1
        for i in range(size, size + np.uint64(WHOLE)):
            worth[i] = 0
        for k in range(len(radii)):
            out[q, k] = _weighed(flat, square, worth, size, across[k], up[k])


@njit(nogil=True, cache=True)
def _spare_rows(n: int) -> NDArray[np.int64]:
    """Rows to take of so few points that no vector would hold them: none of enough."""
    return np.minimum(np.arange(LANES), n - 1) if n < LANES else np.arange(0)


@njit(nogil=True, cache=True)
def _move_up(
    xyz: NDArray[np.int32], starts: NDArray[np.int64], shape: tuple[int, int], edge: int,
    row: int, span: int, before: int, first: NDArray[np.int64],
) -> int:  # fmt: skip
    """Where to begin in the columns around a point: its own column.

    ``first`` (9,) receives places below which all heights are less than the point's by more
    than ``span``; it holds those of a point in the column ``before``, beside which they mostly are.
    """
    nx, ny = shape
    own = int(xyz[U0, row] // edge) * ny + int(xyz[U1, row] // edge)
    bottom, k = xyz[U2, row] - span, 0
    for i in range(own // ny - 1, own // ny + 2):
        for j in range(own % ny - 1, own % ny + 2):
            if 0 <= i < nx and 0 <= j < ny:
                low, stop = starts[i * ny + j], starts[i * ny + j + 1]
                at = first[k] if own == before else first_above(xyz, low, stop, bottom)
                # Heights ascend, so whole vectors are passed by.
                while at + LANES <= stop and xyz[U2, at + LANES - 1] < bottom:
                    at += LANES
                while at > low and xyz[U2, at - 1] >= bottom:
                    at -= min(at - low, LANES)
                first[k] = at
            k += 1
    return own


@njit(nogil=True, cache=True)
def _ellipsoid(
    xyz: NDArray[np.int32], time: NDArray[np.float64], counts: NDArray[np.bool_],
    starts: NDArray[np.int64], shape: tuple[int, int], column: int, first: NDArray[np.int64],
    row: int, span: int, across: float, up: float, slope: tuple[float, float],
    near: NDArray[np.uint64], mates: NDArray[np.uint64], flat: NDArray[np.float64],
    square: NDArray[np.float64],
) -> tuple[np.uint64, np.uint64]:  # fmt: skip
    """List what counts in an ellipsoid around a point, whose horizontal radius is at most an edge.

    ``near`` receives the rows, ``flat`` and ``square`` their squared distances from the axis and
    from the middle plane, which may be tilted; ``mates`` the rows of the point's shot instead, its
    own among them. Returns how many there are of both.
    """
    nx, ny = shape
    x, y = spread(np.float64(xyz[U0, row])), spread(np.float64(xyz[U1, row]))
    z, top = spread(np.float64(xyz[U2, row])), xyz[U2, row] + span
    east, north, moment = spread(slope[0]), spread(slope[1]), spread(time[row])
    last = np.uint64(xyz.shape[1]) - UL
    size = fellows = U0
    k = 0
    for i in range(column // ny - 1, column // ny + 2):
        for j in range(column % ny - 1, column % ny + 2):
            if 0 <= i < nx and 0 <= j < ny:
                end = np.uint64(starts[i * ny + j + 1])
                for p in range(np.uint64(first[k]), end, UL):
                    if xyz[U2, p] > top:
                        break
                    # The last eight of the table, where fewer are left of it.
                    at = min(p, last)
                    rows = ascending(at)
                    dx, dy = load(xyz, (U0, at)) - x, load(xyz, (U1, at)) - y
                    off = load(xyz, (U2, at)) - z - east * dx - north * dy
                    apart, off = dx * dx + dy * dy, off * off
                    left = spread(1.0) - apart * spread(across) - off * spread(up)
                    taken = load(counts, at) & (rows >= spread(p)) & (rows < spread(end))
                    taken, at_once = taken & (left > spread(0.0)), load(time, at) == moment
                    pack(mates, fellows, rows, taken & at_once)
                    fellows += number(taken & at_once)
                    taken = taken & (load(time, at) != moment)
                    pack(near, size, rows, taken)
                    pack(flat, size, apart, taken)
                    pack(square, size, off, taken)
                    size += number(taken)
            k += 1
    return size, fellows


@njit(nogil=True, cache=True)
def _weighed(
    flat: NDArray[np.float64], square: NDArray[np.float64], worth: NDArray[np.int32],
    size: np.uint64, across: float, up: float,
) -> np.int64:  # fmt: skip
    """Sum of weights times a kernel, in whole vectors: behind the last one weights are 0."""
    total = np.int64(0)
    for i in range((size + np.uint64(WHOLE - 1)) // np.uint64(WHOLE) * np.uint64(WHOLE)):
        left = 1.0 - flat[i] * across - square[i] * up
        left = max(left, 0.0)
        total += np.int64(worth[i]) * np.int64(np.int32(left * left * UNIT))
    return total


@njit(nogil=True, cache=True)
def _parent(
    row: int, xyz: NDArray[np.int32], time: NDArray[np.float64], channel: NDArray[np.uint8],
    starts: NDArray[np.int64], shape: tuple[int, int], edge: int, lag: int, aside: int,
) -> int:  # fmt: skip
    """The lowest return of the beamlet above one of it; -1 for none.

    It is at most ``lag`` higher and ``aside`` <= ``edge`` away.
    """
    nx, ny = shape
    x, y, z = xyz[U0, row], xyz[U1, row], xyz[U2, row]
    own = int(x // edge) * ny + int(y // edge)
    # Most stand in its own column, and others must be lower.
    found: int = _mate(row, xyz, time, channel, row + 1, starts[own + 1], z + lag, aside)
    top = z + lag if found < 0 else xyz[U2, found] - 1
    for i in range(max((x - aside) // edge, 0), min((x + aside) // edge + 1, nx)):
        for j in range(max((y - aside) // edge, 0), min((y + aside) // edge + 1, ny)):
            column = i * ny + j
            if column == own or top <= z:
                continue
            stop = starts[column + 1]
            begin = first_above(xyz, starts[column], stop, z + 1)
            mate = _mate(row, xyz, time, channel, begin, stop, top, aside)
            if mate >= 0:
                found, top = mate, xyz[U2, mate] - 1
    return found


@njit(nogil=True, cache=True)
def _mate(row, xyz, time, channel, begin, stop, top, aside):  # type: ignore[no-untyped-def]
    """The first of a stretch of returns that is of a return's beamlet, and above it; -1 for none.

    Heights ascend; none is looked for above ``top``, or farther aside.
    """
    x, y, z = xyz[U0, row], xyz[U1, row], xyz[U2, row]
    moment, last, end = spread(time[row]), np.uint64(xyz.shape[1]) - UL, np.uint64(stop)
    for p in range(np.uint64(begin), end, UL):
        if xyz[U2, p] > top:
            return -1
        if number(load(time, min(p, last)) == moment) == U0:
            continue
        for q in range(p, min(p + UL, end)):
            if time[q] != time[row] or channel[q] != channel[row] or not z < xyz[U2, q] <= top:
                continue
            dx, dy = xyz[U0, q] - x, xyz[U1, q] - y
            if dx * dx + dy * dy <= aside * aside:
                return np.int64(q)
    return -1


@njit(nogil=True, cache=True, fastmath={"reassoc"})
def _moments(offsets: NDArray[np.float64], size: np.int64, sums: NDArray[np.float64]) -> None:
    """Sums of 1, u, v, w, uu, uv, vv, uw and vw of offsets: whole numbers, in any order."""
    u1 = v1 = w1 = 0.0
    uu = uv = vv = uw = vw = 0.0
    for i in range(np.uint64(size)):
        u, v, w = offsets[U0, i], offsets[U1, i], offsets[U2, i]
        u1 += u
        v1 += v
        w1 += w
        uu += u * u
        uv += u * v
        vv += v * v
        uw += u * w
        vw += v * w
    sums[0], sums[1], sums[2], sums[3] = size, u1, v1, w1
    sums[4], sums[5], sums[6], sums[7], sums[8] = uu, uv, vv, uw, vw


@njit(nogil=True, cache=True)
def _on_planes(
    offsets: NDArray[np.float64], size: np.int64, plane: NDArray[np.float64], level: float,
    thick: float,
) -> tuple[np.int64, np.int64]:  # fmt: skip
    """How many are within ``thick`` of a plane, and of one off by ``level`` but not of it."""
    here = there = np.int64(0)
    a, b, c = plane[0], plane[1], plane[2]
    for i in range(np.uint64(size)):
        distance = offsets[U2, i] - (a + b * offsets[U0, i] + c * offsets[U1, i])
        beside = abs(distance) > thick
        here += not beside
        there += (abs(distance - level) <= thick) & beside
    return here, there


@njit(nogil=True, cache=True)
def _plane_of(sums: NDArray[np.float64], plane: NDArray[np.float64]) -> bool:
    """Least squares plane w = a + b u + c v of such sums; False where there is none."""
    n = sums[0]
    mu, mv, mw = sums[1] / n, sums[2] / n, sums[3] / n
    uu, uv, vv = sums[4] - n * mu * mu, sums[5] - n * mu * mv, sums[6] - n * mv * mv
    uw, vw = sums[7] - n * mu * mw, sums[8] - n * mv * mw
    return plane_of_moments(mu, mv, mw, uu, uv, vv, uw, vw, 1e-3, plane)


@njit(nogil=True, cache=True)
def behind_plane(
    xyz: NDArray[np.int32], time: NDArray[np.float64], channel: NDArray[np.uint8],
    true: NDArray[np.bool_], starts: NDArray[np.int64], shape: tuple[int, int], edge: int,
    rows: NDArray[np.int32], lag: int, wide: int, high: int, thick: int, share: float,
    least: int, out: NDArray[np.bool_], tilt: NDArray[np.float64], parents: NDArray[np.int32],
) -> None:  # fmt: skip
    """Whether points lie behind a plane that the true returns around their parent make.

    Parameters
    ----------
    xyz, time, channel, starts, shape, edge, rows
        As in :func:`weigh_around`.
    true : (n,) bool
        Returns that count.
    lag : int
        Longest way down from a parent, which is at most ``edge`` aside [quanta].
    wide, high : int
        Radius and half-height of the cylinder around the parent [quanta], ``wide <= edge``.
    thick : int
        Half-thickness of a plane [quanta].
    share : float
        Least share of the returns in the cylinder that lie on the plane.
    least : int
        Least number of returns in it.
    out : (m,) bool
        Filled. The parent lies on the plane, the point behind it by more than ``thick``, and
        of the cylinder's returns at most one in twenty lies at its depth.
    tilt : (m, 2) float64
        Filled with the plane's slopes towards x and y, whatever lies at the point's depth;
        0 where there is no plane.
    parents : (m,) int32
        Filled with the points' parents, -1 for none.
    """
    sums, plane = np.empty(9), np.zeros(3)
    offsets = np.empty((3, _most_around(starts, shape) + LANES))
    spare = _spare_rows(xyz.shape[1])
    if len(spare):
        xyz, time, true = xyz[:, spare], time[spare], true[spare]
    for q in range(len(rows)):
        row = rows[q]
        out[q], tilt[q, 0], tilt[q, 1] = False, 0.0, 0.0
        # Most parents are near; a short search first spares a long one in crowns.
        close = min(lag // 10, edge)
        parent = _parent(row, xyz, time, channel, starts, shape, edge, lag // 5, close)
        if parent < 0:
            parent = _parent(row, xyz, time, channel, starts, shape, edge, lag, edge)
        parents[q] = parent
        if parent < 0:
            continue
        size = _near(xyz, true, starts, shape, edge, parent, wide, high, offsets)
        if size < least:
            continue
        _moments(offsets, size, sums)
        if not _plane_of(sums, plane):
            continue
        x, y = xyz[U0, row] - xyz[U0, parent], xyz[U1, row] - xyz[U1, parent]
        level = xyz[U2, row] - xyz[U2, parent] - (plane[0] + plane[1] * x + plane[2] * y)
        if abs(plane[0]) > thick or level >= -thick:
            continue
        here, there = _on_planes(offsets, size, plane, level, thick)
        if here >= share * size:
            tilt[q, 0], tilt[q, 1] = plane[1], plane[2]
            out[q] = 20 * there <= size
