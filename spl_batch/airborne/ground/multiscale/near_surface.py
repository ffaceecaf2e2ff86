"""How far points lie above a surface, and which of them are near enough to be ground."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.point_spacing import Blocks
from spl_batch.airborne.ground.scales import CELL_M
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.point_grid import PointGrid
from spl_batch.numerics.triangulation.tin import (
    Tin,
    facet_heights,
    first_of,
    locate_one,
    triangulate,
    vertex_slopes,
)

SLOPE_M: Final = CELL_M * np.sqrt(2.0)
"""The band grows with the slope by the spacing of the points, and at most by the diagonal of a
cell: a node lies no farther from the other points of its cell [m]. The source adds 1.25 m at any
spacing. Twice as much gains 3.7 points in ISPRS 53 and loses 3.1 in 71."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Facets = NDArray[np.int32]
Place = tuple[Float, Float, Float]


class Surface(NamedTuple):
    """Ground: its nodes (n, 3) [m], their slopes to east and north, and a TIN if there is one."""

    nodes: Float
    slopes: Float
    tin: Tin | None


class Near(NamedTuple):
    """Points beside a surface.

    Parameters
    ----------
    at : (k,) int64
        Which they are.
    off : (k,) float64
        Heights above the surface [m].
    slope : (k,) float64
        Its slope there, by the mean of the three nodes around [rise/run].
    """

    at: Index
    off: Float
    slope: Float


def surface_of(nodes: Float) -> Surface:
    """Surface through nodes of the ground, at least one."""
    tin = triangulate(nodes)
    slopes = np.zeros((len(nodes), 2)) if tin is None else vertex_slopes(tin)
    return Surface(nodes, slopes, tin)


def near_surface(surface: Surface, places: Place, asked: Mask) -> Near:
    """Heights above a surface, of the points asked for.

    Beyond the triangles the nearest node is continued by its slope.

    Parameters
    ----------
    surface : Surface
        The surface.
    places : three (n,) float64
        Points [m], near ones following each other.
    asked : (n,) bool
        Which are asked for.
    """
    tin, at = surface.tin, np.flatnonzero(asked)
    x, y, z = (v[at] for v in places)
    facet = np.full(len(at), -1, np.int32)
    off, slope = np.empty((2, len(at)))
    if tin is not None:
        facet = facets_at(tin, x, y)
        steep = np.hypot(*surface.slopes[tin.facets].mean(axis=1).T)
        off, slope = z - facet_heights(tin, facet, x, y), steep[facet]
    beyond = np.flatnonzero(facet < 0)
    if len(beyond):
        place = np.column_stack([x[beyond], y[beyond]])
        nearest = PointGrid.of(surface.nodes).nearest(place)[:, 0]
        node, rise = surface.nodes[nearest], surface.slopes[nearest]
        off[beyond] = z[beyond] - (node[:, 2] + ((place - node[:, :2]) * rise).sum(axis=1))
        slope[beyond] = np.hypot(*rise.T)
    return Near(at, off, slope)


def facets_at(tin: Tin, x: Float, y: Float) -> NDArray[np.int32]:
    """Triangle of the lowest number that holds each point; -1 outside: (n,).

    Parameters
    ----------
    x, y : (n,) float64
        Points [m], near ones following each other.
    """
    found = np.empty(len(x), np.int32)
    _facets_at(tin.xyz, tin.facets, tin.neighbours, x, y, found)
    return found


@njit()
def _facets_at(
    xyz: Float, facets: Facets, neighbours: Facets, x: Float, y: Float, out: Facets
) -> None:
    """Fill for each point."""
    last = 0
    for i in range(len(x)):
        found, last = locate_one(xyz, facets, neighbours, x[i], y[i], last)
        out[i] = found if found < 0 else first_of(xyz, facets, neighbours, x[i], y[i], found)


def needed(x: Float, y: Float, own: Mask, asked: Mask, blocks: Blocks) -> Mask:
    """Points that are asked, and those of evidence in their blocks and around: (n,) bool.

    Parameters
    ----------
    x, y : (n,) float64
        Points [m].
    own, asked : (n,) bool
        Evidence, which is counted by blocks, and points to be judged.
    blocks : Blocks
        The blocks; the nearest one counts beyond them.
    """
    some, (row, column) = np.zeros(blocks.values.shape[:2], np.bool_), blocks.numbers(x, y)
    some[row[asked], column[asked]] = True
    around = ndimage.binary_dilation(some, np.ones((3, 3), np.bool_))
    found: Mask = asked | own & around[row, column]
    return found


def within(
    near: Near, place: tuple[Float, Float], spacing: Blocks, reach: tuple[Blocks, Blocks],
    spacings: float,
) -> Mask:  # fmt: skip
    """Which points lie on a surface: (k,) bool.

    Parameters
    ----------
    near : Near
        k of the points.
    place : two (n,) float64
        Eastings and northings of all points [m].
    spacing : Blocks
        Mean spacing of points [m].
    reach : two Blocks
        How far ground reaches above and below a level surface [m].
    spacings : float
        It reaches so many spacings at least.
    """
    x, y = (v[near.at] for v in place)
    apart_m = spacing.at(x, y)
    reach_m = np.where(near.off > 0.0, reach[0].at(x, y), reach[1].at(x, y))
    level_m = np.maximum(reach_m, spacings * apart_m)
    found: Mask = np.abs(near.off) <= level_m + np.minimum(apart_m, SLOPE_M) * near.slope
    return found
