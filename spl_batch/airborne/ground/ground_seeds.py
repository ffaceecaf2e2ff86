"""Nodes of the ground: which are believed, and which of them a surface may start from.

Domain: space. *Nodes* are the lowest layers of cells
(:mod:`spl_batch.airborne.ground.lowest_layers`). The
rules here compare a node with those around by height, as if the ground were level; on a slope of
60 degrees neighbours of the same ground lie 1.7 m apart, and none of them would speak for another.
So they are asked twice: of the heights as they are, which gives enough of the ground to tell its
trend (:mod:`spl_batch.airborne.ground.ground_trend`), and of the heights above that.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_trend import Trend, fit_trend, trend_at
from spl_batch.airborne.ground.lowest_layers import (
    SUPPORTED,
    Nodes,
    Rule,
    count_around,
    lowest_layers,
)
from spl_batch.airborne.ground.morphology import object_cells
from spl_batch.airborne.ground.pits import PIT_REACH_M, in_pits
from spl_batch.airborne.ground.smrf import fill_gaps, low_outliers
from spl_batch.airborne.settings import PtdSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.numerics.cell_groups import Cells, group_by_cell

_SUPPORT = 2
_CONTINUES = Rule(reach=2, step_m=0.25, slope=0.35)
"""A node is believed below the surface, and as a seed, with two nodes around that continue it;
on a slope of any steepness those along the contour do."""

_BELOW = 3
_GOES_ON_BELOW = Rule(reach=2, step_m=0.5, slope=0.5)
"""No seed is taken above three believed nodes of one or two returns below many others: that is
ground seen through a crown, whose lowest leaves fill a layer better than the ground does. The foot
of a cliff or wall has nodes of its own weight, and takes no seed from its top."""

_WIDE_AGREE = 3
_WIDE = Rule(reach=4, step_m=0.2, slope=0.05)
_WIDE_BELOW = Rule(reach=4, step_m=0.4, slope=0.1)
"""The same above a trend, where ground is level and single returns of it continue each other over
more cells: in the shade of a crown and a shrub there are few to the cell. Nodes at the node's own
height outvote them: at the edge of a terrace there are more of these."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Start(NamedTuple):
    """What a surface grows from.

    Parameters
    ----------
    xyz : (m, 3) float64
        Nodes [m].
    sunk : (m,) bool
        Nodes that are none of the ground's: below a hard surface, or in a pit.
    trusted : (m,) bool
        Nodes that others continue, of enough returns.
    seed : (m,) bool
        Nodes to start from.
    """

    xyz: Float
    sunk: Mask
    trusted: Mask
    seed: Mask


class _Judged(NamedTuple):
    """What the rules say of each node; the best that there are may be no more than any."""

    sunk: Mask
    trusted: Mask
    best: Mask


def start(x: Float, y: Float, z: Float, cell_m: float, settings: PtdSettings) -> Start:
    """Nodes of a cloud, and the seeds among them.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m], on the lattice of quanta; n > 0.
    cell_m : float
        Edge of the cells that nodes are taken from [m].
    settings : PtdSettings
        Parameters.
    """
    cells = group_by_cell(x, y, cell_m)
    nodes = lowest_layers(x, y, z, cells, settings.layer_m)
    first = _judge(nodes, cells, cell_m, settings)
    trend = fit_trend(nodes.xyz[first.best], x, y)
    level = lowest_layers(x, y, above_trend(x, y, z, trend), cells, settings.layer_m)
    xyz = level.xyz.copy()
    xyz[:, 2] += trend_at(trend, xyz[:, 0], xyz[:, 1])
    found = _judge(level, cells, cell_m, settings, xyz)
    free = found.best & ~_shaded(level, found.sunk, cells, cell_m)
    best = first_true((free, found.best))
    seed = _seeds(level.xyz, best, settings.seed_cell_m) | _seeds(xyz, best, settings.seed_cell_m)
    return Start(xyz, found.sunk, found.trusted, seed)


def above_trend(x: Float, y: Float, z: Float, trend: Trend) -> Float:
    """Heights of points above a trend, on the lattice of quanta as they are: (n,) [m]."""
    height: Float = np.rint((z - trend_at(trend, x, y)) * QUANTA_PER_M) / QUANTA_PER_M
    return height


