"""Ground points of one fixed absolute cell with its buffer: PTD or SMRF.

Domain: space. A TIN has no bounded reach, so the stage never sees a tile or block:
it runs on squares of ``ground.cell_m`` on the absolute grid with ``ground.buffer_m`` of
points around them, always the same ones, and its caller keeps what the square owns.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.constants import QUANTUM_M
from spl_batch.kernels.grouping import Cells, chosen_places, group_by_cell
from spl_batch.kernels.layers import (
    SUPPORTED,
    Nodes,
    count_below,
    count_squares,
    count_support,
    lowest_layers,
)
from spl_batch.kernels.pits import REACH_M, in_pits
from spl_batch.kernels.ptd import Limits, densify, heights_above
from spl_batch.kernels.smrf import fill_gaps, low_outliers, object_cells, provisional_terrain
from spl_batch.model import PointTable
from spl_batch.settings import GroundSettings, PtdSettings, SmrfSettings
from spl_batch.stages.followers import dependents

DOMAIN: Final = "space"
COLUMNS_NEEDED: Final = ("x", "y", "z")
"""And ``afterpulse`` where the time domain ran."""

COLUMNS_ADDED: Final = ("ground",)

_INSERT_M = 0.05
"""Nearer candidates leave the surface as it is: a third of the ranging noise of one
point, and more than that of a layer's mean [m]."""

_FILLED = 2.0
"""Points in an occupied cell below which the candidates' grid is doubled [count]."""

_WIDE_M = 16.0
"""Cells that tell the occupied area from voids [m]."""

_GAP_SPACINGS = 10.0
"""Edges longer than this many mean spacings of the points around cross a gap of the ground
[count]."""

_REACH = 2
"""Cells around a node in which others speak for it or against it [count]."""

_SUPPORT = 2
_SUPPORT_STEP_M = 0.25
_SUPPORT_SLOPE = 0.35
"""A node is believed below the surface, and as a seed, with two nodes around that continue it;
on a slope of any steepness those along the contour do."""

_BELOW = 3
_BELOW_STEP_M = 0.5
_BELOW_SLOPE = 0.5
"""No seed is taken above three believed nodes of one or two returns below many others: that is
ground seen through a crown, whose lowest leaves fill a layer better than the ground does. The foot
of a cliff or wall has nodes of its own weight, and takes no seed from its top."""

Float = NDArray[np.float64]


class Points(NamedTuple):
    """Some points: three (n,) float64 [m], on the absolute lattice."""

    x: Float
    y: Float
    z: Float


