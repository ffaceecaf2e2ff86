"""Highest return of each raster cell that others confirm: noise must not stand out.

Noise that the filter leaves hangs mostly a few metres above dense surfaces and crowns. A
count in a sphere cannot tell it from a thin crown: it counts the dense surface. So only
*peers* confirm a return (:mod:`spl_batch.kernels.spacing`): neighbours whose own spacing
is not much smaller. The top of a crown has the twigs around it; noise above a roof has
only other noise. Spheres of several radii are tried: a roof is confirmed within half a
metre, whatever its tilt, a thin crown within two.

Ground returns need no confirmation and give none: noise just above sparse ground must not
live on it.

The tops of the cells around confirm, too: where nearly all of them stand far above a cell's own
confirmed return, its highest return that is no higher than most of them counts
(:func:`lift_pits`). At the rim of a crown twigs may be too sparse to be each other's peers.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.kdtree import U0, U1, U3, box_distance, build, check_cap, leaf_of, leaf_slots
from spl_batch.kernels.spacing import Spacing, spacing_at, spacing_scratch

PIT_NEIGHBOURS = 6
"""Of eight cells around, those that have to stand above a pit [count]."""


class Support(NamedTuple):
    """What confirms a return: spheres, the smallest first.

    Parameters
    ----------
    radius : (s,) int64
        Radii [quanta].
    needed : (s,) int64
        Peers that each must hold, the confirmed one itself not counted [count].
    neighbours : int
        Spacing is the distance to this neighbour, at most the largest radius [count].
    peer_ratio : float
        A peer's spacing is at least the return's divided by this.
    """

    radius: NDArray[np.int64]
    needed: NDArray[np.int64]
    neighbours: int
    peer_ratio: float


def confirmed_tops(
    xyz: NDArray[np.int32],
    ground: NDArray[np.bool_],
    start: NDArray[np.int64],
    by: Support,
    tops: NDArray[np.float64],
) -> None:
    """Height of the highest confirmed return of each cell.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to any anchor [quanta], in the order of
        :func:`spl_batch.kernels.raster.sort_into_cells`: by cell, highest first.
    ground : (n,) bool
        Returns that need no confirmation and give none.
    start : (cells + 1,) int64
        Where each cell begins.
    by : Support
        What confirms a return.
    tops : (cells,) float64, written
        Heights [quanta]; NaN where no return is confirmed.
    """
    tops[:] = np.nan
    if not len(xyz):
        return
    tree = build(xyz)
    rule = Spacing(by.neighbours, int(by.radius.max()))
    check_cap(rule.cap)
    _tops(
        tree.points, tree.boxes, tree.depth, rule, by.peer_ratio**2, xyz, ground, start,
        by.radius.astype(np.float64) ** 2, by.needed, tops,
    )  # fmt: skip


@njit(nogil=True, cache=True)
def _tops(  # type: ignore[no-untyped-def]
    points, boxes, depth, rule, ratio2, xyz, ground, start, limit, needed, tops
):
    """From the highest return of each cell down to the first that is confirmed.

    Few returns are asked about, so a spacing is found when it is needed, and kept.
    """
    stack, scratch = np.empty(64, dtype=np.uint64), spacing_scratch(rule)
    depth = np.uint64(depth)
    spacing = np.full(len(xyz), np.nan)
    slot_of = np.empty(len(xyz), dtype=np.uint32)
    for slot in range(points.shape[1]):
        slot_of[points[U3, slot]] = slot
    tree = points, boxes, depth
    for cell in range(len(tops)):
        for p in range(start[cell], start[cell + 1]):
            accepted = ground[p]
            if not accepted:
                _find_spacing(tree, np.uint64(slot_of[p]), rule, scratch, spacing)
            for scale in range(len(limit)):
                if accepted:
                    break
                wanted = needed[scale] + 1
                found = _peers(
                    tree, rule, scratch, ratio2, ground, spacing, xyz[p], spacing[p], limit[scale],
                    wanted, stack,
                )  # fmt: skip
                accepted = found >= wanted
            if accepted:
                tops[cell] = xyz[p, 2]
                break


@njit(nogil=True, cache=True)
def _find_spacing(tree, slot, rule, scratch, spacing):  # type: ignore[no-untyped-def]
    """Squared spacing of a slot, if it is not known yet [quanta2]."""
    points, boxes, depth = tree
    row = points[U3, slot]
    if np.isnan(spacing[row]):
        leaf = leaf_of(slot, depth, np.uint64(points.shape[1]))
        keys, distance, fresh, stack, bound = scratch
        spacing[row] = spacing_at(
            points, boxes, depth, leaf, slot, rule, keys, distance, fresh, stack, bound
        )


@njit(nogil=True, cache=True)
def _peers(  # type: ignore[no-untyped-def]
    tree, rule, scratch, ratio2, ground, spacing, place, own, limit, wanted, stack
):
    """Peers within a distance of a return, itself among them; stops at ``wanted``.

    As :func:`spl_batch.kernels.spacing.peers_within`, which is given all spacings; here few are
    asked for and each costs a search, so they are found on the way, and no more than wanted.
    """
    points, boxes, depth = tree
    n, first = np.uint64(points.shape[1]), U1 << depth
    x, y, z = np.float64(place[0]), np.float64(place[1]), np.float64(place[2])
    count = 0
    stack[0] = U1
    top = U1
    while top > U0 and count < wanted:
        top -= U1
        node = stack[top]
        if box_distance(boxes, node, x, y, z) > limit:
            continue
        if node >= first:
            low, high = leaf_slots(node, depth, n)
            for slot in range(low, high):
                dx, dy, dz = points[U0, slot] - x, points[1, slot] - y, points[2, slot] - z
                row = points[U3, slot]
                if dx * dx + dy * dy + dz * dz <= limit and not ground[row]:
                    _find_spacing(tree, slot, rule, scratch, spacing)
                    count += spacing[row] * ratio2 >= own
                    if count >= wanted:
                        return count
            continue
        near, far = node + node, node + node + U1
        if box_distance(boxes, far, x, y, z) < box_distance(boxes, near, x, y, z):
            near, far = far, near
        stack[top] = far
        stack[top + U1] = near
        top += U1 + U1
    return count


@njit(nogil=True, cache=True)
def lift_pits(
    z: NDArray[np.int32],
    start: NDArray[np.int64],
    tops: NDArray[np.float64],
    depth: float,
    out: NDArray[np.float64],
) -> None:
    """Tops with pits lifted to returns that the tops around confirm.

    Parameters
    ----------
    z : (n,) int32
        Heights [quanta], by cell, highest first.
    start : (rows * cols + 1,) int64
        Where each cell begins.
    tops : (rows, cols) float64
        Confirmed tops [quanta]; NaN where there is none.
    depth : float
        A cell so far below :data:`PIT_NEIGHBOURS` of the eight around it is a pit [quanta].
    out : (rows, cols) float64, written
        A pit's highest return that is no higher than that many of them; else as ``tops``.
    """
    rows, cols = tops.shape
    around = np.empty(8)
    out[:] = tops
    for row in range(1, rows - 1):
        for col in range(1, cols - 1):
            known = 0
            for other in range(9):
                top = tops[row + other // 3 - 1, col + other % 3 - 1]
                if other != 4 and not np.isnan(top):
                    around[known] = top
                    known += 1
            if known < PIT_NEIGHBOURS or np.isnan(tops[row, col]):
                continue
            level = np.sort(around[:known])[known - PIT_NEIGHBOURS]
            if tops[row, col] > level - depth:
                continue
            cell = row * cols + col
            for p in range(start[cell], start[cell + 1]):
                if z[p] <= level:
                    out[row, col] = max(tops[row, col], np.float64(z[p]))
                    break
