"""Raised land with sloping sides: dams, heaps and rocks that an opening takes for houses.

What an opening cuts off stands up steeply and is narrower than its window. A house does, a dam of
ten metres does. But a house ends in walls, on which hardly a return lies, so that from one cell to
the next its surface jumps. The sides of a dam hold returns at all heights, and neighbours there
differ by no more than a slope that loose ground and most rock keep to.

So what was cut off and hangs together by such slopes is looked at as a form. It is land where
nearly all of its outline goes down to the ground by them, too: decks and terraces have walls on two
sides, a roof that a bush or a stair leads up to has them nearly all around, and so has a part of a
roof that others stand above. Crowns do without walls; they are rough. A hipped or a conical roof
that comes down low does, too, as a wall of a metre or two is no steeper from cell to cell: but
along all of its outline it falls by a step to the ground, where a dam goes on as it was. Our own
rule: no source has one.

A dam goes on for kilometres, and may end at a bridge. So each block of 16 m is told by what lies
within three blocks around: what is farther off than a ground cell reads has no say.

Where many cells are empty walls look like slopes: nothing is told there.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.airborne.ground.multiscale.ranging_layer import BLOCK_M
from spl_batch.airborne.ground.node_grids import plane_heights
from spl_batch.numerics.compiled import njit

SLOPE: Final = 2.0
STEP_M: Final = 0.2
"""Neighbours hang together whose heights differ by no more than this slope, and this
[rise/run, m]."""

GENTLE: Final = 0.87
"""Share of the pairs of neighbours along the outline that hang together, at least. Walls within a
form count as well, but none that go up from it: a tree or a house may stand on land."""

EAVE_M: Final = 0.5
"""A form that falls to the ground by so much more than on its last cell, on the average, has eaves
all around: a low roof [m]."""

FILLED: Final = 0.7
"""Share of the cells in and around a form that hold a node, at least."""

HEIGHT_M: Final = 3.5
TOP: Final = 0.9
"""So high above the ground next to them stand the nodes above this share of a form, at least: of
sheds, hedges and lorries, which are lower, no slope tells the walls from a bank [m, 1]."""

LEAST: Final = 100
"""Fewer cells are no form [count]."""

AROUND: Final = 3
"""Blocks to each side whose part of a form tells of a block [count]."""

SMOOTH_M: Final = 0.5
SMOOTH: Final = 0.75
"""A node of a smooth cell is so near to the plane through those around; of the cells of a form this
share are smooth [m, 1]."""

_NONE: Final = -1
_GROUND: Final = -2
_SMALL: Final = -3
"""What a cell holds that is of no form: no node, ground, something small."""

_NEIGHBOURS: Final = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))

_MOST_M: Final = 5.0
"""Steps count as no more [m]."""

_HANGING, _PAIRS, _EMPTY, _ACROSS, _STEPS = range(5)
"""What is counted of a cell: its pairs with ground that hang together; these and all pairs that go
down and do not; neighbours that are empty; of those that hang together what has a cell without
ground on the other side, and their steps [cm]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def with_sloping_sides(xyz: Float, grid: Index, ground: Mask, cell_m: float) -> Mask:
    """Nodes of a grid on raised land that slopes down to the ground all around: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    grid : (rows, columns) int64
        A node for each cell, or -1.
    ground : (n,) bool
        Nodes of the ground.
    cell_m : float
        Edge of a cell [m].
    """
    found = np.zeros(len(xyz), dtype=np.bool_)
    form = np.where(grid < 0, _NONE, np.where(ground[grid], _GROUND, 0))
    facts = np.zeros((*grid.shape, 5), np.int16)
    if not _forms(xyz, grid, form, facts):
        return found
    nodes, number = grid[form > 0], form[form > 0]
    hanging, pairs, empty, across, steps, cells = _around(xyz[nodes], number, facts[form > 0])
    likely = (hanging > 0) & (hanging >= GENTLE * pairs) & (cells >= LEAST)
    likely &= steps < 100.0 * EAVE_M * across
    likely &= empty <= (1.0 - FILLED) * len(_NEIGHBOURS) * cells
    asked = np.isin(number, number[likely])
    if not asked.any():
        return found
    nodes, number = nodes[asked], number[asked]
    off = xyz[nodes, 2] - plane_heights(xyz, nodes, grid, cell_m, own=False)
    told = np.column_stack([np.abs(off) <= SMOOTH_M, _above(xyz, nodes, ground) >= HEIGHT_M])
    smooth, high, cells = _around(xyz[nodes], number, told)
    stands = (smooth >= SMOOTH * cells) & (high >= (1.0 - TOP) * cells)
    found[nodes[likely[asked] & stands]] = True
    return found


