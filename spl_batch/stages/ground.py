"""Ground points of one fixed absolute cell with its buffer: PTD or SMRF.

Domain: space. A TIN has no bounded reach, so the stage never sees a tile or block:
it runs on squares of ``ground.cell_m`` on the absolute grid with ``ground.buffer_m`` of
points around them, always the same ones, and its caller keeps what the square owns.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.constants import QUANTUM_M
from spl_batch.kernels.layers import Cells, Nodes, count_support, group_by_cell, lowest_layers
from spl_batch.kernels.ptd import Limits, densify, heights_above
from spl_batch.kernels.smrf import fill_gaps, low_outliers, object_cells, provisional_terrain
from spl_batch.model import PointTable
from spl_batch.workflow import GroundSettings, PtdSettings, SmrfSettings

DOMAIN: Final = "space"
BYTES_PER_POINT: Final = 160
"""Peak of temporary arrays for each point of cell and buffer [bytes]."""

NEEDS: Final = ("x", "y", "z")
ADDS: Final = ("ground",)

_INSERT_M = 0.05
"""Nearer candidates leave the surface as it is: a third of the ranging noise of one
point, and more than that of a layer's mean [m]."""

_FILLED = 2.0
"""Points in an occupied cell below which the candidates' grid is doubled [count]."""

_WIDE_M = 16.0
"""Cells that tell the occupied area from voids [m]."""

_SUPPORT = 2
_SUPPORT_STEP_M = 0.25
_SUPPORT_SLOPE = 0.35
"""A node is believed below the surface, and as a seed, with two nodes within two cells
that continue it; on a slope of any steepness those along the contour do."""

Float = NDArray[np.float64]


def ground_mask(
    table: PointTable, usable: NDArray[np.bool_], settings: GroundSettings
) -> NDArray[np.bool_]:
    """Which points are ground.

    Parameters
    ----------
    table : PointTable
        Points of one ground cell and its buffer, in canonical order.
    usable : (n,) bool
        Points to look at: signal, not withheld.
    settings : GroundSettings
        Method and parameters.

    Returns
    -------
    (n,) bool
        True for ground; False wherever a point is not usable.
    """
    mask = np.zeros(len(table), dtype=np.bool_)
    chosen = np.flatnonzero(usable)
    if len(chosen) == 0:
        return mask
    x, y, z = (table[name][chosen] * QUANTUM_M for name in ("x", "y", "z"))
    if settings.method == "smrf":
        mask[chosen] = smrf_mask(x, y, z, settings.smrf)
    else:
        mask[chosen] = ptd_mask(x, y, z, settings.ptd)
    return mask


def ptd_mask(x: Float, y: Float, z: Float, settings: PtdSettings) -> NDArray[np.bool_]:
    """Ground points by progressive TIN densification.

    Seeds are the lowest nodes that survive a progressive opening, so that neither a wide
    hall nor an embankment needs a seed grid of its own size; the source's iteration
    parameters then take in what the opening cut off. Points are ground in a band on both
    sides of the surface, so that their mean is not biased low; the band widens with the
    facets, over which the surface is known less well.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m], on the absolute lattice; n > 0.
    settings : PtdSettings
        Parameters.

    Returns
    -------
    (n,) bool
    """
    cell_m = node_cell(x, y, settings.node_m)
    cells = group_by_cell(x, y, cell_m)
    nodes = lowest_layers(x, y, z, cells, settings.layer_m)
    trusted = _supported(nodes, cells, cell_m) & ~nodes.doubtful
    eligible = trusted & ~_on_objects(nodes, trusted, cells, cell_m, settings)
    seed = _seeds(nodes.xyz, _first_true((eligible, trusted)), settings.seed_cell_m)
    others = np.flatnonzero(~seed)
    tin, _ = densify(
        nodes.xyz[seed],
        nodes.xyz[others],
        np.where(trusted[others], -np.inf, -settings.band_m),
        _limits(settings),
        settings.seed_cell_m,
    )
    mask = np.zeros(len(x), dtype=np.bool_)
    if tin is None:
        return mask
    order = cells.order
    height, edge = heights_above(tin, x[order], y[order], z[order])
    allowed = settings.band_m + np.tan(np.radians(settings.iteration_angle_deg)) * edge
    mask[order] = np.abs(height) <= np.minimum(allowed, settings.iteration_distance_m)
    return mask


def _limits(settings: PtdSettings) -> Limits:
    return Limits(
        float(np.tan(np.radians(settings.terrain_angle_deg))),
        float(np.sin(np.radians(settings.iteration_angle_deg))),
        settings.iteration_distance_m,
        settings.spread_m,
        _INSERT_M,
    )


def _first_true(choices: tuple[NDArray[np.bool_], ...]) -> NDArray[np.bool_]:
    """The first selection that selects anything, or everything."""
    for choice in choices:
        if choice.any():
            return choice
    return np.ones_like(choices[0])


