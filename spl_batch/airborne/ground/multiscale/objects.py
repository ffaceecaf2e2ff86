"""Objects among nodes that pass for ground: sets whose outline steps down to the outside.

An opening leaves a few nodes on roofs, and what grows on from ground reaches decks and roofs as
well as crests, rims and terraces. What distinguishes them is their outline: a roof steps down all
round, a deck on its two long sides, and both go; a terrace steps down on one side, the surface goes
on to it on the others, and a hillside steps down as often as up: they stay.

Nodes are joined by a triangulation. Two of them are *linked* the more, the less one is above the
other, and step down from :data:`STEP_M` on, both beyond what the ground's slope gives between them;
a step counts by exp(-(distance / :data:`.PLANE_M`)^2).
Of all sets of nodes those are objects whose steps down, less those up and less the nodes that the
opening left, count for more than the links to all others, a step for :data:`SHARE` of a level link.
The set that gains most is a minimum cut [Greig, Porteous & Seheult 1989]: no patch has to be marked
off, no size to be set. Where objects are gone the nodes beside them have other neighbours: they are
looked at again, as far off as anything has changed for them, until nothing goes.

A rock or a spur with steps on three sides is taken for a roof.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from spl_batch.airborne.ground.multiscale.node_planes import nearest_nodes, slopes_around
from spl_batch.airborne.ground.scales import BLOCK_M, NEAREST, PLANE_M, SIDES, WALL_M
from spl_batch.numerics.neighbours.point_grid import PointGrid
from spl_batch.numerics.triangulation.tin import triangulate

STEP_M: Final = WALL_M / 2
"""So far one node lies below another at a step, beyond what the slope gives [m]."""

SHARE: Final = 0.55
"""A step down counts for so much of a level link, and so does each node that the opening left: with
0.5 a deck twice as long as wide stays, with 0.6 a rock of 30 m in ISPRS sample 53 goes."""

_UNITS: Final = np.iinfo(np.int8).max
"""A flow is of whole numbers: a level link holds so many, and all steps add up in 32 bits."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def objects(nodes: Float, opened: Mask) -> Mask:
    """Nodes of sets whose outline steps down to the outside: (n,) bool.

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes that pass for ground [m].
    opened : (n,) bool
        Those that an opening left.
    """
    out = np.zeros(len(nodes), np.bool_)
    look, stays = np.arange(len(nodes)), np.where(opened, SHARE, 0.0)
    while look.size > NEAREST:
        found = _cut_off(nodes[look], stays)
        if not found.any():
            break
        out[look[found]] = True
        look, stays = _around(nodes, opened, look[found], np.flatnonzero(~out))
    return out


def _around(nodes: Float, opened: Mask, gone: Index, left: Index) -> tuple[Index, Float]:
    """Nodes within a block's length of those just gone, and what speaks for each of them.

    Beyond half of it nothing has changed for them: more speaks for each than steps can outweigh.
    """
    nearest = PointGrid.of(nodes[gone]).nearest(nodes[left], 1)[:, 0]
    off_m = np.hypot(*(nodes[left] - nodes[gone[nearest]])[:, :2].T)
    near = off_m < BLOCK_M
    look, beyond = left[near], off_m[near] >= BLOCK_M / 2
    return look, np.where(beyond, SIDES, SHARE * opened[look])


def _cut_off(nodes: Float, stays: Float) -> Mask:
    """The set that gains most by being cut off from all other nodes: (n,) bool.

    ``stays``: (n,) float64, what speaks for each node, in level links.
    """
    out = np.zeros(len(nodes), np.bool_)
    upper, lower, level = neighbours(nodes)
    steps = level <= 0.0
    if not steps.any():
        return out
    along = np.hypot(*(nodes[upper[steps]] - nodes[lower[steps]])[:, :2].T)
    near = np.exp(-((along / PLANE_M) ** 2))
    down, up = (np.bincount(end[steps], near, len(nodes)) for end in (upper, lower))
    against, linked = SHARE * (down - up), ~steps
    one, other = upper[linked], lower[linked]
    every, source, sink = np.arange(len(nodes)), len(nodes), len(nodes) + 1
    graph = _whole(
        np.concatenate([one, other, np.full_like(every, source), every]),
        np.concatenate([other, one, every, np.full_like(every, sink)]),
        np.concatenate(
            [level[linked]] * 2 + [np.maximum(-against, 0.0) + stays, against.clip(0.0)]
        ),
    )
    left = csr_array(graph - maximum_flow(graph, source, sink).flow)
    left.eliminate_zeros()
    # What can still send a flow on to the sink lies on its side of the cut.
    beyond = breadth_first_order(csr_array(left.T), sink, return_predecessors=False)
    out[beyond[beyond < len(nodes)]] = True
    return out


def neighbours(nodes: Float) -> tuple[Index, Index, Float]:
    """Pairs of neighbours in a triangulation, and how level the way between them is.

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes [m]; n > :data:`.NEAREST`.

    Returns
    -------
    upper, lower : (m,) int64
        The higher and the lower one of each pair.
    level : (m,) float64
        1 where they are as high, 0 or less at a step [1].
    """
    tin = triangulate(nodes)
    if tin is None:
        nothing = np.empty(0, np.int64)
        return nothing, nothing, np.empty(0)
    once = tin.neighbours < np.arange(len(tin.facets))[:, None]  # one of two triangles, or the hull
    first, second = (np.roll(tin.facets, -k, axis=1)[once].astype(np.int64) for k in (1, 2))
    falls = nodes[first, 2] >= nodes[second, 2]
    upper, lower = np.where(falls, first, second), np.where(falls, second, first)
    east, north, up = (nodes[upper] - nodes[lower]).T
    slope = slopes_around(nodes, nearest_nodes(nodes))
    step_m = STEP_M + np.minimum(slope[upper], slope[lower]) * np.hypot(east, north)
    return upper, lower, 1.0 - up / step_m


def _whole(row: Index, column: Index, capacity: Float) -> csr_array:
    """Graph of what ways hold, in whole units."""
    units = np.rint(_UNITS * capacity).astype(np.int32)
    held, size = units > 0, int(max(row.max(), column.max())) + 1
    ends = row[held].astype(np.int32), column[held].astype(np.int32)
    return csr_array(coo_array((units[held], ends), shape=(size, size)))