def _around(places: Float, number: Index, counts: NDArray[np.generic]) -> Float:
    """Sums over what is of the same form in the blocks around that of each node: (k + 1, n).

    ``places``: (n, 3) float64 [m]; ``number``: (n,) int64, its form; ``counts``: (n, k), what is
    summed, and the nodes themselves.
    """
    block = np.floor(places[:, :2] / BLOCK_M).astype(np.int64)
    block += AROUND - block.min(axis=0, initial=1 << 40)
    width, height = block.max(axis=0, initial=0) + AROUND + 1
    key = (number * height + block[:, 1]) * width + block[:, 0]
    keys, of = np.unique(key, return_inverse=True)
    each = [np.bincount(of, column, len(keys)) for column in counts.T]
    sums = np.stack([*each, np.bincount(of, minlength=len(keys))])
    total = np.zeros_like(sums)
    for row in range(-AROUND, AROUND + 1):
        for column in range(-AROUND, AROUND + 1):
            there = keys + row * width + column
            at = np.minimum(np.searchsorted(keys, there), max(len(keys) - 1, 0))
            total += np.where(keys[at] == there, sums[:, at], 0.0)
    return total[:, of]


def _above(xyz: Float, nodes: Index, ground: Mask) -> Float:
    """Height of some nodes above the ground that is next to each [m]."""
    land = xyz[ground]
    nearest = cKDTree(land[:, :2]).query(xyz[nodes, :2])[1]
    above: Float = xyz[nodes, 2] - land[nearest, 2]
    return above


@njit()
def _forms(xyz: Float, grid: Index, form: Index, facts: NDArray[np.int16]) -> int:
    """Number what hangs together of cells that are no ground, from 1 on; how many there are."""
    rows, columns = grid.shape
    queue = np.empty(grid.size, np.int64)
    number = 0
    for first in range(rows * columns):
        if form[first // columns, first % columns] != 0:
            continue
        number += 1
        queue[0], held, done = first, 1, 0
        form[first // columns, first % columns] = number
        while done < held:
            held = _look_around(xyz, grid, form, queue, held, queue[done], facts)
            done += 1
        if held < LEAST:
            for k in range(held):
                form[queue[k] // columns, queue[k] % columns] = _SMALL
            number -= 1
    return number


@njit()
def _look_around(
    xyz: Float, grid: Index, form: Index, queue: Index, held: int, at: int,
    facts: NDArray[np.int16],
) -> int:  # fmt: skip
    """Put what hangs together with a cell into the queue, and count its outline."""
    rows, columns = grid.shape
    row, column = at // columns, at % columns
    i, number = grid[row, column], form[row, column]
    for up, right in _NEIGHBOURS:
        r, c = row + up, column + right
        if not (0 <= r < rows and 0 <= c < columns):
            continue
        if form[r, c] == _NONE:
            facts[row, column, _EMPTY] += 1
            continue
        j = grid[r, c]
        east, north = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1]
        most = STEP_M + SLOPE * np.sqrt(east * east + north * north)
        hangs = abs(xyz[j, 2] - xyz[i, 2]) <= most
        if form[r, c] == _GROUND:
            facts[row, column, _HANGING] += hangs
            if hangs:
                _add_step(xyz, grid, form, (row, column), (up, right), facts)
        elif hangs:
            if form[r, c] == 0:
                form[r, c] = number
                queue[held] = r * columns + c
                held += 1
            continue
        facts[row, column, _PAIRS] += hangs or xyz[j, 2] < xyz[i, 2]
    return held


@njit()
def _add_step(
    xyz: Float, grid: Index, form: Index, at: tuple[int, int], way: tuple[int, int],
    facts: NDArray[np.int16],
) -> None:  # fmt: skip
    """Add by how much more a form falls to the ground on the way than it does on its last cell."""
    rows, columns = grid.shape
    r, c = at[0] - way[0], at[1] - way[1]
    if not (0 <= r < rows and 0 <= c < columns) or form[r, c] == _NONE or form[r, c] == _GROUND:
        return
    inner, edge = xyz[grid[r, c], 2], xyz[grid[at], 2]
    step = 2.0 * edge - inner - xyz[grid[at[0] + way[0], at[1] + way[1]], 2]
    facts[at[0], at[1], _ACROSS] += 1
    facts[at[0], at[1], _STEPS] += round(100.0 * min(max(step, -_MOST_M), _MOST_M))
