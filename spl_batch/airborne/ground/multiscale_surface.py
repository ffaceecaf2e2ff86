"""Ground surface from nodes whose scale follows the data, by progressive opening.

Progressive morphological opening [Zhang et al. 2003; Pingel, Clarke & McBride 2013] separates
objects from terrain by how far a surface of lowest heights falls when a window grows. It needs a
surface of lowest heights that are mostly ground, and it needs the edges of objects. Both fail on
real surveys with one cell size for all: under trees the lowest return of a metre is a leaf, and at
one return per four square metres a surface that is interpolated across empty cells turns walls into
ramps.

Deviations from the sources:

- **The cell follows the data.** In each block of 16 m the nodes are the lowest of cells
  of 1, 2, 4 or 8 m: the smallest in which most lowest nodes agree with the lowest of the next
  size (:func:`agreeing_nodes`). The opening always runs on cells of 1 m.
- **Empty cells take the nearest node**, so that a wall stays as steep as it is.
- **A fall of more than** :data:`WALL_M` from one window to the next is an object's at any radius.
- **Low outliers** are found among the lowest nodes of :data:`WIDE_M`: a node far below the third
  lowest around is none of the ground's, also where several lie beside each other.
- **What counts as on the surface** follows from the spacing of the points, and from what ground
  nodes scatter *below* the surface (:func:`spread_below`): vegetation scatters them upwards only.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from spl_batch.airborne.ground.lowest_layers import ENDS, SUPPORTED
from spl_batch.airborne.ground.morphology import object_cells
from spl_batch.airborne.ground.node_grids import lowest_nodes, plane_heights
from spl_batch.airborne.ground.point_spacing import Blocks, no_counts, quantiles
from spl_batch.airborne.ground.scales import (
    BLOCK_M,
    CELL_M,
    DEPTH_M,
    LEVELS,
    SIGMA_M,
    WALL_M,
    WIDE_M,
    WINDOW_M,
)
from spl_batch.numerics.compiled import njit

_AGREE_M = WALL_M / 2
_AGREE_SIGMA = 2.0
"""A node is higher than the coarser ones by more than so many of their spreads, at most this much
[m]: with 3 heath is 2.4 cm higher; without the most, eucalypt forest 17 cm."""

_HIGH_SHARE = (0.3, 0.35)
"""With more such nodes than this share a block takes the coarser cell: where most nodes are means
of well-filled layers, and where they are single points. With .3 for both ISPRS 11 loses 7 points,
with .35 heath is 2.1 cm higher."""

ABOVE_SIGMA: Final = 2.5
"""Ground reaches above a surface by so many spreads of most points below it, as plants stand
there: with 3, heath is 0.6 cm higher and Amsterdam loses 0.3 points."""

_SLOPE = 0.15
"""Slope tolerance of the opening, as published [rise/run]."""

_PIT_M = 3 * WIDE_M / 2
"""A low outlier lies below the third lowest of the eight cells around, so many as make a layer, by
more than the nine cells reach to a side, as below a slope of 45 degrees [m]."""

_DEPTH_M = SIGMA_M / 5
_DEPTHS = round(2 * DEPTH_M / _DEPTH_M)
"""Depths below a surface are counted by steps of this, finer than ranges scatter, so many, and one
for all deeper ones [m]."""

EVERYWHERE: Final = Blocks(np.full((1, 1), SIGMA_M), (0, 0))
"""Ranging spread where flightlines have none [m]."""

BARE: Final = 0.5
"""Share of the ranging spread that bare cells of real surveys scatter by: a layer of ground that
does not end within the whole spread, as in grass, is as thick as this gives."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def _places(xyz: Float, cell_m: float) -> tuple[Index, Index, tuple[int, int]]:
    """Column and row of each node's cell, and the shape of the grid around all."""
    column, row = np.floor(xyz[:, :2] / cell_m).astype(np.int64).T
    column, row = column - column.min(), row - row.min()
    return column, row, (int(row.max()) + 1, int(column.max()) + 1)


def _heights(found: Index, z: Float) -> Float:
    """Heights of a grid of nodes; NaN without one."""
    return np.where(found >= 0, z[found], np.nan)


