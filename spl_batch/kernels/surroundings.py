"""Weighted counts of what other beamlets return around a point, in integers.

Points are listed by square columns of the plane, from the lowest up, so that a count looks
at nine columns and in each at a slice of heights. Weights and kernels are integers: sums do
not depend on the order in which points are met, so neither on tiles nor on blocks.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.robust_plane import plane_of_moments

UNIT: Final = 1024
"""Weight of a whole return, and of a kernel at its centre."""

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


def columns(xyz: NDArray[np.int32], edge: int) -> Columns:
    """List points by column.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates >= 0 [quanta], 1 <= n < 2**31.
    edge : int
        Edge of a column [quanta].
    """
    i, j = xyz[:, 0] // edge, xyz[:, 1] // edge
    nx, ny = int(i.max()) + 1, int(j.max()) + 1
    column = i.astype(np.int64) * ny + j
    count = np.bincount(column, minlength=nx * ny)
    height = int(xyz[:, 2].max()) + 1
    column *= height
    column += xyz[:, 2]
    order = np.argsort(column).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    return Columns(order, starts, (nx, ny), edge)


@njit(nogil=True, cache=True)
def _first_from(z: NDArray[np.int32], low: int, high: int, level: int) -> int:
    """First of the ascending ``z[low:high]`` that is not below a level."""
    while low < high:
        middle = (low + high) // 2
        if z[middle] < level:
            low = middle + 1
        else:
            high = middle
    return low


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
    xyz : (n, 3) int32
        Points in the order of :class:`Columns` [quanta].
    time, channel : (n,) float64, uint8
        Their beamlets.
    weight : (n,) int16
        0 to :data:`UNIT`.
    starts, shape, edge
        As in :class:`Columns`.
    rows : (m,) int32
        Points to count around.
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
    z = xyz[:, 2]
    nx, ny = shape
    wide, high = float(radii[0, 0]) ** 2, radii[0, 1]
    across, up = 1.0 / radii[:, 0].astype(np.float64) ** 2, 1.0 / radii[:, 1] ** 2.0
    for q in range(len(rows)):
        row = rows[q]
        x0, y0, z0 = xyz[row]
        t0, c0 = time[row], channel[row]
        bx, by = tilt[q]
        span = high + math.ceil(math.hypot(bx, by) * radii[0, 0])
        out[q] = 0
        for i in range(max(x0 // edge - 1, 0), min(x0 // edge + 2, nx)):
            for j in range(max(y0 // edge - 1, 0), min(y0 // edge + 2, ny)):
                stop = starts[i * ny + j + 1]
                for p in range(_first_from(z, starts[i * ny + j], stop, z0 - span), stop):
                    if z[p] > z0 + span:
                        break
                    dx, dy = float(xyz[p, 0] - x0), float(xyz[p, 1] - y0)
                    flat = dx * dx + dy * dy
                    if flat >= wide or weight[p] == 0:
                        continue
                    worth = int(weight[p])
                    if time[p] == t0 and channel[p] == c0:
                        worth = worth * own // UNIT if z[p] > z0 else 0
                    square = (float(z[p] - z0) - bx * dx - by * dy) ** 2
                    for k in range(len(radii)):
                        left = 1.0 - flat * across[k] - square * up[k]
                        if left > 0.0:
                            out[q, k] += worth * int(left * left * UNIT)


@njit(nogil=True, cache=True)
def _parent(
    row: int, xyz: NDArray[np.int32], time: NDArray[np.float64], channel: NDArray[np.uint8],
    starts: NDArray[np.int64], shape: tuple[int, int], edge: int, lag: int, aside: int,
) -> int:  # fmt: skip
    """The lowest return of the beamlet above one of it; -1 for none.

    It is at most ``lag`` higher and ``aside`` <= ``edge`` away.
    """
    nx, ny = shape
    x0, y0, z0 = xyz[row]
    found = -1
    for i in range(max((x0 - aside) // edge, 0), min((x0 + aside) // edge + 1, nx)):
        for j in range(max((y0 - aside) // edge, 0), min((y0 + aside) // edge + 1, ny)):
            stop = starts[i * ny + j + 1]
            for p in range(_first_from(xyz[:, 2], starts[i * ny + j], stop, z0 + 1), stop):
                if xyz[p, 2] > z0 + lag or (found >= 0 and xyz[p, 2] >= xyz[found, 2]):
                    break
                flat = (xyz[p, 0] - x0) ** 2 + (xyz[p, 1] - y0) ** 2
                if time[p] == time[row] and channel[p] == channel[row] and flat <= aside * aside:
                    found = p
    return found


@njit(nogil=True, cache=True)
def _sum_around(
    row: int, xyz: NDArray[np.int32], true: NDArray[np.bool_], starts: NDArray[np.int64],
    shape: tuple[int, int], edge: int, wide: int, high: int, plane: NDArray[np.float64],
    levels: NDArray[np.float64], thick: float, sums: NDArray[np.int64],
) -> None:  # fmt: skip
    """Sums over the true returns in an upright cylinder around one of them.

    ``sums`` (10,) int64 is filled with their number, the sums of u, v, w, uu, uv, vv, uw and
    vw, and how many are within ``thick`` of the plane; ``sums`` (10 + k,) counts those
    within it of parallel planes, off by ``levels`` (k,), as well. All are integers, so the
    order in which points are met is of no matter.
    """
    nx, ny = shape
    x0, y0, z0 = xyz[row]
    sums[:] = 0
    for i in range(max((x0 - wide) // edge, 0), min((x0 + wide) // edge + 1, nx)):
        for j in range(max((y0 - wide) // edge, 0), min((y0 + wide) // edge + 1, ny)):
            stop = starts[i * ny + j + 1]
            for p in range(_first_from(xyz[:, 2], starts[i * ny + j], stop, z0 - high), stop):
                u, v, w = xyz[p, 0] - x0, xyz[p, 1] - y0, xyz[p, 2] - z0
                if w > high:
                    break
                if not true[p] or u * u + v * v > wide * wide:
                    continue
                sums[0] += 1
                sums[1] += u
                sums[2] += v
                sums[3] += w
                sums[4] += u * u
                sums[5] += u * v
                sums[6] += v * v
                sums[7] += u * w
                sums[8] += v * w
                distance = w - (plane[0] + plane[1] * u + plane[2] * v)
                sums[9] += abs(distance) <= thick
                for k in range(len(levels)):
                    sums[10 + k] += abs(distance - levels[k]) <= thick < abs(distance)


@njit(nogil=True, cache=True)
def _plane_of(sums: NDArray[np.int64], plane: NDArray[np.float64]) -> bool:
    """Least squares plane w = a + b u + c v of such sums; False where there is none."""
    n = float(sums[0])
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
    sums, plane = np.empty(11, dtype=np.int64), np.zeros(3)
    level = np.zeros(1)
    for q in range(len(rows)):
        out[q], tilt[q] = False, 0.0
        # Most parents are near; a short search first spares a long one in crowns.
        near = min(lag // 10, edge)
        parent = _parent(rows[q], xyz, time, channel, starts, shape, edge, lag // 5, near)
        if parent < 0:
            parent = _parent(rows[q], xyz, time, channel, starts, shape, edge, lag, edge)
        parents[q] = parent
        if parent < 0:
            continue
        for step in range(2):
            _sum_around(
                parent, xyz, true, starts, shape, edge, wide, high, plane, level, thick, sums
            )
            if sums[0] < least or (step == 1 and sums[9] < share * sums[0]):
                break
            if step == 1:
                tilt[q] = plane[1:]
                out[q] = 20 * sums[10] <= sums[0]
            elif _plane_of(sums, plane):
                x, y, z = xyz[rows[q]] - xyz[parent]
                level[0] = z - (plane[0] + plane[1] * x + plane[2] * y)
                if abs(plane[0]) > thick or level[0] >= -thick:
                    break
            else:
                break
