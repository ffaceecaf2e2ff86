"""Returns behind a hard surface: below the plane that others make around their parent.

A parent is the return in front of one along the same beamlet. A plane is fitted to the returns in
an upright cylinder around it. Sums are of whole numbers, so their order does not matter.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.lattice_columns import Columns, first_above
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2


@njit()
def _near(
    made: Columns, counts: NDArray[np.bool_], row: int, wide: int, span: int,
    offsets: NDArray[np.float64],
) -> int:  # fmt: skip
    """List what counts in an upright cylinder around a point: how many they are.

    ``offsets`` (3, m) is filled with their offsets, at most ``wide`` aside and ``span`` up or down.
    """
    xyz, (nx, ny), edge = made.points, made.shape, made.edge
    x, y, z = xyz[U0, row], xyz[U1, row], xyz[U2, row]
    size = 0
    for i in range(max((x - wide) // edge, 0), min((x + wide) // edge + 1, nx)):
        for j in range(max((y - wide) // edge, 0), min((y + wide) // edge + 1, ny)):
            low, stop = made.start[i * ny + j], made.start[i * ny + j + 1]
            for p in range(first_above(xyz, low, stop, z - span), stop):
                if xyz[U2, p] > z + span:
                    break
                dx, dy = np.float64(xyz[U0, p] - x), np.float64(xyz[U1, p] - y)
                if counts[p] and dx * dx + dy * dy <= wide * wide:
                    offsets[0, size], offsets[1, size], offsets[2, size] = dx, dy, xyz[U2, p] - z
                    size += 1
    return size


@njit()
def parents_of(
    order: NDArray[np.int32],
    start: NDArray[np.int32],
    xyz: NDArray[np.int32],
    chosen: NDArray[np.bool_],
    lag: int,
    aside: int,
    out: NDArray[np.int32],
) -> None:
    """Fill the lowest return of the same beamlet above each chosen point: rows (n,), -1 for none.

    ``order, start``: :class:`~spl_batch.airborne.beams.shot_runs.Beamlets`. It is at most ``lag``
    higher, and ``aside`` away [quanta]. Of two as high the one that is first in canonical order.
    """
    for row in range(len(out)):
        out[row] = -1
    for b in range(len(start) - 1):
        first, last = start[b], start[b + 1]
        for k in range(first, last if last > first + 1 else first):
            row, best = int(order[k]), -1
            if not chosen[row]:
                continue
            x, y, z = xyz[row, U0], xyz[row, U1], xyz[row, U2]
            for other in order[first:last]:
                if xyz[other, U2] > z and (best < 0 or xyz[other, U2] < xyz[best, U2]):
                    best = int(other)
            if best >= 0 and xyz[best, U2] - z <= lag:
                dx, dy = np.float64(xyz[best, U0] - x), np.float64(xyz[best, U1] - y)
                if dx * dx + dy * dy <= np.float64(aside) ** 2:
                    out[row] = best


@njit(fastmath={"reassoc"})
def _moments(offsets: NDArray[np.float64], size: int, sums: NDArray[np.float64]) -> None:
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


@njit()
def _on_planes(
    offsets: NDArray[np.float64], size: int, plane: NDArray[np.float64], level: float,
    thick: float,
) -> tuple[np.int64, np.int64]:  # fmt: skip
    """How many lie within ``thick`` of a plane, and how many only of one ``level`` away."""
    here = there = np.int64(0)
    a, b, c = plane[0], plane[1], plane[2]
    for i in range(np.uint64(size)):
        distance = offsets[U2, i] - (a + b * offsets[U0, i] + c * offsets[U1, i])
        beside = abs(distance) > thick
        here += not beside
        there += (abs(distance - level) <= thick) & beside
    return here, there


@njit()
def _plane_of(sums: NDArray[np.float64], plane: NDArray[np.float64]) -> bool:
    """Least squares plane w = a + b u + c v of such sums; False where there is none."""
    n = sums[0]
    mu, mv, mw = sums[1] / n, sums[2] / n, sums[3] / n
    uu, uv, vv = sums[4] - n * mu * mu, sums[5] - n * mu * mv, sums[6] - n * mv * mv
    uw, vw = sums[7] - n * mu * mw, sums[8] - n * mv * mw
    determinant = uu * vv - uv * uv
    if determinant <= 1e-3 * (uu + vv) ** 2:  # they lie on a line
        return False
    plane[1] = (uw * vv - vw * uv) / determinant
    plane[2] = (vw * uu - uw * uv) / determinant
    plane[0] = mw - plane[1] * mu - plane[2] * mv
    return True


@njit()
def behind_plane(
    made: Columns, true: NDArray[np.bool_], rows: NDArray[np.int32], parents: NDArray[np.int32],
    cylinder: tuple[int, int, int], share: float, least: int, out: NDArray[np.bool_],
    tilt: NDArray[np.float64], offsets: NDArray[np.float64],
) -> None:  # fmt: skip
    """Whether points lie behind a plane that the true returns around their parents (m,) make.

    ``cylinder``: radius and half-height of what is looked at around a parent, and half-thickness of
    the plane [quanta]. At least ``share`` of the returns in it lie on the plane. ``out`` (m,): the
    point lies behind it by more than the half-thickness, and of the cylinder's returns at most one
    in twenty lies at its depth. ``tilt`` (m, 2): the plane's slopes, whatever lies there, 0 where
    there is no plane. ``offsets`` (3, k): room for the returns in a cylinder.
    """
    xyz = made.points
    wide, high, thick = cylinder
    sums, plane = np.empty(9), np.zeros(3)
    for q in range(len(rows)):
        row, parent = rows[q], parents[q]
        out[q], tilt[q, 0], tilt[q, 1] = False, 0.0, 0.0
        if parent < 0:
            continue
        size = _near(made, true, parent, wide, high, offsets)
        if size < least:
            continue
        _moments(offsets, size, sums)
        if not _plane_of(sums, plane):
            continue
        x, y = xyz[U0, row] - xyz[U0, parent], xyz[U1, row] - xyz[U1, parent]
        level = xyz[U2, row] - xyz[U2, parent] - (plane[0] + plane[1] * x + plane[2] * y)
        if level >= -thick:
            continue
        here, there = _on_planes(offsets, size, plane, level, thick)
        if here >= share * size:
            tilt[q, 0], tilt[q, 1] = plane[1], plane[2]
            out[q] = 20 * there <= size
