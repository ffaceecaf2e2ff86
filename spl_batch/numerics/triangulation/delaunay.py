r"""Delaunay triangulation that grows: vertices come in batches, each is put in once.

Incremental insertion after [Lawson 1977]: a vertex splits the triangle that holds it, or the
two beside the edge that does, and edges are turned until no circle through a triangle's
corners holds another vertex. Beyond each edge of the hull lies a triangle with the vertex
:data:`GHOST` at infinity; its circle is the half-plane outside, so the hull grows by the same
rules. Triangles are found by walking from the last one, which is near when vertices come in
the order of :func:`along_curve`.

Qhull, by way of scipy, gives the same triangles, but starts anew for each batch.

On which side of an edge a point lies is asked of points on a lattice of :data:`_LATTICE`
steps across the extent, where the answer is exact: no triangle is turned over. Whether it lies
in a circle is asked of the points themselves. Where rounding could decide - four corners of a
square - the edge that is there stays: which of two equally good triangulations is found depends
on the order of insertion.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

GHOST = -1
"""Corner at infinity."""

_LATTICE = 2.0**29
"""Steps of the lattice across the extent: products of two differences fit into 64 bits."""

_SURE = 1.2e-15
"""Rounding error of the test for a circle, as a share of the sum of its terms' sizes
[Shewchuk 1997, bound A: (10 + 96 u) u with u = 2**-53]."""


class Mesh(NamedTuple):
    """Triangles, those at infinity among them, with room for all vertices."""

    xy: NDArray[np.float64]  #: (v, 2): coordinates, from the lower left corner of all.
    #: (v,): the same on the lattice.
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    #: (2 v, 3): vertices of each triangle, counter-clockwise; :data:`GHOST` for the one at
    #: infinity.
    corner: NDArray[np.int32]
    across: NDArray[np.int32]  #: (2 v, 3): triangle across from each corner.
    #: (2,): number of triangles, 0 as long as no three vertices span an area; the last one made.
    state: NDArray[np.int64]


def empty_mesh(xy: NDArray[np.float64]) -> Mesh:
    """Mesh without triangles for vertices at some positions.

    ``xy``: (v, 2) float64, positions of all vertices that will ever come [any one unit].
    """
    xy = xy - xy.min(axis=0)
    extent = max(float(xy.max()), 1e-100)
    steps = np.rint(xy * (_LATTICE / 2.0 ** np.ceil(np.log2(extent)))).astype(np.int64)
    room = 2 * len(xy) + 4
    return Mesh(
        xy,
        np.ascontiguousarray(steps[:, 0]),
        np.ascontiguousarray(steps[:, 1]),
        np.empty((room, 3), np.int32),
        np.empty((room, 3), np.int32),
        np.zeros(2, np.int64),
    )


def along_curve(mesh: Mesh, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Vertices in Morton's order: near ones mostly follow each other.

    ``chosen``: (n,) intp, vertices.
    """
    key = _spread_bits(mesh.x[chosen]) | _spread_bits(mesh.y[chosen]) << np.uint64(1)
    return chosen[np.argsort(key, kind="stable")]


