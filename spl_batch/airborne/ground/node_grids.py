"""Lowest nodes of grid cells, and the planes through those of nine cells.

Grids lie on the absolute lattice of their cell size; a cell names its node by number, or -1.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.scales import DAMPING_M2
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.nearest_cells import nearest_cells

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def lowest_nodes(xyz: Float, chosen: Mask, cell_m: float) -> Index:
    """Lowest of the chosen nodes in each cell of the absolute grid.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    chosen : (n,) bool
        Nodes to look at.
    cell_m : float
        Edge of a cell [m].

    Returns
    -------
    (rows, columns) int64
        Node of each cell of the box around *all* nodes; -1 where there is none.
    """
    frame = _frame(xyz, cell_m)
    found = np.full(frame[2:], -1, dtype=np.int64)
    _lowest(xyz, chosen, cell_m, frame[0], frame[1], found)
    return found


@njit()
def _lowest(
    xyz: Float, chosen: Mask, cell_m: float, left: int, bottom: int, out: Index
) -> None:  # fmt: skip
    """Lowest chosen node of each cell; of equal ones the first."""
    for i in range(len(chosen)):
        if chosen[i]:
            column = int(np.floor(xyz[i, 0] / cell_m)) - left
            row = int(np.floor(xyz[i, 1] / cell_m)) - bottom
            there = out[row, column]
            if there < 0 or xyz[i, 2] < xyz[there, 2]:
                out[row, column] = i


def _frame(xyz: Float, cell_m: float) -> tuple[int, int, int, int]:
    """First column and row of the grid around all nodes, and its rows and columns."""
    left, right, bottom, top = (
        int(np.floor(end / cell_m))
        for values in (xyz[:, 0], xyz[:, 1])
        for end in (values.min(), values.max())
    )
    return left, bottom, top - bottom + 1, right - left + 1


def nearest_node(grid: Index) -> Index:
    """A grid of nodes whose gaps have that of the nearest cell: walls stay steep.

    Parameters
    ----------
    grid : (rows, columns) int64
        A node for each cell, or -1; not everywhere.
    """
    found: Index = grid[nearest_cells(grid >= 0)]
    return found


def plane_heights(
    xyz: Float, asked: Index, grid: Index, cell_m: float, *, own: bool = True
) -> Float:
    """Height at some nodes of the plane through the grid's nodes in the nine cells around.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    asked : (m,) int64
        Nodes whose heights are asked for.
    grid : (rows, columns) int64
        A node for each cell, or -1, as :func:`lowest_nodes` finds them.
    cell_m : float
        Edge of a cell [m].
    own : bool
        Whether the node of the middle cell takes part.

    Returns
    -------
    (m,) float64
        Height [m]; NaN where none of the cells has a node.
    """
    left, bottom, _, _ = _frame(xyz, cell_m)
    out = np.empty(len(asked))
    _plane_heights(xyz, asked, grid, cell_m, left, bottom, own, out)
    return out


@njit()
def _plane_heights(
    xyz: Float,
    asked: Index,
    grid: Index,
    cell_m: float,
    left: int,
    bottom: int,
    own: bool,  # noqa: FBT001 - a kernel takes no keywords
    out: Float,
) -> None:
    rows, columns = grid.shape
    for k in range(len(asked)):
        i = asked[k]
        column = int(np.floor(xyz[i, 0] / cell_m)) - left
        row = int(np.floor(xyz[i, 1] / cell_m)) - bottom
        n, x, y, z = 0.0, 0.0, 0.0, 0.0
        xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                j = grid[r, c]
                if j < 0 or (not own and r == row and c == column):
                    continue
                dx, dy, dz = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
                n, x, y, z = n + 1.0, x + dx, y + dy, z + dz
                xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
                xz, yz = xz + dx * dz, yz + dy * dz
        if n == 0.0:
            out[k] = np.nan
            continue
        x, y, z = x / n, y / n, z / n
        xx, yy, xy = xx / n - x * x + DAMPING_M2, yy / n - y * y + DAMPING_M2, xy / n - x * y
        xz, yz = xz / n - x * z, yz / n - y * z
        scale = xx * yy - xy * xy
        east, north = (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale
        out[k] = xyz[i, 2] + z - east * x - north * y
