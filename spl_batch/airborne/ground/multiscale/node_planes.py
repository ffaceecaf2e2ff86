"""Ground nodes about planes through those around: plants that passed for ground.

Plants raise the lowest return of a cell and never lower it, while rough soil scatters nodes to
both sides. Nodes are therefore fitted by planes that count what lies above them less, the more
the farther above [Kraus & Pfeifer 1998], and a node far above its plane stands on a plant, unless
it is the edge of a terrace, a dam or a crest: there the nodes of one side lie on a plane that goes
on to it. Nodes may scatter about their planes by what steep ground falls in a spacing of the
points; those of the plane of one side by no more than ranges do. How far the nodes that are left
lie off their planes is how rough the ground itself is.

What this gains on real tiles stands in ``docs/evidence/terrain.md``: of steep eucalypt forest, a
town with canals and a slope with plants.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.scales import (
    DEPTH_M,
    NEAREST,
    PLANE_M,
    SIDES,
    SIGMA_M,
    SPREADS,
    STEEP,
    TILT,
)
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.point_grid import PointGrid

FITS: Final = 3
"""Fits of planes, each weighted by the last one: with two, eucalypt forest is off by 7 cm more
[count]."""

LEAST: Final = 2.5
"""Weight that a half plane which goes on to a node needs at least: with 3 simulated native forest
is off by 13 cm more."""

RIDGE: Final = 0.005
"""Share of the scatter of positions that is added to it: where these nearly line up a plane is
level across the line."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Range = tuple[float, float]


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
        Those on their planes or below, and edges that the plane of one side goes on to [m].
    off : (m,) float64
        Heights above the planes through them, less what the slope gives in a spacing [m].
    """
    if len(nodes) <= NEAREST:
        return nodes, np.zeros(len(nodes))
    around = nearest_nodes(nodes)
    spread_m, drift_m = np.maximum(SIGMA_M, STEEP * point_m), point_m
    weight = np.ones(len(nodes))
    for _ in range(FITS):
        off = above_planes(nodes, around, weight, drift_m)
        weight = 1.0 / (1.0 + np.maximum(off / (0.5 * SPREADS * spread_m), 0.0) ** 4)
    far = np.flatnonzero(off > SPREADS * spread_m)
    kept = np.ones(len(nodes), dtype=np.bool_)
    kept[far] = goes_on(nodes, around, weight, drift_m, spread_m, far)
    off = above_planes(nodes, around, kept.astype(np.float64), drift_m)
    return nodes[kept], off[kept]


def under_planes(nodes: Float, filled: Mask, doubtful: Mask) -> Mask:
    """Nodes of few returns far below the plane of the ground around: (n,) bool.

    Noise that is left below a crown stands in for the ground among the lowest returns of a
    cell. It is compared with the nearest well-filled nodes, then, if many returns lie above it in
    its cell, with all that are left. Where single returns are all that there is, as in sparse
    surveys, none is judged.

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes of the ground [m].
    filled : (n,) bool
        Those of several returns in the lowest layer.
    doubtful : (n,) bool
        Those of one or two returns below many others in the same cell.
    """
    found = _far_below(nodes, filled, ~filled)
    return found | _far_below(nodes, ~found, doubtful & ~found)


def _far_below(nodes: Float, known: Mask, asked: Mask) -> Mask:
    """Nodes far below the plane of known ones around, for what these scatter about it."""
    out = np.zeros(len(nodes), np.bool_)
    index, judged = np.flatnonzero(known), np.flatnonzero(asked)
    if len(index) > NEAREST and len(judged):
        near = PointGrid.of(nodes[index]).nearest(nodes[judged], NEAREST)
        out[judged] = _below_planes(nodes, judged, index[near])
    return out


@njit()
def _below_planes(nodes: Float, judged: Index, around: Index) -> Mask:
    """Which nodes lie far below the planes of others: (m,) bool."""
    out, weight = np.empty(len(judged), np.bool_), np.empty(len(nodes))
    for i in range(len(nodes)):
        weight[i] = 1.0
    for k, i in enumerate(judged):
        weight[i] = 0.0
        counted, above, _, scatter = _plane(nodes, around[k], weight, i, 0.0, 0.0)
        weight[i] = 1.0
        out[k] = counted >= LEAST and -above > max(DEPTH_M, SPREADS * scatter)
    return out


def nearest_nodes(nodes: Float) -> Index:
    """Those nearest to each of more than :data:`NEAREST` nodes, itself first: (n, NEAREST + 1)."""
    return PointGrid.of(nodes).nearest(nodes, NEAREST + 1)


@njit()
def above_planes(nodes: Float, around: Index, weight: Float, drift_m: Float) -> Float:
    """Heights above the weighted planes through nodes and those around [m].

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes [m].
    around : (n, k) int64
        Those around each, itself among them.
    weight : (n,) float64
        Weights.
    drift_m : (n,) float64
        Heights are reduced by slope times this, to 0 at least, as a node may lie so far off [m].

    Returns
    -------
    (n,) float64
        Heights [m].
    """
    off = np.zeros(len(nodes))
    for i in range(len(nodes)):
        _, above, slope, _ = _plane(nodes, around[i], weight, i, 0.0, 0.0)
        drift = drift_m[i] * slope
        off[i] = above - min(max(above, -drift), drift)
    return off


@njit()
def slopes_around(nodes: Float, around: Index) -> Float:
    """Slopes of the planes through the other nodes around each [rise/run].

    Parameters
    ----------
    nodes, around
        As for :func:`above_planes`.
    """
    slopes, weight = np.empty(len(nodes)), np.ones(len(nodes))
    for i in range(len(nodes)):
        weight[i] = 0.0
        slopes[i] = _plane(nodes, around[i], weight, i, 0.0, 0.0)[2]
        weight[i] = 1.0
    return slopes


@njit()
def goes_on(
    nodes: Float, around: Index, weight: Float, drift_m: Float, spread_m: Float, asked: Index
) -> Mask:
    """Whether a plane through the nodes of one side goes on to a node, or above it.

    Parameters
    ----------
    nodes, around, weight, drift_m
        As for :func:`above_planes`.
    spread_m : (n,) float64
        Spread of nodes about their planes [m].
    asked : (m,) int64
        Which nodes.

    Returns
    -------
    (m,) bool
        Whether one of :data:`SIDES` does.
    """
    found = np.zeros(len(asked), dtype=np.bool_)
    for k, i in enumerate(asked):
        flat_m = SIGMA_M, TILT * drift_m[i]
        above_m = SPREADS * spread_m[i], 0.0
        found[k] = on_one_side(nodes, around[i], weight, i, above_m, flat_m, (0.0, np.inf), 0.0)
    return found


@njit()
def on_one_side(
    nodes: Float, around: Index, weight: Float, i: int,
    above_m: Range, scatter_m: Range, slopes: Range, wall_m: float,
) -> bool:  # fmt: skip
    """Whether a plane through the nodes of one side goes on to one node, or above it.

    Parameters
    ----------
    nodes, weight
        As for :func:`above_planes`.
    around : (k,) int64
        Nodes around this one.
    i : int
        The node.
    above_m, scatter_m : (float, float)
        How far it may lie above the plane, and those of the plane scatter about it: on level
        ground, and more for each unit of slope [m].
    slopes : (float, float)
        Least and largest slope of the plane [rise/run].
    wall_m : float
        Nor may it lie farther above the plane of the opposite side, where there is one, unless by
        so much: a shrub on a slope is above both, a crest above none, a rim far above one [m].
    """
    fits, denied = np.zeros(SIDES, np.bool_), np.zeros(SIDES, np.bool_)
    for side in range(SIDES):
        turn = 2.0 * np.pi * side / SIDES
        counted, above, slope, scatter = _plane(
            nodes, around, weight, i, np.cos(turn), np.sin(turn)
        )
        if counted >= LEAST and scatter <= scatter_m[0] + scatter_m[1] * slope:
            limit_m = above_m[0] + above_m[1] * slope
            fits[side] = above <= limit_m and slopes[0] <= slope <= slopes[1]
            denied[side - SIDES // 2] = limit_m < above < wall_m
    found = False
    for side in range(SIDES):
        found |= fits[side] and not denied[side]
    return bool(found)


@njit()
def _plane(
    nodes: Float, around: Index, weight: Float, i: int, east: float, north: float
) -> tuple[float, float, float, float]:
    """Weight, height of a node above the plane, slope and scatter; of one side without itself."""
    one_side = east != 0.0 or north != 0.0
    total, mx, my, mz, xx, xy, yy, xz, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in around:
        x, y, z = (
            nodes[j, 0] - nodes[i, 0],
            nodes[j, 1] - nodes[i, 1],
            nodes[j, 2] - nodes[i, 2],
        )
        if one_side and (j == i or x * east + y * north < 0.0):
            continue
        w = weight[j] * np.exp(-(x * x + y * y) / PLANE_M**2)
        total += w
        mx, my, mz = mx + w * x, my + w * y, mz + w * z
        xx, xy, yy = xx + w * x * x, xy + w * x * y, yy + w * y * y
        xz, yz, zz = xz + w * x * z, yz + w * y * z, zz + w * z * z
    if total < 1e-12:
        return 0.0, 0.0, 0.0, 0.0
    mx, my, mz = mx / total, my / total, mz / total
    xx, xy, yy = xx / total - mx * mx, xy / total - mx * my, yy / total - my * my
    xz, yz, zz = xz / total - mx * mz, yz / total - my * mz, zz / total - mz * mz
    ridge = RIDGE * (xx + yy) + 1e-6
    scale = (xx + ridge) * (yy + ridge) - xy * xy
    a, b = ((yy + ridge) * xz - xy * yz) / scale, ((xx + ridge) * yz - xy * xz) / scale
    scatter = np.sqrt(max(zz - a * xz - b * yz - ridge * (a * a + b * b), 0.0))
    return total, a * mx + b * my - mz, np.hypot(a, b), scatter
