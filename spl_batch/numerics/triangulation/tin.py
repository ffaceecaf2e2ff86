"""Triangulated surfaces: Delaunay triangulation, point location, linear interpolation.

Locating points is a visibility walk of our own: `scipy.spatial.Delaunay.find_simplex`
answers the same question, but starts each walk without the neighbourhood that sorted queries
offer and holds the GIL.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.triangulation.delaunay import triangles

OUTSIDE = -1
"""Facet number of a point outside the triangulation."""

_EDGE_SLACK = 1e-12
"""Barycentric weight below zero that still counts as on the edge."""

_NEAR = 1e-6
"""Barycentric weight below which the triangle across an edge is asked as well."""


class Tin(NamedTuple):
    """Triangulated irregular network."""

    xyz: NDArray[np.float64]  #: (v, 3): vertices [m].
    facets: NDArray[np.int32]  #: (t, 3): vertices of each triangle, counter-clockwise.
    #: (t, 3): triangle across from each vertex; :data:`OUTSIDE` at the hull.
    neighbours: NDArray[np.int32]
    #: (t, 3): height at the first corner and slopes: z = c + a (x - x0) + b (y - y0), as a, b, c.
    planes: NDArray[np.float64]


def triangulate(xyz: NDArray[np.float64]) -> Tin | None:
    """Delaunay triangulation in the horizontal plane.

    Parameters
    ----------
    xyz : (v, 3) float64
        Vertices [m]; no two at the same position.

    Returns
    -------
    Tin or None
        None where no triangle exists: fewer than three vertices, or all on one line.
    """
    facets, neighbours = triangles(xyz[:, :2])
    return tin_of(xyz, facets, neighbours) if len(facets) else None


def tin_of(
    xyz: NDArray[np.float64], facets: NDArray[np.int32], neighbours: NDArray[np.int32]
) -> Tin:
    """Surface of some triangles; ``xyz`` may hold points that none of them needs."""
    planes = np.empty((len(facets), 3))
    facet_planes(xyz, facets, planes)
    return Tin(xyz, facets, neighbours, planes)


@njit()
def facet_planes(
    xyz: NDArray[np.float64], facets: NDArray[np.int32], out: NDArray[np.float64]
) -> None:
    """Plane z = c + a (x - x0) + b (y - y0) through each triangle, 0 its first corner.

    Parameters
    ----------
    xyz : (v, 3) float64
        Vertices [m].
    facets : (t, 3) int32
        Triangles.
    out : (t, 3) float64
        a, b [rise/run] and c [m]; a triangle of no area gets the plane z = mean height.
    """
    for t in range(len(facets)):
        i, j, k = facets[t]
        ux, uy, uz = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
        vx, vy, vz = xyz[k, 0] - xyz[i, 0], xyz[k, 1] - xyz[i, 1], xyz[k, 2] - xyz[i, 2]
        area = ux * vy - uy * vx
        if area == 0.0:
            out[t, 0], out[t, 1] = 0.0, 0.0
            out[t, 2] = (xyz[i, 2] + xyz[j, 2] + xyz[k, 2]) / 3.0
            continue
        a = (uz * vy - uy * vz) / area
        b = (ux * vz - uz * vx) / area
        out[t, 0], out[t, 1] = a, b
        out[t, 2] = xyz[i, 2]


@njit(inline="always")
def _weights(
    xyz: NDArray[np.float64], facets: NDArray[np.int32], t: int, px: float, py: float
) -> tuple[float, float, float]:
    """Twice the signed area of p and the edge across from each corner; they add up to that of all.

    The two triangles at an edge see it with opposite signs, to the last bit.
    """
    i, j, k = facets[t, 0], facets[t, 1], facets[t, 2]
    ax, ay = xyz[i, 0] - px, xyz[i, 1] - py
    bx, by = xyz[j, 0] - px, xyz[j, 1] - py
    cx, cy = xyz[k, 0] - px, xyz[k, 1] - py
    return bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx


@njit(inline="always")
def locate_one(
    xyz: NDArray[np.float64],
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    px: float,
    py: float,
    start: int,
) -> tuple[int, int]:
    """Triangle that holds a point, by walking there.

    Parameters
    ----------
    px, py : float
        Place [m].

    Returns
    -------
    found : int
        Triangle, or :data:`OUTSIDE`.
    last : int
        Triangle where the walk ended: a good start for the next point.
    """
    t = start
    for step in range(len(facets) + 16):
        one, two, three = _weights(xyz, facets, t, px, py)
        least = -_EDGE_SLACK * (one + two + three)
        if one >= least and two >= least and three >= least:
            return t, t
        # From a rotating first edge: over cocircular vertices a walk might go round for ever.
        if step & 1:
            k = 0 if one < least else (1 if two < least else 2)
        else:
            k = 2 if three < least else (1 if two < least else 0)
        beyond = neighbours[t, k]
        if beyond < 0:
            return OUTSIDE, t
        t = beyond
    for t in range(len(facets)):  # a walk that rounding kept going round: look everywhere
        one, two, three = _weights(xyz, facets, t, px, py)
        if min(one, two, three) >= -_EDGE_SLACK * (one + two + three):
            return t, t
    return OUTSIDE, start


@njit(inline="always")
def first_of(
    xyz: NDArray[np.float64],
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    px: float,
    py: float,
    found: int,
) -> int:
    """Triangle of the lowest number among those that hold a point.

    A walk ends in any of them where the point lies on an edge or a corner, which depends on where
    it began.

    Parameters
    ----------
    px, py : float
        Place [m].
    found : int
        One of the triangles, by :func:`locate_one`.
    """
    one, two, three = _weights(xyz, facets, found, px, py)
    near = _NEAR * (one + two + three)
    first = found
    if one <= near or two <= near or three <= near:
        first = _first_around(xyz, facets, neighbours, px, py, found)
    return first


@njit()
def _first_around(
    xyz: NDArray[np.float64],
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    px: float,
    py: float,
    found: int,
) -> int:
    """The same for a point that lies near an edge."""
    first = found
    for k in range(3):
        # From triangle to triangle around the corner that the point is at, or over one edge.
        came, here, towards = OUTSIDE, found, k
        for _ in range(len(facets)):
            weights = _weights(xyz, facets, here, px, py)
            near = _NEAR * (weights[0] + weights[1] + weights[2])
            beyond = OUTSIDE
            for m in range(3):
                if neighbours[here, m] != came and weights[m] <= near and towards in (m, -1):
                    beyond = neighbours[here, m]
            if beyond < 0 or beyond == found:
                break
            one, two, three = _weights(xyz, facets, beyond, px, py)
            if min(one, two, three) < -_EDGE_SLACK * (one + two + three):
                break
            first = min(first, beyond)
            came, here, towards = here, beyond, -1
    return first


@njit()
def locate(
    xyz: NDArray[np.float64],
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    out: NDArray[np.int32],
) -> None:
    """Triangle that holds each point; points near each other should follow each other.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m].
    out : (n,) int32
        Triangle, or :data:`OUTSIDE`.
    """
    last = 0
    for i in range(len(x)):
        found, last = locate_one(xyz, facets, neighbours, x[i], y[i], last)
        out[i] = found


def interpolate(tin: Tin, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of a surface: (n,) float64 [m]; NaN outside the surface.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m], near ones following each other.
    """
    facet = np.empty(len(x), dtype=np.int32)
    locate(tin.xyz, tin.facets, tin.neighbours, x, y, facet)
    height = facet_heights(tin, facet, x, y)
    height[facet < 0] = np.nan
    return height


