"""How far points lie above a surface, for those that may lie on it.

Most returns of a forest or a town are far above the ground. Above each square of a grid no point is
looked for in the triangles that is higher than all of them there, and so much more as ground
reaches above any surface. What is left out could not have been ground: the same points are found as
without.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from spl_batch.airborne.ground.point_spacing import BLOCK_M, Blocks, spacing_m
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.triangulation.tin import (
    Tin,
    first_of,
    locate_one,
    triangulate,
    vertex_slopes,
)

BAND_M: Final = 0.5
"""Largest distance from the surface of a ground point, where that is level [m]."""

SLOPE_M: Final = 1.25
"""The band grows with the slope by the spacing of the points, and this at most [m], which is what
the source adds at any spacing."""

SQUARE_M: Final = 1.0
SPACINGS: Final = 2.0
"""Least edge of the squares [m], and their edge in spacings of the nodes."""

_SLACK_M = 1e-3
"""Heights of triangles are rounded by far less [m]."""

_SLACK = 1e-6
"""Triangles touch squares that are no farther off than this [squares]."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Facets = NDArray[np.int32]
Place = tuple[Float, Float, Float]


class Tops(NamedTuple):
    """Heights above which no point of a square is ground.

    Parameters
    ----------
    top_m : (rows, columns) float64
        Height [m]; infinite where not all of a square lies below triangles.
    edge_m : float
        Edge of a square [m].
    first : (int, int)
        Row and column of the first square.
    """

    top_m: Float
    edge_m: float
    first: tuple[int, int]


class Surface(NamedTuple):
    """Ground: its nodes (n, 3) [m], their slopes to east and north, and a TIN if there is one.

    ``steep``: slope of each triangle by the mean of its nodes [rise/run].
    """

    nodes: Float
    slopes: Float
    tin: Tin | None
    steep: Float
    tops: Tops


class Near(NamedTuple):
    """Points that may lie on a surface.

    Parameters
    ----------
    at : (k,) int64
        Which they are.
    off : (k,) float64
        Heights above the surface [m].
    slope : (k,) float64
        Its slope there [rise/run].
    """

    at: Index
    off: Float
    slope: Float


def surface_of(nodes: Float) -> Surface:
    """Surface through nodes of the ground, at least one."""
    tin = triangulate(nodes)
    if tin is None:
        nowhere = Tops(np.empty((0, 0)), SQUARE_M, (0, 0))
        return Surface(nodes, np.zeros((len(nodes), 2)), None, np.empty(0), nowhere)
    slopes = vertex_slopes(tin)
    edge_m = max(SQUARE_M, SPACINGS * spacing_m(*nodes[:, :2].T.copy()))
    left, right, bottom, top = (
        int(np.floor(end / edge_m)) for v in nodes[:, :2].T for end in (v.min(), v.max())
    )
    steep = np.empty(len(tin.facets))
    top_m = np.full((top - bottom + 1, right - left + 1), -np.inf)
    _tops(tin.xyz, tin.facets, tin.neighbours, slopes, edge_m, (bottom, left), steep, top_m)
    top_m[np.isneginf(top_m)] = np.inf
    return Surface(nodes, slopes, tin, steep, Tops(top_m, edge_m, (bottom, left)))


@njit()
def _tops(
    xyz: Float, facets: Facets, neighbours: Facets, slopes: Float, edge_m: float,
    first: tuple[int, int], steep: Float, out: Float,
) -> None:  # fmt: skip
    """Slope of each triangle, and the highest that ground reaches in each square that it touches.

    Squares at the rim of all triangles have infinity.
    """
    corner = np.empty((3, 2))
    for t in range(len(facets)):
        east, north, high = 0.0, 0.0, -np.inf
        for k in range(3):
            v = facets[t, k]
            east, north = east + slopes[v, 0], north + slopes[v, 1]
            high = max(high, xyz[v, 2])
            corner[k, 0] = xyz[v, 0] / edge_m - first[1]
            corner[k, 1] = xyz[v, 1] / edge_m - first[0]
        steep[t] = np.sqrt(east * east + north * north) / 3.0
        _raise(corner, 3, high + BAND_M + SLOPE_M * steep[t] + _SLACK_M, out)
        for k in range(3):
            if neighbours[t, k] < 0:
                rim = np.empty((2, 2))
                for end in range(2):
                    rim[end] = corner[(k + 1 + end) % 3]
                _raise(rim, 2, np.inf, out)


@njit()
def _raise(corner: Float, corners: int, height: float, out: Float) -> None:
    """Raise the squares that a triangle or a line touches, row by row."""
    rows, columns = out.shape
    south, north = corner[0, 1], corner[0, 1]
    for k in range(1, corners):
        south, north = min(south, corner[k, 1]), max(north, corner[k, 1])
    for r in range(
        max(int(np.floor(south - _SLACK)), 0), min(int(np.floor(north + _SLACK)) + 1, rows)
    ):
        west, east = np.inf, -np.inf
        for k in range(corners):
            x0, y0 = corner[k]
            x1, y1 = corner[(k + 1) % corners]
            low, high = max(min(y0, y1), r - _SLACK), min(max(y0, y1), r + 1.0 + _SLACK)
            if low > high:
                continue
            one, other = x0, x1
            if y0 != y1:
                one = x0 + (x1 - x0) * ((low - y0) / (y1 - y0))
                other = x0 + (x1 - x0) * ((high - y0) / (y1 - y0))
            west, east = min(west, one, other), max(east, one, other)
        for c in range(
            max(int(np.floor(west - _SLACK)), 0), min(int(np.floor(east + _SLACK)) + 1, columns)
        ):
            out[r, c] = max(out[r, c], height)