def low_outliers(xyz: Float) -> Mask:
    """Nodes far below those around: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    """
    column, row, _ = _places(xyz, WIDE_M)
    lowest = lowest_nodes(xyz, np.ones(len(xyz), np.bool_), WIDE_M)
    height = _heights(lowest, xyz[:, 2])
    around = _neighbours(np.where(np.isnan(height), np.inf, height))
    around.partition(SUPPORTED - 1, axis=0)
    floor = around[SUPPORTED - 1] - _PIT_M
    floor[np.isinf(floor)] = -np.inf
    found: Mask = xyz[:, 2] < floor[row, column]
    return found


def _neighbours(grid: Float) -> Float:
    """Values of the eight cells around each: (8, rows, columns); inf beyond the edge."""
    rows, columns = grid.shape
    wide = np.pad(grid, 1, constant_values=np.inf)
    steps = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return np.stack([wide[i : i + rows, j : j + columns] for i, j in steps])


def agreeing_nodes(
    xyz: Float, usable: Mask, filled: Mask, sigma: Blocks = EVERYWHERE, cell_m: float = CELL_M
) -> tuple[Mask, Mask]:
    """Nodes of the scale that the data have, block by block, and which of them stand out.

    Starting with all nodes, a block goes on to the lowest nodes of cells twice as large while
    more than a third of its nodes stand above the plane through the coarser ones around.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m], at most a few in a cell.
    usable : (n,) bool
        Nodes that may be chosen.
    filled : (n,) bool
        Nodes that are means of layers.
    sigma : Blocks
        Standard deviation of a range [m].
    cell_m : float
        Edge of the smallest cells [m].

    Returns
    -------
    chosen : (n,) bool
        Nodes of the surface.
    high : (n,) bool
        Those in blocks of layers that stand above the coarser ones and are none of them: what
        grows in a cell.
    """
    column, row, shape = _places(xyz, BLOCK_M)
    west, south = np.floor(xyz[:, :2].min(axis=0) / BLOCK_M).astype(int).tolist()
    sigma_m = BARE * sigma.over((south, west), shape)
    going = np.ones(shape, dtype=np.bool_)
    first = lowest_nodes(xyz, usable, cell_m)
    current = np.sort(first[first >= 0])
    chosen, high = np.zeros((2, len(xyz)), dtype=np.bool_)
    for level in range(1, LEVELS + 1):
        edge_m = 2.0**level * cell_m
        grid = lowest_nodes(xyz, usable, edge_m)
        coarser = np.sort(grid[grid >= 0])
        at = row[current], column[current]
        count, layers = (_in_blocks(at, of, shape) for of in (slice(None), filled[current]))
        thick = 2.0 * layers >= count
        most = np.where(thick, *_HIGH_SHARE)
        spread = np.maximum(scatter_below(xyz, coarser, grid, edge_m), sigma_m)
        above = xyz[current, 2] - plane_heights(xyz, current, grid, edge_m)
        disagree = above > np.minimum(_AGREE_SIGMA * spread, _AGREE_M)[at]
        share = _in_blocks(at, disagree, shape) / np.maximum(count, 1.0)
        stays = going & (share <= most)
        chosen[current[stays[at]]] = True
        grown = above > np.minimum(ABOVE_SIGMA * spread, _AGREE_M)[at]
        high[current[grown & (stays & thick)[at]]] = True
        high[coarser] = False
        going &= ~stays
        current = coarser
    chosen[current[going[row[current], column[current]]]] = True
    return chosen, high


def _in_blocks(at: tuple[Index, Index], some: Mask | slice, shape: tuple[int, int]) -> Float:
    """How many of some nodes are in each block and those around."""
    row, column = (along[some] for along in at)
    counted = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1])
    return _around(counted.reshape(shape))


def _around(grid: NDArray[Any]) -> Float:
    """Sum over a cell and the eight around it, along the first axes; whole numbers add up."""
    box = np.ones((3, 3) + (1,) * (grid.ndim - 2))
    summed: Float = ndimage.correlate(grid.astype(np.float64), box, mode="constant")
    return summed