def node_cell(x: Float, y: Float, smallest_m: float) -> float:
    """Edge of the candidates' grid: doubled for sparse data.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m]; n > 0.
    smallest_m : float
        Edge for dense data [m].
    """
    area_m2 = _WIDE_M**2 * _occupied(x, y, _WIDE_M)
    return smallest_m * (1 if len(x) * smallest_m**2 >= _FILLED * area_m2 else 2)


def _occupied(x: Float, y: Float, cell_m: float) -> int:
    column, row = np.floor(x / cell_m), np.floor(y / cell_m)
    column -= column.min()
    row -= row.min()
    return len(np.unique(row * (column.max() + 1) + column))


def _supported(nodes: Nodes, cells: Cells, cell_m: float) -> NDArray[np.bool_]:
    support = np.empty(len(nodes.cell), dtype=np.int64)
    count_support(
        nodes.xyz,
        nodes.cell,
        cells.rows,
        cells.columns,
        2,
        2 * cell_m,
        _SUPPORT_STEP_M,
        _SUPPORT_SLOPE,
        support,
    )
    return support >= _SUPPORT


def _on_objects(
    nodes: Nodes,
    trusted: NDArray[np.bool_],
    cells: Cells,
    cell_m: float,
    settings: PtdSettings,
) -> NDArray[np.bool_]:
    """Nodes that no seed may be taken from: in pits, or cut off by opening."""
    lowest = _lowest_grid(nodes, trusted, cells)
    if np.isnan(lowest).all():
        return np.zeros(len(trusted), dtype=np.bool_)
    surface = fill_gaps(lowest)
    raised = low_outliers(surface, cell_m)
    raised |= object_cells(
        surface, cell_m, settings.seed_slope, settings.object_m / 2, step_m=settings.seed_step_m
    )
    on_objects: NDArray[np.bool_] = raised.ravel()[nodes.cell]
    return on_objects


def _lowest_grid(nodes: Nodes, trusted: NDArray[np.bool_], cells: Cells) -> Float:
    """Height of the lowest trusted node of each cell; NaN where there is none."""
    height = np.full(cells.rows * cells.columns, np.nan)
    believed = np.flatnonzero(trusted)[::-1]  # the lower node of a cell comes last and stays
    height[nodes.cell[believed]] = nodes.xyz[believed, 2]
    return height.reshape(cells.rows, cells.columns)


def _seeds(xyz: Float, eligible: NDArray[np.bool_], seed_cell_m: float) -> NDArray[np.bool_]:
    """Lowest eligible node of each square of the seed grid."""
    places = np.flatnonzero(eligible)
    cells = group_by_cell(xyz[places, 0], xyz[places, 1], seed_cell_m)
    by_height = np.lexsort([xyz[places, 2], _cell_of(cells)])
    seed = np.zeros(len(xyz), dtype=np.bool_)
    first = cells.start[:-1][np.diff(cells.start) > 0]
    seed[places[by_height[first]]] = True
    return seed


def _cell_of(cells: Cells) -> NDArray[np.int64]:
    """Cell of each point."""
    cell = np.empty(len(cells.order), dtype=np.int64)
    cell[cells.order] = np.repeat(np.arange(len(cells.start) - 1), np.diff(cells.start))
    return cell


def smrf_mask(x: Float, y: Float, z: Float, settings: SmrfSettings) -> NDArray[np.bool_]:
    """Ground points by the simple morphological filter.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m], on the absolute lattice; n > 0.
    settings : SmrfSettings
        Parameters.

    Returns
    -------
    (n,) bool
    """
    cells = group_by_cell(x, y, settings.cell_m)
    nodes = lowest_layers(x, y, z, cells, settings.layer_m)
    trusted = _first_true((~nodes.doubtful,))
    lowest = _lowest_grid(nodes, trusted, cells)
    terrain = provisional_terrain(lowest, settings.cell_m, settings.slope, settings.window_m)
    column = x / settings.cell_m - np.floor(x.min() / settings.cell_m) - 0.5
    row = y / settings.cell_m - np.floor(y.min() / settings.cell_m) - 0.5
    steepness = _steepness(terrain, settings.cell_m)
    surface = ndimage.map_coordinates(terrain, [row, column], order=1, mode="nearest")
    slope = ndimage.map_coordinates(steepness, [row, column], order=1, mode="nearest")
    mask: NDArray[np.bool_] = np.abs(z - surface) <= settings.threshold_m + settings.scalar * slope
    return mask


def _steepness(terrain: Float, cell_m: float) -> Float:
    """Steepest rise of a grid [rise/run]; zero along an axis of one cell."""
    squared = np.zeros_like(terrain)
    for axis in (0, 1):
        if terrain.shape[axis] > 1:
            squared += np.gradient(terrain, cell_m, axis=axis) ** 2
    return np.sqrt(squared)
