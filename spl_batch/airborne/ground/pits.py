"""Nodes in pits: single low returns below a smooth surface of their neighbours.

Noise and afterpulses under a meadow make a lowest layer of their own, metre deep, and
adaptive triangulations start from the lowest. What distinguishes such a pit from ground seen
through leaves is what stands around it: leaves are rough, the meadow is smooth. Two
neighbours on opposite sides of a node give a height at its position by linear interpolation,
which no tilt of the ground changes. Where most of these heights agree with each other and
lie above the node, it is in a pit; where they scatter, nothing is decided.

Leaves scatter, but of the thousands of nodes where ground is seen through a crown, at some half
of twelve heights agree by chance, metres above. What is asked depends on how far above the node
they agree:

- up to :data:`WALL_M`, lower than crowns begin, heights above those that agree are of leaves
  over the same ground and prove nothing: a pit at the edge of a crown is one;
- farther up, all heights count, and a node below many returns of its own cell, as ground seen
  through a crown is, needs agreement among nodes that are not such single returns themselves:
  a roof fills its layers, leaves do not.

Below a closed crown none of this decides: few returns reach the ground, and the neighbours of what
noise has left there are leaves. Once the ground is separated from what stands on it, its own nodes
are the neighbours (:func:`~spl_batch.airborne.ground.multiscale.node_planes.under_planes`).

After the low-point tests of ground filters (isolated points below all neighbours
[Axelsson 2000 uses them before the seeds]); the comparison of opposite pairs is our own.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.scales import BESIDE_M, CELL_M, DEPTH_M, ROUGH_M, SIDES, WALL_M
from spl_batch.numerics.compiled import njit

_REACH = round(BESIDE_M / CELL_M)
_OUTVOTE = (2 * _REACH + 1) ** 2 // 2 // _REACH
"""Agreeing pairs for each that speaks for the node: of all in reach, those along a ditch do
[count]."""

_ENOUGH = SIDES // 2
"""Agreeing pairs that make a surface: as many as the nodes right around have, and half of those
that count [count]."""


@njit()
def in_pits(
    xyz: NDArray[np.float64],
    cell: NDArray[np.int64],
    asked: NDArray[np.bool_],
    doubtful: NDArray[np.bool_],
    rows: int,
    columns: int,
    reach: int,
    out: NDArray[np.bool_],
) -> None:
    """Which nodes lie in a pit.

    Parameters
    ----------
    xyz : (m, 3) float64
        Nodes [m], in order of their cells, the lowest of a cell first.
    cell : (m,) int64
        Cell of each node, row by row.
    asked : (m,) bool
        Nodes to be judged; the others are surroundings only.
    doubtful : (m,) bool
        Nodes of one or two returns below many others in the same cell.
    rows, columns : int
        Shape of the grid.
    reach : int
        Cells to look at on each side [count].
    out : (m,) bool, written
        True for a node in a pit.
    """
    lowest = np.empty(rows * columns, np.int64)
    for i in range(len(lowest)):
        lowest[i] = -1
    for i in range(len(cell) - 1, -1, -1):
        lowest[cell[i]] = i
    most = ((2 * reach + 1) ** 2 - 1) // 2
    height, firm = np.empty(most), np.empty(most, dtype=np.int64)
    for i in range(len(cell)):
        out[i] = False
        if not asked[i]:
            continue
        pairs = _pair_heights(xyz, lowest, doubtful, i, cell[i], rows, columns, reach, height, firm)
        out[i] = _below(height[:pairs], firm[:pairs], xyz[i, 2], int(doubtful[i]))


@njit()
def _pair_heights(
    xyz: NDArray[np.float64],
    lowest: NDArray[np.int64],
    doubtful: NDArray[np.bool_],
    node: int,
    cell: int,
    rows: int,
    columns: int,
    reach: int,
    height: NDArray[np.float64],
    firm: NDArray[np.int64],
) -> int:
    """Heights that opposite neighbours give at a node's position, and their firm ends; how many."""
    row, column = cell // columns, cell % columns
    pairs = 0
    for dr in range(reach + 1):
        for dc in range(-reach, reach + 1):
            if dr == 0 and dc <= 0:
                continue
            r0, r1, c0, c1 = row - dr, row + dr, column - dc, column + dc
            if r0 < 0 or r1 >= rows or min(c0, c1) < 0 or max(c0, c1) >= columns:
                continue
            a, b = lowest[r0 * columns + c0], lowest[r1 * columns + c1]
            if a < 0 or b < 0:
                continue
            ux, uy = xyz[b, 0] - xyz[a, 0], xyz[b, 1] - xyz[a, 1]
            length2 = ux * ux + uy * uy
            along = (xyz[node, 0] - xyz[a, 0]) * ux + (xyz[node, 1] - xyz[a, 1]) * uy
            height[pairs] = xyz[a, 2] + (along / length2) * (xyz[b, 2] - xyz[a, 2])
            firm[pairs] = 2 - int(doubtful[a]) - int(doubtful[b])
            pairs += 1
    return pairs


@njit()
def _below(height: NDArray[np.float64], firm: NDArray[np.int64], z: float, share: int) -> bool:
    """Whether most heights agree with each other above ``z`` and few with ``z``; sorts them.

    Far above, they need ``share`` firm ends for each pair, of two.
    """
    pairs = len(height)
    if pairs < _ENOUGH:
        return False
    # Heights of pairs agree within twice what a rough meadow scatters; within once of the node's
    # own height they speak for it. A pit is deeper than what one surface scatters.
    own = higher = 0
    for h in height:
        own += abs(h - z) <= ROUGH_M
        higher += h > z + DEPTH_M
    if higher < max(_ENOUGH, _OUTVOTE * own):
        return False
    for i in range(1, pairs):  # pairs are few
        h, f, k = height[i], firm[i], i
        while k > 0 and height[k - 1] > h:
            height[k], firm[k] = height[k - 1], firm[k - 1]
            k -= 1
        height[k], firm[k] = h, f
    end = ends = 0
    for first in range(pairs):
        low = height[first]
        while end < pairs and height[end] <= low + 2.0 * ROUGH_M:
            ends += firm[end]
            end += 1
        agreeing = end - first
        if agreeing >= max(_ENOUGH, _OUTVOTE * own) and low > z + DEPTH_M:
            near = low <= z + WALL_M and 2 * agreeing >= end
            if near or (2 * agreeing >= pairs and ends >= share * agreeing):
                return True
        ends -= firm[first]
    return False
