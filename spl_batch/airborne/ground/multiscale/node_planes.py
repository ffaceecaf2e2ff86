"""Ground nodes about planes through those around: plants that passed for ground, and rough soil.

Plants raise the lowest return of a cell and never lower it, while rough soil scatters nodes to
both sides. Nodes are therefore fitted by planes that count what lies above them less, the more
the farther above [Kraus & Pfeifer 1998], and a node far above its plane stands on a plant. How far
those that are left lie below theirs is how rough the ground itself is, by which the layer of its
returns is as thick as it has to be.

On ten tiles of towns and forests that their producers classified, the RMSE of steep eucalypt
forest falls from 0.43 to 0.28 m and that of a town from 0.137 to 0.106 m; of rough soil 94 % is
found where a layer as thick as ranging noise finds 77 %.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.near_surface import SLOPE_M
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.triangulation.delaunay import triangles

REACH_M: Final = 6.0
RINGS: Final = 2
"""A plane is fitted to so many rings of neighbours, of which those beyond a distance count little
[m, count]."""

FITS: Final = 3
"""Fits of planes, each weighted by the last one [count]."""

HALF_WEIGHT: Final = 1.5
ABOVE: Final = 3.0
"""A node so many spreads above its plane counts half, and one so many above is no ground."""

SPREAD_M: Final = 0.05
SPREAD: Final = 0.7
"""Least spread of nodes about their planes [m], and that in spacings of the points."""

RIDGE: Final = 0.02
"""Share of the scatter of places that is added to it: where these nearly line up a plane is level
across the line."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


def without_plants(nodes: Float, point_m: Float) -> tuple[Float, Float]:
    """Nodes of the ground without those that stand on plants.

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes [m].
    point_m : (n,) float64
        Spacing of the points that they are the lowest of [m].

    Returns
    -------
    nodes : (m, 3) float64
        Those that lie on their planes, or below [m].
    off : (m,) float64
        Heights above the planes through them, less what the slope gives in a spacing [m].
    """
    edges = _edges(nodes)
    if not len(edges):
        return nodes, np.zeros(len(nodes))
    spread_m, drift_m = np.maximum(SPREAD_M, SPREAD * point_m), np.minimum(point_m, SLOPE_M)
    weight = np.ones(len(nodes))
    for fit in range(FITS + 1):
        off, planes = off_planes(nodes, edges, weight)
        drift = drift_m * np.hypot(*planes.T)
        off -= np.clip(off, -drift, drift)
        if fit == FITS:
            break
        kept = _continued(nodes, edges, planes, off <= ABOVE * spread_m, spread_m)
        above = np.maximum(off / (HALF_WEIGHT * spread_m), 0.0)
        weight = 1.0 / (1.0 + above**4) if fit < FITS - 1 else kept.astype(np.float64)
    return nodes[kept], off[kept]


def _continued(
    nodes: Float, edges: NDArray[np.int32], planes: Float, kept: Mask, spread_m: Float
) -> Mask:
    """Nodes no higher than the plane of a kept neighbour goes on to them: crests and edges."""
    found = kept.copy()
    for one, other in (edges.T, edges.T[::-1]):
        along = nodes[one] - nodes[other]
        rise = planes[other, 0] * along[:, 0] + planes[other, 1] * along[:, 1]
        goes_on = kept[other] & (along[:, 2] - rise <= spread_m[one])
        np.logical_or.at(found, one, goes_on)
    return found


def _edges(nodes: Float) -> NDArray[np.int32]:
    """Edges of the TIN, each once: (e, 2); none where places span no area."""
    facets, neighbours = triangles(nodes[:, :2])
    once = neighbours < np.arange(len(facets), dtype=np.int32)[:, np.newaxis]
    ends = np.stack([np.roll(facets, -1, axis=1), np.roll(facets, -2, axis=1)], axis=-1)
    edges: NDArray[np.int32] = ends[once]
    return edges


def off_planes(nodes: Float, edges: NDArray[np.int32], weight: Float) -> tuple[Float, Float]:
    """Heights above the weighted planes through rings of neighbours [m], and their slopes.

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes [m].
    edges : (e, 2) int32
        Which of them are neighbours.
    weight : (n,) float64
        Weights; that of a neighbour is times those of the paths of :data:`RINGS` edges to it.

    Returns
    -------
    off : (n,) float64
        Heights [m].
    planes : (n, 2) float64
        Their rise to east and north [rise/run].
    """
    x, y, z = (nodes - nodes[:1]).T
    now = np.stack([v * weight for v in (x**0, x, y, z, x * x, x * y, y * y, x * z, y * z)], 1)
    length_m = np.hypot(*(nodes[edges[:, 0], :2] - nodes[edges[:, 1], :2]).T)
    near = np.exp(-((length_m / REACH_M) ** 2))
    for _ in range(RINGS):
        then = now.copy()
        _add_neighbours(edges, near, now, then)
        now = then
    w, mx, my, mz, xx, xy, yy, xz, yz = now.T
    w = np.maximum(w, 1e-12)
    mx, my, mz = mx / w, my / w, mz / w
    xx, xy, yy = xx / w - mx * mx, xy / w - mx * my, yy / w - my * my
    xz, yz = xz / w - mx * mz, yz / w - my * mz
    ridge = RIDGE * (xx + yy) + 1e-6
    xx, yy = xx + ridge, yy + ridge
    scale = xx * yy - xy * xy
    east, north = (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale
    return z - mz - east * (x - mx) - north * (y - my), np.column_stack([east, north])


@njit()
def _add_neighbours(edges: NDArray[np.int32], near: Float, now: Float, out: Float) -> None:
    """Add the sums of all neighbours, by how near they are."""
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        for k in range(now.shape[1]):
            out[i, k] += near[e] * now[j, k]
            out[j, k] += near[e] * now[i, k]
