"""Nodes of the ground: which are believed, and which of them a surface may start from.

Domain: space. *Nodes* are the lowest layers of cells
(:mod:`spl_batch.airborne.ground.lowest_layers`). All methods leave out those in pits and below hard
surfaces, and single returns below many others that no neighbour continues.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.lowest_layers import SUPPORTED, Nodes, continued, lowest_layers
from spl_batch.airborne.ground.morphology import object_cells
from spl_batch.airborne.ground.multiscale_surface import low_outliers
from spl_batch.airborne.ground.node_grids import lowest_nodes, nearest_node
from spl_batch.airborne.ground.pits import in_pits
from spl_batch.airborne.ground.scales import BESIDE_M
from spl_batch.airborne.settings import PtdSettings
from spl_batch.numerics.cell_groups import Cells, group_by_cell

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
        Nodes that others continue.
    seed : (m,) bool
        Nodes to start from.
    """

    xyz: Float
    sunk: Mask
    trusted: Mask
    seed: Mask


def start(x: Float, y: Float, z: Float, cell_m: float, settings: PtdSettings) -> Start:
    """Nodes of a cloud, and the seeds among them: the lowest that an opening leaves.

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
    below = sunk(nodes, cells, cell_m)
    trusted = ~below & continued(nodes, cells, cell_m)
    best = first_true((trusted, ~below))
    best = first_true((best & ~low_outliers(nodes.xyz), best))
    grid = lowest_nodes(nodes.xyz, best, cell_m)
    raised = object_cells(
        nodes.xyz[nearest_node(grid), 2], cell_m, settings.seed_slope, settings.object_m / 2,
        step_m=settings.seed_step_m,
    )  # fmt: skip
    free, seed = np.zeros((2, len(below)), np.bool_)
    free[grid[(grid >= 0) & ~raised]] = True
    lowest = lowest_nodes(nodes.xyz, first_true((free, best)), settings.seed_cell_m)
    seed[lowest[lowest >= 0]] = True
    return Start(nodes.xyz, below, trusted, seed)


def believed(nodes: Nodes, cells: Cells, cell_m: float) -> Mask:
    """Nodes that are no noise; a single return below many others is, unless others continue it."""
    above = ~sunk(nodes, cells, cell_m)
    if nodes.doubtful.any():
        above &= ~nodes.doubtful | continued(nodes, cells, cell_m)
    return above


def sunk(nodes: Nodes, cells: Cells, cell_m: float) -> Mask:
    """Nodes below a hard surface in their cell, or in a pit of a smooth one around it."""
    pit = np.empty(len(nodes.cell), dtype=np.bool_)
    reach = max(round(BESIDE_M / cell_m), 1)
    asked, grid = nodes.points < SUPPORTED, (cells.rows, cells.columns)
    in_pits(nodes.xyz, nodes.cell, asked, nodes.doubtful, *grid, reach, pit)
    return pit | nodes.buried


def first_true(choices: tuple[Mask, ...]) -> Mask:
    """The first selection that selects anything, or everything."""
    for choice in choices:
        if choice.any():
            return choice
    return np.ones_like(choices[0])
