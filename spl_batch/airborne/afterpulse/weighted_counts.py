"""Weighted counts of other beamlets' returns around a point, in integers.

A count looks at nine columns of points, and in each at a slice of heights. Weights and kernels are
integers, so sums do not depend on the order of points, and hence neither on tiles nor on blocks.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.lattice_columns import Columns, first_above, most_around
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2
from spl_batch.numerics.simd import LANES, UL, ascending, load, number, pack, spread

UNIT: Final = 1024
"""Weight of a whole return, and of a kernel at its centre."""

WHOLE: Final = 4 * LANES
"""Weights that are summed at once: those of four vectors [count]."""


def weigh_around(
    made: Columns,
    time: NDArray[np.float64],
    channel: NDArray[np.uint8],
    weight: NDArray[np.int16],
    rows: NDArray[np.int32],
    radii: NDArray[np.int64],
    tilt: NDArray[np.float64],
    own: int,
    out: NDArray[np.int64],
) -> None:
    """Kernel sums of the weights around some points (m,): quickest in ascending order.

    ``made``: the points, coordinates from 0 on; other arrays have their order, weights up to
    :data:`UNIT`. ``radii`` (k, 2): horizontal and vertical radius of each kernel [quanta]; the
    first contains the others, and is at most as wide as a column's edge. ``tilt`` (m, 2): slopes of
    the kernels towards x and y. A return of the same beamlet counts for ``own`` above the point
    [returns / UNIT], and not at all below it. ``out`` (m, k) is filled with the sums of weight x
    (1 - d^2)^2 x :data:`UNIT`, d the distance in radii.
    """
    n, some = made.points.shape[1], weight != 0
    room = most_around(made) + 2 * WHOLE
    if 0 < n < LANES:
        # Too few to fill a vector: the last one stands in for those that there are not.
        filled = np.minimum(np.arange(LANES), n - 1)
        made = made._replace(points=np.take(made.points, filled, axis=1))
        time, some = time[filled], some[filled]
    _weigh_around(made, time, channel, weight, some, rows, radii, tilt, own, room, out)


@njit()
def _weigh_around(made, time, channel, weight, some, rows, radii, tilt, own, room, out):  # type: ignore[no-untyped-def]
    """:func:`weigh_around` with room for so many neighbours; ``some``: weights that are not 0."""
    xyz, starts, shape, edge = made.points, made.start, made.shape, made.edge
    wide, high = radii[0, 0], radii[0, 1]
    across, up = np.empty(len(radii)), np.empty(len(radii))
    for k in range(len(radii)):
        across[k], up[k] = 1.0 / float(radii[k, 0]) ** 2, 1.0 / float(radii[k, 1]) ** 2
    near, mates = np.empty(room, np.uint64), np.empty(room, np.uint64)
    flat, square, worth = np.zeros(room), np.zeros(room), np.zeros(room, np.int32)
    for q in range(len(rows)):
        row, bx, by = rows[q], tilt[q, 0], tilt[q, 1]
        span = high + math.ceil(math.hypot(bx, by) * wide)
        size, fellows = _ellipsoid(
            xyz, time, some, starts, shape, edge, row, span, across[0], up[0], (bx, by), near,
            mates, flat, square,
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


@njit()
def _ellipsoid(
    xyz: NDArray[np.int32], time: NDArray[np.float64], counts: NDArray[np.bool_],
    starts: NDArray[np.int64], shape: tuple[int, int], edge: int, row: int, span: int,
    across: float, up: float, slope: tuple[float, float], near: NDArray[np.uint64],
    mates: NDArray[np.uint64], flat: NDArray[np.float64], square: NDArray[np.float64],
) -> tuple[np.uint64, np.uint64]:  # fmt: skip
    """List what counts in an ellipsoid around a point; its horizontal radius is at most an edge.

    ``near`` receives the rows; ``flat`` and ``square`` their squared distances from the axis and
    from the middle plane, which may be tilted. ``mates`` receives the rows of the point's shot, its
    own among them. Returns the numbers of both.
    """
    nx, ny = shape
    x, y = spread(np.float64(xyz[U0, row])), spread(np.float64(xyz[U1, row]))
    z, top = spread(np.float64(xyz[U2, row])), xyz[U2, row] + span
    east, north, moment = spread(slope[0]), spread(slope[1]), spread(time[row])
    last = np.uint64(xyz.shape[1]) - UL
    own = xyz[U0, row] // edge, xyz[U1, row] // edge
    size = fellows = U0
    for i in range(max(own[0] - 1, 0), min(own[0] + 2, nx)):
        for j in range(max(own[1] - 1, 0), min(own[1] + 2, ny)):
            low, stop = starts[i * ny + j], starts[i * ny + j + 1]
            begin, end = (
                np.uint64(first_above(xyz, low, stop, xyz[U2, row] - span)),
                np.uint64(stop),
            )
            for p in range(begin, end, UL):
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
                taken = taken & (left > spread(0.0))
                at_once = taken & (load(time, at) == moment)
                if number(at_once) > U0:
                    pack(mates, fellows, rows, at_once)
                    fellows += number(at_once)
                    taken = taken & (load(time, at) != moment)
                pack(near, size, rows, taken)
                pack(flat, size, apart, taken)
                pack(square, size, off, taken)
                size += number(taken)
    return size, fellows


@njit()
def _weighed(
    flat: NDArray[np.float64], square: NDArray[np.float64], worth: NDArray[np.int32],
    size: np.uint64, across: float, up: float,
) -> np.int64:  # fmt: skip
    """Sum of weights times a kernel, in whole vectors: weights behind the last one are 0."""
    total = np.int64(0)
    for i in range((size + np.uint64(WHOLE - 1)) // np.uint64(WHOLE) * np.uint64(WHOLE)):
        left = 1.0 - flat[i] * across - square[i] * up
        left = max(left, 0.0)
        total += np.int64(worth[i]) * np.int64(np.int32(left * left * UNIT))
    return total
