"""Ground points by a surface whose scale follows the data.

Domain: space. See :mod:`spl_batch.airborne.ground.multiscale_surface`. There is nothing to set:
cell sizes, the tolerance around the surface and its growth on slopes follow from the spacing of the
points and from how much the ground scatters.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_seeds import believed
from spl_batch.airborne.ground.lowest_layers import SUPPORTED, lowest_layers
from spl_batch.airborne.ground.multiscale.grown_ground import grown
from spl_batch.airborne.ground.multiscale.near_surface import (
    Surface,
    near_surface,
    needed,
    surface_of,
    within,
)
from spl_batch.airborne.ground.multiscale.node_planes import under_planes, without_plants
from spl_batch.airborne.ground.multiscale.objects import objects
from spl_batch.airborne.ground.multiscale_surface import (
    ABOVE_SIGMA,
    BARE,
    EVERYWHERE,
    agreeing_nodes,
    depths_below,
    ends_within,
    ground_nodes,
    low_outliers,
    no_depths,
    noise_below,
    spread_below,
)
from spl_batch.airborne.ground.node_grids import lowest_nodes, nearest_node
from spl_batch.airborne.ground.point_spacing import Blocks, spacings_m
from spl_batch.airborne.ground.scales import CELL_M, SPREADS, STEEP
from spl_batch.numerics.cell_groups import group_by_cell

_BELOW_SIGMA = 4.0
_TAIL = 0.9
"""Ground reaches below the surface by so many spreads of the tail of the points there, as nothing
grows below: with 3, heath loses 0.7 points of its ground."""

_BAND_SPACINGS = STEEP / 2
"""So many spacings of the points: halfway between two of them steep ground has fallen by so much,
and is not known better."""

_ROUGH = np.sqrt(2.0)
"""Ground scatters by so much more than its nodes, which are means: of two returns at least where it
is rough. With 1 the coast gains 1.5 points, but 0.8 % of the ground of a simulated dam goes."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Place = tuple[Float, Float, Float]


def multiscale_mask(places: Place, own: Mask, asked: Mask, sigma: Blocks = EVERYWHERE) -> Mask:
    """Ground points by a surface whose scale follows the data.

    Parameters
    ----------
    places : three (n,) float64
        x, y, z [m].
    own, asked : (n,) bool
        Evidence, at least one; points to be judged.
    sigma : Blocks
        Standard deviation of a range [m].

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    # One cell after the other: neighbours follow each other wherever points are looked at.
    order = group_by_cell(*places[:2], CELL_M).order
    x, y, z = (v[order] for v in places)
    own, asked = own[order], asked[order]
    evidence = _of((x, y, z), own)
    apart = spacings_m(*evidence[:2])
    surface, off = _ground_surface(evidence, apart, sigma)
    found = np.zeros(len(x), np.bool_)
    if surface is None:
        return found[: int(asked.sum())]
    depths = no_depths(*evidence[:2])
    east, north = surface.nodes[:, :2].T
    rough = depths_below(off, east, north, no_depths(*evidence[:2]))
    rough_m = _ROUGH * spread_below(noise_below(rough))
    near = near_surface(surface, (x, y, z), needed(x, y, own, asked, depths))
    mine = own[near.at]
    at, off_m = near.at[mine], near.off[mine]
    depths = noise_below(depths_below(off_m, x[at], y[at], depths))
    # Halves of heights: layers of twice the thickness are counted.
    heights = depths_below(-0.5 * off_m, x[at], y[at], no_depths(*evidence[:2]))
    # As thick as ranges scatter, or rough soil, where that layer ends: grass goes on.
    stated_m = sigma.over(depths.first, depths.values.shape[:2])
    sigma_m = BARE * stated_m
    for thick_m in (stated_m, np.maximum(stated_m, rough_m)):
        sigma_m = np.where(ends_within(heights, 0.5 * ABOVE_SIGMA * thick_m), thick_m, sigma_m)
    most_m, tail_m = spread_below(depths), spread_below(depths, _TAIL)
    above, below = (
        Blocks(many * np.maximum(spread_m, sigma_m), depths.first)
        for many, spread_m in ((ABOVE_SIGMA, most_m), (_BELOW_SIGMA, tail_m))
    )
    found[near.at] = within(near, (x, y), apart, (above, below), _BAND_SPACINGS)
    judged, by_place = np.empty((2, len(x)), np.bool_)
    judged[order], by_place[order] = found, asked
    return judged[by_place]


def _of(places: Place, chosen: Mask) -> Place:
    """Some points; no copy where all are meant."""
    if chosen.all():
        return places
    x, y, z = (v[chosen] for v in places)
    return x, y, z


def _ground_surface(evidence: Place, apart: Blocks, sigma: Blocks) -> tuple[Surface | None, Float]:
    """Surface of the ground, None where no point is believed; its nodes' heights off planes."""
    xyz, filled, doubtful = _nodes(evidence, sigma)
    if not len(xyz):
        return None, np.empty(0)
    chosen, high = agreeing_nodes(xyz, ~low_outliers(xyz), filled, sigma)
    grid = lowest_nodes(xyz, chosen, CELL_M)
    nearest = nearest_node(grid)
    opened = ground_nodes(xyz, high, grid, nearest)
    ground = grown(xyz, grid, nearest, opened, apart.at(*xyz[:, :2].T))
    ground[ground] = ~objects(xyz[ground], opened[ground])
    ground[ground] = ~under_planes(xyz[ground], filled[ground], doubtful[ground])
    x, y, _ = xyz[ground].T
    nodes, off = without_plants(xyz[ground], apart.at(x, y))
    return surface_of(nodes), off


def _nodes(evidence: Place, sigma: Blocks) -> tuple[Float, Mask, Mask]:
    """Nodes (n, 3) [m]; those of several returns in the layer, and of few below many others."""
    x, y, z = evidence
    cells = group_by_cell(x, y, CELL_M)
    south, west = (int(np.floor(v.min() / CELL_M)) for v in (y, x))
    east, north = west + np.arange(cells.columns), south + np.arange(cells.rows)
    sigma_m = sigma.at(CELL_M * east[None, :], CELL_M * north[:, None]).ravel()
    nodes = lowest_layers(x, y, z, cells, SPREADS * sigma_m, thinnest=BARE)
    above = believed(nodes, cells, CELL_M)
    filled = nodes.points >= SUPPORTED
    return nodes.xyz[above], filled[above], nodes.doubtful[above]