def _spread_bits(values: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Bits of numbers below 2**32 at the even positions: (n,) uint64."""
    v = values.astype(np.uint64)
    for shift in (16, 8, 4, 2, 1):
        v |= v << np.uint64(shift)
        v &= np.uint64((2**64 - 1) // (2**shift + 1))
    return v


def insert(mesh: Mesh, chosen: NDArray[np.intp]) -> None:
    """Put vertices in, in the order given.

    Parameters
    ----------
    chosen : (n,) intp
        Vertices that are not in it yet. One at the position of another is left out, and so are
        all as long as they lie on one line: give these again with the next ones.
    """
    if mesh.state[0] == 0 and not _first_triangle(mesh, chosen):
        return
    _insert(mesh.xy, mesh.x, mesh.y, mesh.corner, mesh.across, mesh.state, chosen)


def finite(mesh: Mesh) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Triangles without those at infinity.

    Returns
    -------
    facets : (t, 3) int32
        Vertices of each, counter-clockwise.
    neighbours : (t, 3) int32
        Triangle across from each corner; -1 at the hull.
    """
    used = int(mesh.state[0])
    inner = (mesh.corner[:used] != GHOST).all(axis=1)
    number = np.full(used, -1, np.int32)
    number[inner] = np.arange(np.count_nonzero(inner), dtype=np.int32)
    return mesh.corner[:used][inner], number[mesh.across[:used][inner]]


def triangles(xy: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Delaunay triangles of some points; none where they span no area.

    Parameters
    ----------
    xy : (v, 2) float64
        Points, all different [any one unit].

    Returns
    -------
    facets, neighbours : (t, 3) int32
        As :func:`finite` gives them.
    """
    if len(xy) < 3:
        return np.empty((0, 3), np.int32), np.empty((0, 3), np.int32)
    mesh = empty_mesh(xy)
    insert(mesh, along_curve(mesh, np.arange(len(xy))))
    return finite(mesh)


def _first_triangle(mesh: Mesh, chosen: NDArray[np.intp]) -> bool:
    """Make a triangle of the first of the vertices that span one, with the ghosts around it."""
    x, y = mesh.x[chosen], mesh.y[chosen]
    apart = np.flatnonzero((x != x[:1]) | (y != y[:1]))
    if not len(apart):
        return False
    second = apart[0]
    side = (x[second] - x[0]) * (y - y[0]) - (y[second] - y[0]) * (x - x[0])
    beside = np.flatnonzero(side)
    if not len(beside):
        return False
    third = beside[0]
    a, b, c = chosen[[0, second, third]].tolist()
    if side[third] < 0:
        b, c = c, b
    mesh.corner[:4] = [[a, b, c], [c, b, GHOST], [a, c, GHOST], [b, a, GHOST]]
    mesh.across[:4] = [[1, 2, 3], [3, 2, 0], [1, 3, 0], [2, 1, 0]]
    mesh.state[:] = 4, 0
    return True


@njit(inline="always")
def _side(x: NDArray[np.int64], y: NDArray[np.int64], a: int, b: int, p: int) -> int:
    """Twice the signed area of a, b, p, exactly: positive where p is to the left of a -> b."""
    return int((x[b] - x[a]) * (y[p] - y[a]) - (y[b] - y[a]) * (x[p] - x[a]))


@njit()
def _locate(
    x: NDArray[np.int64], y: NDArray[np.int64], corner: NDArray[np.int32],
    across: NDArray[np.int32], used: int, start: int, p: int,
) -> tuple[int, int]:  # fmt: skip
    """Triangle that holds a point, and the corner across from the edge that does.

    The triangle is one at infinity for a point outside the hull. The corner is -1 for a point
    within the triangle, -2 for one at a corner.
    """
    t = start
    for k in range(3):
        if corner[start, k] == GHOST:
            t = across[start, k]
    before = -1
    for step in range(used):
        edge, beyond = -1, -1
        for turn in range(3):
            k = (step + turn) % 3
            if across[t, k] == before:
                continue
            side = _side(x, y, corner[t, (k + 1) % 3], corner[t, (k + 2) % 3], p)
            if side < 0:
                beyond = across[t, k]
                break
            if side == 0:
                edge = k if edge == -1 else -2
        if beyond < 0:
            return t, edge
        before, t = t, beyond
        if corner[t, 0] == GHOST or corner[t, 1] == GHOST or corner[t, 2] == GHOST:
            return t, -1
    return _search(x, y, corner, used, p)


@njit()
def _search(
    x: NDArray[np.int64], y: NDArray[np.int64], corner: NDArray[np.int32], used: int, p: int
) -> tuple[int, int]:
    """The same by looking everywhere, should a walk go round for ever."""
    for t in range(used):
        edge, holds = -1, True
        for k in range(3):
            a, b = corner[t, (k + 1) % 3], corner[t, (k + 2) % 3]
            if min(a, b) == GHOST:
                continue
            side = _side(x, y, a, b, p)
            at_infinity = corner[t, k] == GHOST
            holds = bool(holds and (side > 0 or (side == 0 and not at_infinity)))
            if side == 0 and not at_infinity:
                edge = k if edge == -1 else -2
        if holds:
            return t, edge
    return 0, -2


@njit(inline="always")
def _slot(table: NDArray[np.int32], t: int, of: int) -> int:
    """Corner of a triangle where a vertex is, or across from which another triangle lies."""
    if table[t, 0] == of:
        return 0
    return 1 if table[t, 1] == of else 2


@njit()
def _insert(
    xy: NDArray[np.float64], x: NDArray[np.int64], y: NDArray[np.int64],
    corner: NDArray[np.int32], across: NDArray[np.int32], state: NDArray[np.int64],
    chosen: NDArray[np.intp],
) -> None:  # fmt: skip
    used, last = int(state[0]), int(state[1])
    stack = np.empty(len(corner) + 8, np.int32)
    rim, outer, made = np.empty(4, np.int32), np.empty(4, np.int32), np.empty(4, np.int32)
    for i in range(len(chosen)):
        p = int(chosen[i])
        t, edge = _locate(x, y, corner, across, used, last, p)
        if edge == -2:
            continue
        # The rim is what lies around p, counter-clockwise; made[k] lies behind its k-th edge.
        count = 0
        if edge == -1:
            for k in range(3):
                rim[k], outer[k] = corner[t, k], across[t, (k + 2) % 3]
            made[0], made[1], made[2] = t, used, used + 1
            count, used = 3, used + 2
        else:
            n = across[t, edge]
            j = _slot(across, n, t)
            rim[0], rim[1] = corner[t, (edge + 1) % 3], corner[n, j]
            rim[2], rim[3] = corner[t, (edge + 2) % 3], corner[t, edge]
            outer[0], outer[1] = across[n, (j + 1) % 3], across[n, (j + 2) % 3]
            outer[2], outer[3] = across[t, (edge + 1) % 3], across[t, (edge + 2) % 3]
            made[0], made[1], made[2], made[3] = t, n, used, used + 1
            count, used = 4, used + 2
        # Triangles from p, their last corner, to each edge of the rim.
        for k in range(count):
            beyond, new = int(outer[k]), made[k]
            # Across from the edge that ends at a corner of the rim lies the next one.
            across[beyond, (_slot(corner, beyond, int(rim[k])) + 1) % 3] = new
            corner[new, 0], corner[new, 1], corner[new, 2] = rim[k], rim[(k + 1) % count], p
            across[new, 0], across[new, 1] = made[(k + 1) % count], made[(k + count - 1) % count]
            across[new, 2] = beyond
            stack[k] = new
        last = _turn_edges(xy, x, y, corner, across, stack, count)
    state[0], state[1] = used, last


@njit()
def _wrong(
    xy: NDArray[np.float64], x: NDArray[np.int64], y: NDArray[np.int64],
    u: int, v: int, p: int, w: int,
) -> bool:  # fmt: skip
    """Whether the edge u, v between p and w has to turn: p surely lies in the circle of w, v, u."""
    if u == GHOST:
        return _side(x, y, w, v, p) > 0
    if v == GHOST:
        return _side(x, y, u, w, p) > 0
    if w == GHOST:
        return False
    ax, ay = xy[w, 0] - xy[p, 0], xy[w, 1] - xy[p, 1]
    bx, by = xy[v, 0] - xy[p, 0], xy[v, 1] - xy[p, 1]
    cx, cy = xy[u, 0] - xy[p, 0], xy[u, 1] - xy[p, 1]
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    bc, cb, ca, ac, ab, ba = bx * cy, cx * by, cx * ay, ax * cy, ax * by, bx * ay
    size = (abs(bc) + abs(cb)) * a2 + (abs(ca) + abs(ac)) * b2 + (abs(ab) + abs(ba)) * c2
    surely_in = a2 * (bc - cb) + b2 * (ca - ac) + c2 * (ab - ba) > _SURE * size
    return surely_in and _side(x, y, u, w, p) > 0 and _side(x, y, w, v, p) > 0


@njit()
def _turn_edges(
    xy: NDArray[np.float64], x: NDArray[np.int64], y: NDArray[np.int64],
    corner: NDArray[np.int32], across: NDArray[np.int32], stack: NDArray[np.int32], count: int,
) -> int:  # fmt: skip
    """Turn edges across from a new vertex until all are right; gives a triangle beside it.

    Each turn gives that vertex one more edge and takes none away, so there is an end.
    """
    t = int(stack[0])
    while count:
        count -= 1
        t = int(stack[count])
        n = int(across[t, 2])
        j = _slot(across, n, t)
        u, v, p, w = corner[t, 0], corner[t, 1], corner[t, 2], corner[n, j]
        if not _wrong(xy, x, y, u, v, p, w):
            continue
        # t = (u, v, p) and n = (w, v, u) become (u, w, p) and (w, v, p).
        behind_uw, behind_wv = across[n, (j + 1) % 3], across[n, (j + 2) % 3]
        behind_vp = across[t, 0]
        corner[t, 1] = w
        corner[n, 0], corner[n, 1], corner[n, 2] = w, v, p
        across[behind_uw, (_slot(corner, behind_uw, u) + 1) % 3] = t
        across[behind_vp, (_slot(corner, behind_vp, v) + 1) % 3] = n
        across[t, 0], across[t, 2] = n, behind_uw
        across[n, 0], across[n, 1], across[n, 2] = behind_vp, t, behind_wv
        stack[count], stack[count + 1] = t, n
        count += 2
    return t