def depths_below(off: Float, x: Float, y: Float, frame: Blocks | None = None) -> Blocks:
    """Points below the surface by blocks and depth.

    Parameters
    ----------
    off : (n,) float64
        Heights above the surface [m].
    x, y : (n,) float64
        Positions [m]; n > 0.
    frame : Blocks, optional
        Counts to add to, by default none yet of all blocks around the points.
    """
    if frame is None:
        frame = no_depths(x, y)
    _count_depths(off, np.ascontiguousarray(x), np.ascontiguousarray(y), *frame)
    return frame


def no_depths(x: Float, y: Float) -> Blocks:
    """None yet, for all blocks around n > 0 points."""
    return no_counts(x, y, _DEPTHS + 1)


@njit()
def _count_depths(off: Float, x: Float, y: Float, out: Index, first: tuple[int, int]) -> None:
    """Add the points below by row, column and depth."""
    for i in range(len(off)):
        if off[i] < 0.0:
            depth = int(min(-off[i] / _DEPTH_M, float(_DEPTHS)))
            row, column = int(np.floor(y[i] / BLOCK_M)), int(np.floor(x[i] / BLOCK_M))
            out[row - first[0], column - first[1], depth] += 1


def ends_within(heights: Blocks, reach_m: Float) -> Mask:
    """Whether the layer of ground ends within a reach, as rough soil does and grass does not.

    Parameters
    ----------
    heights : Blocks
        Points above the surface, by :func:`depths_below` of what they are above it.
    reach_m : (block rows, block columns) float64
        Thickness of the layer [m].

    Returns
    -------
    (block rows, block columns) bool
        Whether a layer as thick above it holds at most :data:`.ENDS` of its points; never where
        both reach beyond what is counted.
    """
    counted = np.cumsum(_around(heights.values), axis=-1)
    steps = np.rint(reach_m / _DEPTH_M).astype(np.int64)
    once, twice = (
        np.take_along_axis(counted, np.clip(k * steps - 1, 0, _DEPTHS)[..., None], -1)[..., 0]
        for k in (1, 2)
    )
    ends: Mask = (twice - once <= ENDS * once) & (2 * steps <= _DEPTHS)
    return ends


def noise_below(depths: Blocks) -> Blocks:
    """The same without points so deep that they are noise."""
    return depths._replace(values=depths.values[..., :_DEPTHS])


def spread_below(depths: Blocks, share: float = 0.5) -> Float:
    """Standard deviation of a surface's points, by the depth that a share of those below reach.

    Ranging noise and rough ground scatter points to both sides of the surface, plants only upwards:
    the lower side shows the spread of the ground. The median depth gives that of most points, a
    larger share that of the tail.

    Parameters
    ----------
    depths : Blocks
        Points below the surface, by :func:`depths_below`.
    share : float
        Share of them, by default a half: the median depth.

    Returns
    -------
    (block rows, block columns) float64
        For each block, of it and those around; 0 without points below [m].
    """
    depth = _DEPTH_M * quantiles(_around(depths.values), share)
    spread: Float = depth / (np.sqrt(2.0) * special.erfinv(share))
    return spread


def scatter_below(xyz: Float, nodes: Index, grid: Index, cell_m: float) -> Float:
    """Spread of nodes below the planes through those around, by blocks.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    nodes : (m,) int64
        Those of the grid.
    grid : (rows, columns) int64
        A node for each cell, or -1.
    cell_m : float
        Edge of a cell [m].

    Returns
    -------
    (block rows, block columns) float64
        Standard deviation in each block of :data:`BLOCK_M`, of it and those around [m].
    """
    off = np.zeros(len(xyz))
    off[nodes] = xyz[nodes, 2] - plane_heights(xyz, nodes, grid, cell_m, own=False)
    return spread_below(depths_below(off, xyz[:, 0], xyz[:, 1]))


def ground_nodes(xyz: Float, high: Mask, grid: Index, nearest: Index) -> Mask:
    """Chosen nodes that are on no object: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    high : (n,) bool
        Nodes that stand out by themselves.
    grid, nearest : (rows, columns) int64
        Those that the surface is made of, by cells of :data:`CELL_M`, or -1, and that of the
        nearest cell with one.
    """
    raised = object_cells(xyz[nearest, 2], CELL_M, _SLOPE, WINDOW_M, step_m=WALL_M)
    ground = np.zeros(len(xyz), dtype=np.bool_)
    ground[grid[(grid >= 0) & ~raised & ~high[grid]]] = True  # the lowest node is one
    return ground
