"""Linear interpolation on a Delaunay triangulation, at the centres of raster cells.

The evaluation walks triangles, not queries, because a raster asks for every centre inside
every triangle once. Rows count from the south.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.point_grid import PointGrid
from spl_batch.numerics.triangulation.delaunay import triangles

RIM = 1.5
"""So far from the centre of a cell outside the triangles a vertex lends its height [cells]."""

SPACINGS = 15.0
"""Longest edge at the rim of the triangles, by default [median of all edges]."""


@njit()
def paint_triangles(
    vertices: NDArray[np.float64],
    simplices: NDArray[np.int32],
    size: float,
    out: NDArray[np.float64],
) -> None:
    """Write the plane through each triangle into the cells whose centres it holds.

    A centre on a shared edge takes the triangle that comes first; both give the same
    height there.

    Parameters
    ----------
    vertices : (m, 3) float64
        x, y, z relative to the raster's south-west corner [any one unit].
    simplices : (t, 3) int32
        Vertices of each triangle.
    size : float
        Edge of a raster cell [unit of the vertices].
    out : (rows, cols) float64, written
        Heights; cells outside every triangle keep what they hold, which must be NaN.
    """
    rows, cols = out.shape
    for t in range(len(simplices)):
        a, b, c = vertices[simplices[t, 0]], vertices[simplices[t, 1]], vertices[simplices[t, 2]]
        ux, uy, wx, wy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
        area = ux * wy - uy * wx
        if area == 0.0:
            continue
        first_row = max(int(np.ceil(min(a[1], b[1], c[1]) / size - 0.5)), 0)
        last_row = min(int(np.floor(max(a[1], b[1], c[1]) / size - 0.5)), rows - 1)
        first_col = max(int(np.ceil(min(a[0], b[0], c[0]) / size - 0.5)), 0)
        last_col = min(int(np.floor(max(a[0], b[0], c[0]) / size - 0.5)), cols - 1)
        for row in range(first_row, last_row + 1):
            py = (row + 0.5) * size - a[1]
            for col in range(first_col, last_col + 1):
                px = (col + 0.5) * size - a[0]
                wb = (px * wy - py * wx) / area
                wc = (ux * py - uy * px) / area
                # The tolerance keeps a centre on an edge from falling between two triangles.
                if min(wb, wc, 1.0 - wb - wc) >= -1e-9 and np.isnan(out[row, col]):
                    out[row, col] = a[2] + wb * (b[2] - a[2]) + wc * (c[2] - a[2])


def tin_raster(
    vertices: NDArray[np.float64],
    size: float,
    shape: tuple[int, int],
    reach: float,
    longest: float | None = math.inf,
    margin: float = 0.0,
) -> NDArray[np.float64]:
    """Raster of the TIN through some vertices, empty where they are too far.

    Parameters
    ----------
    vertices : (m, 3) float64
        x, y, z relative to the raster's south-west corner; they may lie outside of it.
    size : float
        Edge of a raster cell [unit of the vertices].
    shape : (int, int)
        Rows and columns.
    reach : float
        A centre farther than this from every vertex stays empty [unit of the vertices].
    longest : float, optional
        Triangles that the outside reaches over edges longer than this span no ground [unit of the
        vertices]; None for :data:`SPACINGS` times the median edge.
    margin : float
        How far around the raster vertices are known [unit of the vertices]: beyond, ground may go
        on, so that nothing is open along that border.

    Returns
    -------
    (rows, cols) float64
        Linear interpolation at cell centres. Outside the triangles (the rim of the survey,
        vertices on one line) the nearest vertex within :data:`RIM` cells lends its height. NaN
        elsewhere and beyond ``reach``.
    """
    out = np.full(shape, np.nan)
    if len(vertices) == 0:
        return out
    facets, neighbours = triangles(vertices[:, :2])
    if longest is None or longest < math.inf:
        corners = vertices[facets, :2]
        edges = np.linalg.norm(corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]], axis=2)
        if longest is None:
            longest = SPACINGS * float(np.median(edges)) if len(edges) else 0.0
        low, high = (
            vertices[:, :2] + margin,
            np.array(shape[::-1]) * size + margin - vertices[:, :2],
        )
        beside = np.hstack([low, high]) <= min(longest, margin)
        facets = facets[_enclosed(facets, neighbours, edges > longest, beside)]
    paint_triangles(vertices, facets, size, out)
    cells = np.floor(vertices[:, :2] / size).astype(np.int64)
    occupied = _held_near(cells, shape, 0)
    # Only where it may lie too far, or near enough to lend its height, a vertex is searched for.
    surely_near = int(min(max(reach / (math.sqrt(2.0) * size) - 0.5, 0.0), max(shape)))
    rim = np.isnan(out) & _held_near(cells, shape, math.floor(RIM + 0.5))
    asked = np.argwhere(rim | ~(np.isnan(out) | occupied | _held_near(cells, shape, surely_near)))
    if not len(asked):
        return out
    centres = (asked[:, ::-1] + 0.5) * size
    nearest = PointGrid.of(vertices).nearest(centres)[:, 0]
    distance = np.sqrt(((vertices[nearest, :2] - centres) ** 2).sum(axis=1))
    r, c = asked[:, 0], asked[:, 1]
    lent = np.isnan(out[r, c]) & (distance <= RIM * size)
    out[r[lent], c[lent]] = vertices[nearest[lent], 2]
    far = (distance > reach) & ~occupied[r, c]
    out[r[far], c[far]] = np.nan
    return out


@njit()
def _enclosed(
    facets: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    wide: NDArray[np.bool_],
    beside: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Triangles that the outside does not reach over wide edges: (t,).

    ``wide``: (t, 3), edges across from each corner; ``beside``: (m, 4), vertices along each border.
    """
    kept = np.empty(len(facets), np.bool_)
    asked = np.empty(4 * len(facets), np.int64)
    n = 0
    for t in range(len(facets)):
        kept[t] = True
        if neighbours[t, 0] < 0 or neighbours[t, 1] < 0 or neighbours[t, 2] < 0:
            asked[n] = t
            n += 1
    while n:
        n -= 1
        t = asked[n]
        for k in range(3):
            across = neighbours[t, k]
            if not kept[t] or not wide[t, k] or (across >= 0 and kept[across]):
                continue
            a, b = facets[t, (k + 1) % 3], facets[t, (k + 2) % 3]
            kept[t] = False
            for border in range(4):
                kept[t] |= across < 0 and beside[a, border] and beside[b, border]
            for side in range(3):
                near = neighbours[t, side]
                if not kept[t] and near >= 0 and kept[near]:
                    asked[n] = near
                    n += 1
    return kept


def _held_near(cells: NDArray[np.int64], shape: tuple[int, int], reach: int) -> NDArray[np.bool_]:
    """Cells with a vertex in themselves or up to ``reach`` cells away along both axes.

    ``cells``, (m, 2), column and row of each vertex's cell, may lie outside the raster.
    """
    col, row = (cells + reach).T
    rows, cols = (side + 2 * reach for side in shape)
    held = np.zeros((rows, cols), np.uint8)
    within = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    held[row[within], col[within]] = 1
    if reach:
        for axis in (0, 1):
            held = ndimage.maximum_filter1d(held, 2 * reach + 1, axis=axis, mode="constant")
        held = held[reach : rows - reach, reach : cols - reach]
    return held.astype(np.bool_)