def near_surface(surface: Surface, places: Place, asked: Mask) -> Near:
    """Those of the points asked for that may lie on a surface.

    Beyond the triangles the nearest node is continued by its slope.

    Parameters
    ----------
    surface : Surface
        The surface.
    places : three (n,) float64
        Points [m], near ones following each other.
    asked : (n,) bool
        Which are to be told.
    """
    tin, (x, y, z) = surface.tin, places
    if tin is None:
        at = np.flatnonzero(asked)
        off, slope = np.full((2, len(at)), np.nan)
    else:
        at, (off, slope) = np.empty(len(x), np.int64), np.empty((2, len(x)))
        held = _near(
            x, y, z, asked, *surface.tops, tin.xyz, tin.facets, tin.neighbours, tin.planes,
            surface.steep, at, off, slope,
        )  # fmt: skip
        at, off, slope = at[:held], off[:held], slope[:held]
    beyond = np.flatnonzero(np.isnan(off))
    if len(beyond):
        which = at[beyond]
        place = np.column_stack([x[which], y[which]])
        # A few places ask for a tree of many nodes: one that is made fast.
        tree = cKDTree(surface.nodes[:, :2], balanced_tree=False, compact_nodes=False)
        nearest = tree.query(place)[1]
        node, rise = surface.nodes[nearest], surface.slopes[nearest]
        off[beyond] = z[which] - (node[:, 2] + ((place - node[:, :2]) * rise).sum(axis=1))
        slope[beyond] = np.hypot(*rise.T)
    return Near(at, off, slope)


@njit()
def _near(
    x: Float, y: Float, z: Float, asked: Mask,
    top_m: Float, edge_m: float, first: tuple[int, int],
    xyz: Float, facets: Facets, neighbours: Facets, planes: Float, steep: Float,
    at: Index, off: Float, slope: Float,
) -> int:  # fmt: skip
    """Fill for the points that are no higher than ground reaches; how many. NaN beyond the TIN."""
    rows, columns = top_m.shape
    held, last = 0, 0
    for i in range(len(x)):
        if not asked[i]:
            continue
        r = int(np.floor(y[i] / edge_m)) - first[0]
        c = int(np.floor(x[i] / edge_m)) - first[1]
        if 0 <= r < rows and 0 <= c < columns and z[i] > top_m[r, c]:
            continue
        at[held], off[held], slope[held] = i, np.nan, np.nan
        t, last = locate_one(xyz, facets, neighbours, x[i], y[i], last)
        if t >= 0:
            t = first_of(xyz, facets, neighbours, x[i], y[i], t)
            a = facets[t, 0]
            rise = planes[t, 0] * (x[i] - xyz[a, 0]) + planes[t, 1] * (y[i] - xyz[a, 1])
            off[held] = z[i] - (planes[t, 2] + rise)
            slope[held] = steep[t]
        held += 1
    return held


def needed(x: Float, y: Float, own: Mask, asked: Mask, blocks: Blocks) -> Mask:
    """Points that are asked, and those of evidence in their blocks and around: (n,) bool.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m].
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


@njit()
def _block(x: float, y: float, first: tuple[int, int], shape: tuple[int, int]) -> tuple[int, int]:
    """Row and column of the block that holds a place, or of the nearest."""
    row, column = int(np.floor(y / BLOCK_M)) - first[0], int(np.floor(x / BLOCK_M)) - first[1]
    return min(max(row, 0), shape[0] - 1), min(max(column, 0), shape[1] - 1)


@njit()
def within(
    near: tuple[Index, Float, Float], place: tuple[Float, Float],
    spacing: tuple[Float, tuple[int, int]], reach: tuple[Float, Float, tuple[int, int]],
    spacings: float, out: Mask,
) -> None:  # fmt: skip
    """Mark the points that lie on a surface.

    Parameters
    ----------
    near : Near
        Points that may.
    place : two (n,) float64
        Eastings and northings of all points [m].
    spacing : Blocks
        Mean spacing of points [m].
    reach : two (rows, columns) float64, (int, int)
        How far ground reaches above and below a level surface, by blocks [m], and row and column of
        the first of these.
    spacings : float
        It reaches so many spacings at least.
    out : (n,) bool
        Filled.
    """
    (at, off, slope), (x, y), (above, below, first) = near, place, reach
    for k in range(len(at)):
        i = at[k]
        apart_m = spacing[0][_block(x[i], y[i], spacing[1], spacing[0].shape)]
        reach_m = (above if off[k] > 0.0 else below)[_block(x[i], y[i], first, above.shape)]
        level = min(max(reach_m, spacings * apart_m), BAND_M)
        out[i] = abs(off[k]) <= level + min(apart_m, SLOPE_M) * slope[k]
