"""Progressive TIN densification [Axelsson 2000; parameters of W17 7.4].

A sparse triangulation through the lowest points of a coarse grid grows: in each round
every facet takes in the candidate that fits it best, if its distance to the facet's
plane and the largest angle from the facet's corners stay below the limits.

| symbol | here |
|---|---|
| terrain angle | ``terrain_slope``: steeper facets judge a candidate's mirror image |
| iteration angle | ``sin_angle`` |
| iteration distance | ``distance_m`` |

Deviations: the part of a distance that ranging noise explains counts for no angle; each
facet takes its lowest candidate in a round, as one that is not lowest may be a shrub; the
surface is framed by extrapolated vertices, so that points at the edge have facets too.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.near_surface import facets_at
from spl_batch.airborne.ground.scales import DAMPING_M2, NEAREST
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.point_grid import PointGrid
from spl_batch.numerics.triangulation.delaunay import along_curve, empty_mesh, finite, insert
from spl_batch.numerics.triangulation.tin import Tin, facet_heights, locate_one, tin_of


class Limits(NamedTuple):
    """What a candidate has to keep to.

    Parameters
    ----------
    terrain_slope : float
        Tangent of the terrain angle [rise/run].
    sin_angle : float
        Sine of the iteration angle.
    distance_m : float
        Iteration distance [m].
    spread_m : float
        Part of a distance that ranging noise explains; it counts for no angle [m].
    insert_m : float
        A candidate nearer to the surface does not change it and stays out [m].
    """

    terrain_slope: float
    sin_angle: float
    distance_m: float
    spread_m: float
    insert_m: float


def densify(
    seeds: NDArray[np.float64],
    candidates: NDArray[np.float64],
    floor: NDArray[np.float64],
    limits: Limits,
    margin_m: float,
) -> tuple[Tin | None, NDArray[np.bool_]]:
    """Grow a surface from seeds.

    Parameters
    ----------
    seeds : (s, 3) float64
        First vertices [m], at different positions.
    candidates : (c, 3) float64
        Points that may become vertices [m], near ones following each other.
    floor : (c,) float64
        Lowest signed distance to the surface at which a candidate is believed [m].
    limits : Limits
        Iteration parameters.
    margin_m : float
        The surface is continued by this much around all points [m].

    Returns
    -------
    tin : Tin or None
        Surface; None without seeds.
    taken : (c,) bool
        Candidates that became vertices.
    """
    taken = np.zeros(len(candidates), dtype=np.bool_)
    if len(seeds) == 0:
        return None, taken
    frame = _frame(np.concatenate([seeds, candidates]), margin_m)
    xyz = np.concatenate([seeds, frame, candidates])
    mesh = empty_mesh(xyz[:, :2])
    first = len(seeds) + len(frame)
    added = np.arange(first)
    while True:
        vertices = np.concatenate([seeds, candidates[taken]])
        xyz[len(seeds) : first, 2] = _continued(vertices, frame[:, :2])
        insert(mesh, along_curve(mesh, added))
        tin = tin_of(xyz, *finite(mesh))
        best = np.full(len(tin.facets), -1, dtype=np.int64)
        open_places = np.flatnonzero(~taken)
        _best_of_facets(
            tin.xyz,
            tin.facets,
            tin.neighbours,
            tin.planes,
            candidates[open_places],
            floor[open_places],
            limits,
            best,
        )
        chosen = open_places[best[best >= 0]]
        if len(chosen) == 0:
            break
        taken[chosen] = True
        added = first + chosen
    return tin, taken


def _frame(xyz: NDArray[np.float64], margin_m: float) -> NDArray[np.float64]:
    """Positions on a rectangle around all points, about a margin apart: (f, 3), z = 0."""
    low = xyz[:, :2].min(axis=0) - margin_m
    high = xyz[:, :2].max(axis=0) + margin_m
    steps = np.maximum(np.ceil((high - low) / (2 * margin_m)), 1).astype(int) + 1
    along_x = np.linspace(low[0], high[0], steps[0])
    along_y = np.linspace(low[1], high[1], steps[1])[1:-1]
    x = np.concatenate([along_x, along_x, np.repeat([low[0], high[0]], len(along_y))])
    y = np.concatenate([np.repeat([low[1], high[1]], len(along_x)), along_y, along_y])
    return np.column_stack([x, y, np.zeros_like(x)])


def _continued(vertices: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the plane through the vertices nearest to each position: (f,).

    The plane's slope is damped, so that it vanishes where the vertices do not show it.
    """
    k = min(NEAREST, len(vertices))
    nearest = PointGrid.of(vertices).nearest(places, k)
    near = vertices[nearest]
    centre = near.mean(axis=1)
    offset = near - centre[:, None]
    xy, z = offset[:, :, :2], offset[:, :, 2]
    normal = np.einsum("fki,fkj->fij", xy, xy) + DAMPING_M2 * np.eye(2)
    gradient = np.linalg.solve(normal, np.einsum("fki,fk->fi", xy, z)[:, :, None])[:, :, 0]
    height: NDArray[np.float64] = centre[:, 2] + ((places - centre[:, :2]) * gradient).sum(axis=1)
    return height


