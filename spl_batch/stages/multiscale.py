"""Ground points by a surface whose scale follows the data.

Domain: space. See :mod:`spl_batch.kernels.multiscale`. There is nothing to set: cell sizes, the
tolerance around the surface and its growth on slopes follow from the spacing of the points and
from how much the ground scatters.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.kernels.grouping import group_by_cell
from spl_batch.kernels.layers import lowest_layers
from spl_batch.kernels.multiscale import (
    BLOCK_M,
    CELL_M,
    agreeing_nodes,
    ground_nodes,
    low_outliers,
    lowest_nodes,
    scatter_below,
    terrain,
)
from spl_batch.stages.seeds import sunk

_LAYER_M = 0.15
"""Thickness of the layer whose mean is a node: three standard deviations of a range [m]."""

_BAND_M: Final = (0.1, 0.5)
"""Least and largest distance from the surface of a ground point, where that is level [m]."""

_BAND_SIGMA = 3.0
"""So many scatters of the ground."""

_BAND_SPACINGS = 0.25
"""So many spacings of the points: between them the ground is not known better."""

_SLOPE_M = 1.25
"""The band grows with the slope by the spacing of the points, and this at most [m], which is what
the source adds at any spacing."""

Float = NDArray[np.float64]
Place = tuple[Float, Float, Float]


def multiscale_mask(own: Place, asked: Place) -> NDArray[np.bool_]:
    """Ground points by a surface whose scale follows the data.

    Parameters
    ----------
    own : three (n,) float64
        Evidence: x, y, z [m]; at least one point.
    asked : three (m,) float64
        Points to be told; at least one.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    xyz = _nodes(*own)
    chosen = agreeing_nodes(xyz, ~low_outliers(xyz))
    ground = ground_nodes(xyz, chosen)
    surface = terrain(xyz, ground)
    grid = lowest_nodes(xyz, ground, CELL_M)
    scatter = scatter_below(xyz, np.sort(grid[grid >= 0]), grid, CELL_M)
    x, y, z = asked
    corner = np.floor(xyz[:, :2].min(axis=0) / CELL_M)
    at = [y / CELL_M - corner[1] - 0.5, x / CELL_M - corner[0] - 0.5]
    height = ndimage.map_coordinates(surface, at, order=1, mode="nearest")
    slope = ndimage.map_coordinates(_steepness(surface), at, order=1, mode="nearest")
    found: NDArray[np.bool_] = np.abs(z - height) <= _band(own, asked, xyz, scatter, slope)
    return found


def _nodes(x: Float, y: Float, z: Float) -> Float:
    """Lowest layers of cells that are not below a hard surface: (n, 3) [m]."""
    cells = group_by_cell(x, y, CELL_M)
    nodes = lowest_layers(x, y, z, cells, _LAYER_M)
    above = ~sunk(nodes, cells, CELL_M)
    return nodes.xyz[above] if above.any() else nodes.xyz


def _band(own: Place, asked: Place, xyz: Float, scatter: Float, slope: Float) -> Float:
    """Distance from the surface up to which each point is ground [m]."""
    from spl_batch.stages.ground import spacing_around_m

    spacing = spacing_around_m(own[0], own[1], asked[0], asked[1])
    corner = np.floor(xyz[:, :2].min(axis=0) / BLOCK_M)
    rows, columns = scatter.shape
    row = np.clip(np.floor(asked[1] / BLOCK_M) - corner[1], 0, rows - 1).astype(np.int64)
    column = np.clip(np.floor(asked[0] / BLOCK_M) - corner[0], 0, columns - 1).astype(np.int64)
    level = np.maximum(_BAND_SIGMA * scatter[row, column], _BAND_SPACINGS * spacing)
    band: Float = np.clip(level, *_BAND_M) + np.minimum(spacing, _SLOPE_M) * slope
    return band


def _steepness(surface: Float) -> Float:
    """Steepest rise of a grid [rise/run]; zero along an axis of one cell."""
    squared = np.zeros_like(surface)
    for axis in (0, 1):
        if surface.shape[axis] > 1:
            squared += np.gradient(surface, CELL_M, axis=axis) ** 2
    return np.sqrt(squared)