def ground_mask(
    table: PointTable,
    usable: NDArray[np.bool_],
    settings: GroundSettings,
    asked: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Which points are ground.

    Returns that are probably afterpulses are no evidence: behind a bright meadow they lie
    so close together that they hold each other up, a metre below it. The surface is found
    without them; those that lie on it are ground like any other point.

    Parameters
    ----------
    table : PointTable
        Points of one ground cell and its buffer, in any order.
    usable : (n,) bool
        Points to look at: signal, not withheld.
    settings : GroundSettings
        Method and parameters.
    asked : (n,) bool, optional
        Points to be told; all by default.

    Returns
    -------
    (n,) bool
        True for ground; False wherever a point is not usable or not asked for.
    """
    mask = np.zeros(len(table), dtype=np.bool_)
    own = usable & ~dependents(table)
    if not own.any():
        own = usable
    told = usable if asked is None else usable & asked
    if told.any():
        evidence, places = _metres(table, own), _metres(table, told)
        if settings.method == "smrf":
            mask[told] = smrf_mask(evidence, places, settings.smrf)
        else:
            mask[told] = ptd_mask(evidence, places, settings.ptd)
    return mask


def _metres(table: PointTable, chosen: NDArray[np.bool_]) -> Points:
    """Some points [m], on the absolute lattice."""
    found = np.empty((3, int(np.count_nonzero(chosen)) + 1))
    chosen_places((table["x"], table["y"], table["z"]), chosen, QUANTUM_M, *found)
    return Points(*found[:, :-1])


def ptd_mask(own: Points, asked: Points, settings: PtdSettings) -> NDArray[np.bool_]:
    """Ground points by progressive TIN densification.

    Seeds are the lowest nodes that survive a progressive opening, so that neither a wide
    hall nor an embankment needs a seed grid of its own size; the source's iteration
    parameters then take in what the opening cut off. Points are ground in a band on both
    sides of the surface, so that their mean is not biased low; the band widens with the
    facets, over which the surface is known less well, but not over gaps: under a roof it
    would take in what noise and walls leave there.

    Parameters
    ----------
    own : Points
        Evidence; at least one.
    asked : Points
        Points to be told; at least one.
    settings : PtdSettings
        Parameters.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    nodes, cells, cell_m = _candidates(own, settings)
    sunk = _sunk(nodes, cells, cell_m)
    supported = _supported(nodes, cells, cell_m)
    trusted = supported & ~nodes.doubtful & ~sunk
    eligible = trusted & ~_on_objects(nodes, trusted, cells, cell_m, settings)
    eligible &= ~_seen_through(nodes, supported & ~sunk, cells, cell_m)
    seed = _seeds(nodes.xyz, _first_true((eligible, trusted)), settings.seed_cell_m)
    others = np.flatnonzero(~seed & ~sunk)
    tin, _ = densify(
        nodes.xyz[seed],
        nodes.xyz[others],
        np.where(trusted[others], -np.inf, -settings.band_m),
        _limits(settings),
        settings.seed_cell_m,
    )
    mask = np.zeros(len(asked.x), dtype=np.bool_)
    if tin is None:
        return mask
    order = group_by_cell(asked.x, asked.y, cell_m).order
    x, y, z = (values[order] for values in asked)
    height, edge = heights_above(tin, x, y, z)
    edge = np.minimum(edge, _GAP_SPACINGS * spacing_around_m(own.x, own.y, x, y))
    allowed = settings.band_m + np.tan(np.radians(settings.iteration_angle_deg)) * edge
    mask[order] = np.abs(height) <= np.minimum(allowed, settings.iteration_distance_m)
    return mask


def _candidates(own: Points, settings: PtdSettings) -> tuple[Nodes, Cells, float]:
    """Nodes, the cells that they are taken from, and the edge of these [m]."""
    cell_m = node_cell(own.x, own.y, settings.node_m)
    cells = group_by_cell(own.x, own.y, cell_m)
    return lowest_layers(*own, cells, settings.layer_m), cells, cell_m


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
    return smallest_m * (1 if smallest_m**2 >= _FILLED * spacing_m(x, y) ** 2 else 2)


def spacing_m(x: Float, y: Float) -> float:
    """Mean spacing of points where there are any, voids of :data:`_WIDE_M` left out [m].

    Parameters
    ----------
    x, y : (n,) float64
        Places [m]; n > 0.
    """
    count, _ = _in_squares(x, y)
    return _WIDE_M * math.sqrt(np.count_nonzero(count) / len(x))


def _in_squares(x: Float, y: Float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Points in squares of :data:`_WIDE_M` [count], and column and row of the first square."""
    ends = [int(np.floor(end / _WIDE_M)) for v in (x, y) for end in (v.min(), v.max())]
    count = np.zeros((ends[1] - ends[0] + 1, ends[3] - ends[2] + 1), dtype=np.int64)
    count_squares(x, y, _WIDE_M, ends[0], ends[2], count)
    return count, (ends[0], ends[2])


def spacing_around_m(x: Float, y: Float, at_x: Float, at_y: Float) -> Float:
    """Mean spacing of points around places, by the nine squares of :data:`_WIDE_M` [m].

    The squares lie on the absolute lattice: ground cells agree where they overlap.

    Parameters
    ----------
    x, y : (n,) float64
        Points [m]; n > 0.
    at_x, at_y : (m,) float64
        Places [m].

    Returns
    -------
    (m,) float64
        Of the squares with points; :data:`_WIDE_M` where none of the nine has any.
    """
    count, (left, bottom) = _in_squares(x, y)
    around = np.pad(count, 2)
    points, squares = (
        sum(np.roll(values, (i, j), axis=(0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1))
        for values in (around, (around > 0).astype(np.int64))
    )
    spacing = _WIDE_M * np.sqrt(np.maximum(squares, 1) / np.maximum(points, 1))
    # Places farther out have no points around, as the outermost squares have none.
    column = np.clip(np.floor(at_x / _WIDE_M).astype(np.int64) - left + 2, 0, len(spacing) - 1)
    row = np.clip(np.floor(at_y / _WIDE_M).astype(np.int64) - bottom + 2, 0, len(spacing[0]) - 1)
    found: Float = spacing[column, row]
    return found


def _sunk(nodes: Nodes, cells: Cells, cell_m: float) -> NDArray[np.bool_]:
    """Nodes below a hard surface in their cell, or in a pit of a smooth one around it."""
    sunk = np.empty(len(nodes.cell), dtype=np.bool_)
    reach = max(round(REACH_M / cell_m), 1)
    asked = nodes.points < SUPPORTED
    in_pits(nodes.xyz, nodes.cell, asked, nodes.doubtful, cells.rows, cells.columns, reach, sunk)
    return sunk | nodes.buried


def _supported(nodes: Nodes, cells: Cells, cell_m: float) -> NDArray[np.bool_]:
    """Nodes that others continue."""
    support = np.empty(len(nodes.cell), dtype=np.int64)
    count_support(
        nodes.xyz, nodes.cell, cells.rows, cells.columns, _REACH, _REACH * cell_m,
        _SUPPORT_STEP_M, _SUPPORT_SLOPE, support,
    )  # fmt: skip
    return support >= _SUPPORT


def _seen_through(
    nodes: Nodes, believed: NDArray[np.bool_], cells: Cells, cell_m: float
) -> NDArray[np.bool_]:
    """Nodes below which single returns go on: the lowest leaves of a crown."""
    below = np.empty(len(nodes.cell), dtype=np.int64)
    alone = believed & nodes.doubtful
    count_below(
        nodes.xyz, nodes.cell, alone, cells.rows, cells.columns, _REACH, _REACH * cell_m,
        _BELOW_STEP_M, _BELOW_SLOPE, below,
    )  # fmt: skip
    return below >= _BELOW


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


def smrf_mask(own: Points, asked: Points, settings: SmrfSettings) -> NDArray[np.bool_]:
    """Ground points by the simple morphological filter.

    Parameters
    ----------
    own : Points
        Evidence; at least one.
    asked : Points
        Points to be told; at least one.
    settings : SmrfSettings
        Parameters.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    cells = group_by_cell(own.x, own.y, settings.cell_m)
    nodes = lowest_layers(*own, cells, settings.layer_m)
    sunk = _sunk(nodes, cells, settings.cell_m)
    believed = _supported(nodes, cells, settings.cell_m) & ~sunk
    leaves = _seen_through(nodes, believed, cells, settings.cell_m)
    trusted = _first_true((~nodes.doubtful & ~sunk & ~leaves,))
    lowest = _lowest_grid(nodes, trusted, cells)
    terrain = provisional_terrain(lowest, settings.cell_m, settings.slope, settings.window_m)
    column = asked.x / settings.cell_m - np.floor(own.x.min() / settings.cell_m) - 0.5
    row = asked.y / settings.cell_m - np.floor(own.y.min() / settings.cell_m) - 0.5
    steepness = _steepness(terrain, settings.cell_m)
    surface = ndimage.map_coordinates(terrain, [row, column], order=1, mode="nearest")
    slope = ndimage.map_coordinates(steepness, [row, column], order=1, mode="nearest")
    allowed = settings.threshold_m + settings.scalar * slope
    mask: NDArray[np.bool_] = np.abs(asked.z - surface) <= allowed
    return mask


def _steepness(terrain: Float, cell_m: float) -> Float:
    """Steepest rise of a grid [rise/run]; zero along an axis of one cell."""
    squared = np.zeros_like(terrain)
    for axis in (0, 1):
        if terrain.shape[axis] > 1:
            squared += np.gradient(terrain, cell_m, axis=axis) ** 2
    return np.sqrt(squared)
