"""Lone returns below level ground that few returns show, as still dark water is.

A photon counter hears sunlight all along the gate. Where a surface returns much light what is heard
below it is alone and told from it; dark water returns so little that single photons are all that
there is, of the water and of the sunlight below it. None of them can be told by itself, and the
lowest of a cell is one of the sunlight as often as not. But the water is level and most of what is
there lies at its height. What lies far below is scattered over all depths: no other return
continues it, as the bottom of a pit or a ditch does. Our own rule: no source has one.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.node_grids import cells_of, lowest_nodes
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import sort

CELL_M: Final = 1.0
"""Cells whose lowest ground nodes are looked at [m]."""

REACHES: Final = (4, 8)
"""So many of these cells on each side, one reach after the other [count]."""

FEWEST: Final = 6
"""Fewer nodes tell no level [count]."""

LEVEL_M: Final = 0.2
"""Half of the nodes around lie within this of their median, and most of these are of lone returns:
waves, and the spread of ranges [m]."""

DEPTH_M: Final = 0.4
"""What is told lies deeper below the median [m]."""

BESIDE_M: Final = 0.3
BESIDE: Final = 3
"""Ground goes on where so many others within the first reach are as low within this [m, count]."""

_ROUNDS: Final = 4
"""So often all are asked, without what was found: several beside each other hide the level."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def below_level(xyz: Float, ground: Mask, lone: Mask) -> Mask:
    """Ground nodes of lone returns far below level ground: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    ground : (n,) bool
        Those of the ground.
    lone : (n,) bool
        Nodes of one or two returns: those that are judged.
    """
    found = np.zeros(len(xyz), dtype=np.bool_)
    all_of_it = lowest_nodes(xyz, ground, CELL_M)
    for reach in REACHES:
        for _ in range(_ROUNDS):
            asked = np.flatnonzero(ground & lone & ~found)
            below = np.zeros(len(asked), dtype=np.bool_)
            at = cells_of(xyz, asked, CELL_M)
            grid = lowest_nodes(xyz, ground & ~found, CELL_M)
            _far_below(xyz[:, 2], lone, asked, at, grid, all_of_it, reach, below)
            if not below.any():
                break
            found[asked[below]] = True
    return found


@njit()
def _far_below(
    z: Float,
    lone: Mask,
    asked: Index,
    at: Index,
    grid: Index,
    all_of_it: Index,
    reach: int,
    out: Mask,
) -> None:
    """Fill with nodes far below the level of the grid's others; ``at``: their row, column."""
    most = (2 * reach + 1) ** 2
    near, room = np.empty(most, dtype=np.int64), np.empty(most)
    for k in range(len(asked)):
        i, (row, column) = asked[k], at[k]
        n = _around(grid, i, row, column, reach, near)
        out[k] = n >= FEWEST and _is_below_most(z, lone, i, near[:n], room[:n])
        if out[k]:
            n = _around(all_of_it, i, row, column, REACHES[0], near)
            beside = 0
            for j in near[:n]:
                beside += abs(z[j] - z[i]) <= BESIDE_M
            out[k] = beside < BESIDE


@njit()
def _is_below_most(z: Float, lone: Mask, own: int, near: Index, room: Float) -> bool:
    """Whether a node lies far below the level of others, most of which are lone as well."""
    for k, j in enumerate(near):
        room[k] = z[j]
    sort(room)
    median = room[len(room) // 2]
    if z[own] >= median - DEPTH_M:
        return False
    level = alone = 0
    for j in near:
        if abs(z[j] - median) <= LEVEL_M:
            level += 1
            alone += lone[j]
    return 2 * level >= len(near) and 2 * alone > level


@njit()
def _around(grid: Index, own: int, row: int, column: int, reach: int, out: Index) -> int:
    """A grid's nodes around a cell, without one; how many."""
    n = 0
    for r in range(max(row - reach, 0), min(row + reach + 1, grid.shape[0])):
        for c in range(max(column - reach, 0), min(column + reach + 1, grid.shape[1])):
            if grid[r, c] >= 0 and grid[r, c] != own:
                out[n] = grid[r, c]
                n += 1
    return n