def facet_heights(
    tin: Tin, facet: NDArray[np.int32], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights of the planes of triangles at points: (n,) float64 [m]; of any where there is none.

    Parameters
    ----------
    facet : (n,) int32
        Triangle of each point.
    x, y : (n,) float64
        Places [m].
    """
    a, b, c = tin.planes[facet].T
    x0, y0, _ = tin.xyz[tin.facets[facet, 0]].T
    height: NDArray[np.float64] = c + a * (x - x0) + b * (y - y0)
    return height


def vertex_slopes(tin: Tin) -> NDArray[np.float64]:
    """Slopes of a surface at its vertices: mean of the triangles around.

    A single triangle is as steep as the noise of its corners makes it, and a sliver at the rim of a
    triangulation any steepness, however large it is. Each counts as the square of its least height
    does: of equal shapes as their areas.

    Returns
    -------
    (v, 2) float64
        To the east and to the north [rise/run]; zero at a vertex that no triangle needs.
    """
    corner = tin.facets.astype(np.int64)
    (ax, bx, cx), (ay, by, cy) = (np.take(tin.xyz[:, axis], corner.T) for axis in (0, 1))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    sides = ((ax - bx, ay - by), (bx - cx, by - cy), (cx - ax, cy - ay))
    longest2 = np.max([east * east + north * north for east, north in sides], axis=0)
    weight = area * area / longest2
    # Of the triangles around each vertex: weights, and slopes times weights.
    of_facet = weight, weight * tin.planes[:, 0], weight * tin.planes[:, 1]
    total, *summed = (
        np.bincount(corner.ravel(), np.repeat(values, 3), len(tin.xyz)) for values in of_facet
    )
    slopes: NDArray[np.float64] = (
        np.column_stack(summed) / np.where(total > 0.0, total, 1.0)[:, None]
    )
    return slopes