def _judge(
    nodes: Nodes, cells: Cells, cell_m: float, settings: PtdSettings, also: Float | None = None
) -> _Judged:
    """Ask all rules. What stands on an object does so by the nodes' other places, too.

    A crown does; the top of a cliff stands out above the trend, but not as it is.
    """
    below = sunk(nodes, cells, cell_m)
    # Afterpulses below a meadow lie near enough to continue each other. Before the ground's trend
    # is known, much that is sunk in deep shade is ground.
    asked = np.ones_like(below) if also is None else ~below
    continued = np.zeros_like(below)
    continued[asked] = supported(_of(nodes, asked), cells, cell_m)
    trusted = continued & ~nodes.doubtful & ~below
    objects = _on_objects(nodes, trusted, cells, cell_m, settings)
    if also is not None:
        objects &= _on_objects(nodes._replace(xyz=also), trusted, cells, cell_m, settings)
    eligible = trusted & ~objects & ~seen_through(nodes, continued & ~below, cells, cell_m)
    return _Judged(below, trusted, first_true((eligible, trusted)))


def sunk(nodes: Nodes, cells: Cells, cell_m: float) -> Mask:
    """Nodes below a hard surface in their cell, or in a pit of a smooth one around it."""
    pit = np.empty(len(nodes.cell), dtype=np.bool_)
    reach = max(round(PIT_REACH_M / cell_m), 1)
    asked, grid = nodes.points < SUPPORTED, (cells.rows, cells.columns)
    in_pits(nodes.xyz, nodes.cell, asked, nodes.doubtful, *grid, reach, pit)
    return pit | nodes.buried


def supported(nodes: Nodes, cells: Cells, cell_m: float) -> Mask:
    """Nodes that others continue."""
    every = np.ones(len(nodes.cell), np.bool_)
    found = count_around(nodes, every, cells, cell_m, _CONTINUES, below=False, enough=_SUPPORT)
    return found >= _SUPPORT


def _of(nodes: Nodes, chosen: Mask) -> Nodes:
    """Some of the nodes."""
    xyz, cell, points, doubtful, buried = nodes
    rest = (cell[chosen], points[chosen], doubtful[chosen], buried[chosen])
    return Nodes(xyz[chosen], *rest)


def seen_through(nodes: Nodes, believed: Mask, cells: Cells, cell_m: float) -> Mask:
    """Nodes below which single returns go on: the lowest leaves of a crown."""
    alone = believed & nodes.doubtful
    return count_around(nodes, alone, cells, cell_m, _GOES_ON_BELOW, below=True) >= _BELOW


def _shaded(level: Nodes, low: Mask, cells: Cells, cell_m: float) -> Mask:
    """Nodes above a trend that single returns go on below, no fewer than nodes at their height."""
    every, alone, on = np.ones(len(low), np.bool_), level.doubtful & ~low, (cells, cell_m, _WIDE)
    beside = count_around(level, every, *on, below=False, asked=alone, enough=_WIDE_AGREE)
    alone &= beside >= _WIDE_AGREE
    under = count_around(level, alone, cells, cell_m, _WIDE_BELOW, below=True)
    shaded: Mask = under >= _BELOW
    shaded &= under >= count_around(level, every, *on, below=False, asked=shaded)
    return shaded


def _on_objects(
    nodes: Nodes,
    trusted: Mask,
    cells: Cells,
    cell_m: float,
    settings: PtdSettings,
) -> Mask:
    """Nodes that no seed may be taken from: in pits, or cut off by opening."""
    lowest = lowest_grid(nodes, trusted, cells)
    if np.isnan(lowest).all():
        return np.zeros(len(trusted), dtype=np.bool_)
    surface = fill_gaps(lowest)
    raised = low_outliers(surface, cell_m)
    raised |= object_cells(
        surface, cell_m, settings.seed_slope, settings.object_m / 2, step_m=settings.seed_step_m
    )
    on_objects: Mask = raised.ravel()[nodes.cell]
    return on_objects


def lowest_grid(nodes: Nodes, trusted: Mask, cells: Cells) -> Float:
    """Height of the lowest trusted node of each cell; NaN where there is none."""
    height = np.full(cells.rows * cells.columns, np.nan)
    believed = np.flatnonzero(trusted)[::-1]  # the lower node of a cell comes last and stays
    height[nodes.cell[believed]] = nodes.xyz[believed, 2]
    return height.reshape(cells.rows, cells.columns)


def _seeds(xyz: Float, eligible: Mask, seed_cell_m: float) -> Mask:
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


def first_true(choices: tuple[Mask, ...]) -> Mask:
    """The first selection that selects anything, or everything."""
    for choice in choices:
        if choice.any():
            return choice
    return np.ones_like(choices[0])