@njit()
def facet_fit(
    xyz: NDArray[np.float64],
    facet: NDArray[np.int32],
    plane: NDArray[np.float64],
    px: float,
    py: float,
    pz: float,
) -> tuple[float, float]:
    """Distance of a point to a facet's plane, and the largest angle from its corners.

    Parameters
    ----------
    xyz : (v, 3) float64
        Vertices [m].
    facet : (3,) int32
        Corners.
    plane : (3,) float64
        a, b, c of the facet, see :class:`~spl_batch.numerics.triangulation.tin.Tin`.
    px, py, pz : float
        Point [m].

    Returns
    -------
    distance : float
        Signed distance along the plane's normal, positive above it [m].
    sine : float
        Sine of the largest angle between the plane and the lines to the corners.
    """
    a, b = plane[0], plane[1]
    x0, y0 = xyz[facet[0], 0], xyz[facet[0], 1]
    distance = (pz - (plane[2] + a * (px - x0) + b * (py - y0))) / np.sqrt(1.0 + a * a + b * b)
    nearest = np.inf
    for k in range(3):
        dx = px - xyz[facet[k], 0]
        dy = py - xyz[facet[k], 1]
        dz = pz - xyz[facet[k], 2]
        nearest = min(nearest, dx * dx + dy * dy + dz * dz)
    if nearest == 0.0:
        return distance, 0.0
    return distance, abs(distance) / np.sqrt(nearest)


@njit()
def _mirrored_fit(
    xyz: NDArray[np.float64],
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    planes: NDArray[np.float64],
    t: int,
    point: NDArray[np.float64],
) -> tuple[float, float]:
    """Fit of the point's mirror image about the nearest corner of a steep facet."""
    nearest, near = np.inf, 0
    for k in range(3):
        v = facets[t, k]
        d = np.hypot(point[0] - xyz[v, 0], point[1] - xyz[v, 1])
        if d < nearest:
            nearest, near = d, v
    mx = 2 * xyz[near, 0] - point[0]
    my = 2 * xyz[near, 1] - point[1]
    mz = 2 * xyz[near, 2] - point[2]
    other, _ = locate_one(xyz, facets, neighbours, mx, my, t)
    if other < 0:
        return np.inf, np.inf
    return facet_fit(xyz, facets[other], planes[other], mx, my, mz)


@njit()
def _best_of_facets(
    xyz: NDArray[np.float64],
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    planes: NDArray[np.float64],
    candidates: NDArray[np.float64],
    floor: NDArray[np.float64],
    limits: Limits,
    best: NDArray[np.int64],
) -> None:
    """Fill ``best`` with each facet's lowest acceptable candidate, or -1."""
    lowest = np.full(len(facets), np.inf)
    t = 0
    for i in range(len(candidates)):
        found, t = locate_one(xyz, facets, neighbours, candidates[i, 0], candidates[i, 1], t)
        if found < 0:
            continue
        distance, sine = facet_fit(
            xyz, facets[t], planes[t], candidates[i, 0], candidates[i, 1], candidates[i, 2]
        )
        if abs(distance) < limits.insert_m or distance < floor[i]:
            continue
        slope2 = planes[t, 0] ** 2 + planes[t, 1] ** 2
        judged = distance
        if slope2 > limits.terrain_slope**2:
            judged, sine = _mirrored_fit(xyz, facets, neighbours, planes, t, candidates[i])
        if judged != 0.0:
            sine *= max(0.0, 1.0 - limits.spread_m / abs(judged))
        if abs(judged) <= limits.distance_m and sine <= limits.sin_angle and distance < lowest[t]:
            lowest[t] = distance
            best[t] = i


def heights_above(
    tin: Tin, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signed distance of points to a surface, along the facets' normals.

    Parameters
    ----------
    tin : Tin
        Surface.
    x, y, z : (n,) float64
        Points [m], near ones following each other.

    Returns
    -------
    distance : (n,) float64
        Distance [m], positive above; NaN outside the surface.
    edge : (n,) float64
        Shortest edge of the point's facet, horizontally [m].
    """
    facet = facets_at(tin, x, y)
    a, b, _ = tin.planes[facet].T
    distance = (z - facet_heights(tin, facet, x, y)) / np.sqrt(1.0 + a * a + b * b)
    corners = tin.xyz[tin.facets, :2]
    edge = np.hypot(*(corners - np.roll(corners, 1, axis=1)).transpose(2, 0, 1)).min(axis=1)[facet]
    distance[facet < 0], edge[facet < 0] = np.nan, np.nan
    return distance, edge
