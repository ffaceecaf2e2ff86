"""Lowest layers of a point cloud on a grid: what ground filters start from.

A *node* is the mean of the lowest thin layer of points in a grid cell. Where a cell
holds one point the node is that point; where it holds forty returns of a 5 cm spread
the node is their mean, so that a surface through the nodes is not biased low, and a
single point that noise has left below the ground makes no node of its own weight.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.scales import BESIDE_M, CELL_M, DEPTH_M, EDGE_M, TILT
from spl_batch.constants import QUANTA_PER_M
from spl_batch.numerics.cell_groups import Cells
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import sort

SUPPORTED = 3
"""Points that make a layer trustworthy by itself [count]."""

_CROWDED = 10
"""Points in a cell from which on a layer of one or two is doubtful, and one that goes on is seen to
[count]."""

_SHEET_POINTS = 2 * SUPPORTED
_SHEET_M = EDGE_M / 2
"""A sheet is a hard surface, roof or bare ground: this many points in this thickness, as a
tilt of 35 degrees gives it in a cell of 1 m, and most of what lies between the node below it and
:data:`.EDGE_M` above it. Leaves fill twice the thickness, and do not pass."""

ENDS = 0.25
"""A layer ends if the next one, as thick, holds at most this share of its points: more in grass."""

_REACH = round(BESIDE_M / CELL_M)
"""Nodes up to so many cells off continue one if they lie within :data:`.DEPTH_M` and :data:`.TILT`
times their distance of it, and are with it as many as make a layer [edges]."""

Mask = NDArray[np.bool_]


class Nodes(NamedTuple):
    """Lowest layers, one or two for each occupied cell, row by row.

    Parameters
    ----------
    xyz : (m, 3) float64
        Mean of the layer's points [m].
    cell : (m,) int64
        Cell of the grid.
    points : (m,) int64
        Points in the layer, were it not thinned: where grass or a slope goes on above it, a few lie
        low, but more hold them up [count].
    doubtful : (m,) bool
        One or two points below many others in the same cell.
    buried : (m,) bool
        One or two points below a hard surface in the same cell: not ground, as light does
        not pass there, but what noise and afterpulses leave under meadows and roofs.
    """

    xyz: NDArray[np.float64]
    cell: NDArray[np.int64]
    points: NDArray[np.int64]
    doubtful: NDArray[np.bool_]
    buried: NDArray[np.bool_]


def lowest_layers(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    cells: Cells,
    thickness_m: float | NDArray[np.float64],
    *,
    thinnest: float = 1.0,
) -> Nodes:
    """Nodes of a cloud: the lowest layer of each cell, and the lowest well-filled one.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m], on the lattice of quanta.
    cells : Cells
        The same points, grouped.
    thickness_m : float or (cells,) float64
        Thickness of a layer, or that of each cell [m].
    thinnest : float
        Share of it that a layer has which does not end there, as in grass, where cells are full
        enough to show it.
    """
    most = 2 * len(cells.start)
    thick = np.full(len(cells.start) - 1, thickness_m)
    xyz, cell = np.empty((most, 3)), np.empty(most, dtype=np.int64)
    count, doubtful = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.bool_)
    buried = np.empty(most, dtype=np.bool_)
    used = _lowest_layers(
        x, y, z, cells.order, cells.start, thick, thinnest, xyz, cell, count, doubtful, buried
    )
    return Nodes(xyz[:used], cell[:used], count[:used], doubtful[:used], buried[:used])


@njit()
def _lowest_layers(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    order: NDArray[np.int64],
    start: NDArray[np.int64],
    thick: NDArray[np.float64],
    thinnest: float,
    xyz: NDArray[np.float64],
    cell: NDArray[np.int64],
    count: NDArray[np.int64],
    doubtful: NDArray[np.bool_],
    buried: NDArray[np.bool_],
) -> int:
    used = most = 0
    for c in range(len(start) - 1):
        most = max(most, start[c + 1] - start[c])
    # A cell's points lie far apart in memory, and are looked at several times.
    room, sorted_z = np.empty((3, most)), np.empty(most)
    for c in range(len(start) - 1):
        n = start[c + 1] - start[c]
        if n == 0:
            continue
        own, heights, thickness = room[:, :n], sorted_z[:n], thick[c]
        low = np.inf
        for k in range(n):
            i = order[start[c] + k]
            own[0, k], own[1, k], own[2, k] = x[i], y[i], z[i]
            low = min(low, z[i])
        first, filled = 0, -1
        # Most cells have their lowest layer filled, and heights need no order.
        if not _is_filled(own[2], low, thickness):
            _sort_heights(own[2], heights)
            first, filled = _two_layers(heights, thickness)
        for bottom in (first, filled):
            if bottom < 0:
                continue
            low = heights[bottom] if bottom > 0 else low
            count[used] = thin = _layer_mean(own, low, thickness, xyz[used])
            if n >= _CROWDED and not _ends(own[2], low, thickness):
                thin = _layer_mean(own, low, thinnest * thickness, xyz[used])
            cell[used] = c
            doubtful[used] = n >= _CROWDED and thin < SUPPORTED
            buried[used] = False
            if thin < SUPPORTED:
                _sort_heights(own[2], heights)
                buried[used] = _below_sheet(heights, bottom + thin)
            used += 1
    return used


@njit()
def _sort_heights(z: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Fill with increasing heights."""
    for k in range(len(z)):
        out[k] = z[k]
    sort(out)


@njit()
def _is_filled(z: NDArray[np.float64], low: float, thickness: float) -> bool:
    """Whether the layer above the lowest height has enough points."""
    held = 0
    for k in range(len(z)):
        held += z[k] - low <= thickness
    return held >= min(SUPPORTED, len(z))


@njit()
def _ends(z: NDArray[np.float64], low: float, thickness: float) -> bool:
    """Whether few points lie right above the layer on a height."""
    once = twice = 0
    for k in range(len(z)):
        once += low <= z[k] <= low + thickness
        twice += low + thickness < z[k] <= low + 2.0 * thickness
    return twice <= ENDS * once


@njit()
def _two_layers(heights: NDArray[np.float64], thickness: float) -> tuple[int, int]:
    """Bottom of the lowest layer, and of a higher one with enough points (or -1)."""
    n = len(heights)
    need = min(SUPPORTED, n)
    for i in range(n - need + 1):
        if heights[i + need - 1] - heights[i] <= thickness:
            return (0, i) if i > 0 else (0, -1)
    return 0, -1


@njit()
def _below_sheet(heights: NDArray[np.float64], first: int) -> bool:
    """Whether a hard surface stands in a cell above its lowest ``first`` points."""
    end, clear = first, first
    for i in range(first, len(heights) - _SHEET_POINTS + 1):
        while end < len(heights) and heights[end] <= heights[i] + _SHEET_M:
            end += 1
        if end - i < _SHEET_POINTS:
            continue
        while clear < len(heights) and heights[clear] <= heights[i] + _SHEET_M + EDGE_M:
            clear += 1
        if end - i >= (1.0 - ENDS) * (clear - first):
            return True
    return False


@njit()
def _layer_mean(
    own: NDArray[np.float64], low: float, thickness: float, out: NDArray[np.float64]
) -> int:
    """Mean of the layer above ``low``, then of the layer around that mean; its count.

    Whole quanta are added up: exactly, in whatever order they come.
    """
    bottom = low
    n = 0
    for _ in range(2):
        sx, sy, sz, n = 0.0, 0.0, 0.0, 0
        for k in range(own.shape[1]):
            if bottom <= own[2, k] <= bottom + thickness:
                sx += np.rint(own[0, k] * QUANTA_PER_M)
                sy += np.rint(own[1, k] * QUANTA_PER_M)
                sz += np.rint(own[2, k] * QUANTA_PER_M)
                n += 1
        per_m = n * QUANTA_PER_M
        out[0], out[1], out[2] = sx / per_m, sy / per_m, sz / per_m
        bottom = out[2] - thickness / 2
    return n


def continued(nodes: Nodes, cells: Cells, cell_m: float) -> Mask:
    """Nodes that others around continue, as those along the contour do on any slope: (m,) bool.

    Parameters
    ----------
    nodes : Nodes
        All nodes, in order of their cells.
    cells : Cells
        The grid.
    cell_m : float
        Edge of a cell [m].
    """
    first = np.searchsorted(nodes.cell, np.arange(cells.rows * cells.columns + 1))
    out = np.empty(len(nodes.cell), np.bool_)
    _continued(nodes.xyz, nodes.cell, first, (cells.rows, cells.columns), cell_m, out)
    return out


@njit()
def _continued(
    xyz: NDArray[np.float64], cell: NDArray[np.int64], first: NDArray[np.int64],
    grid: tuple[int, int], cell_m: float, out: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Fill; ``first``: the first node of each cell."""
    rows, columns = grid
    for i in range(len(cell)):
        r, c, count = cell[i] // columns, cell[i] % columns, 0
        for rr in range(max(r - _REACH, 0), min(r + _REACH + 1, rows)):
            for cc in range(max(c - _REACH, 0), min(c + _REACH + 1, columns)):
                other = rr * columns + cc
                if other == cell[i]:
                    continue
                for j in range(first[other], first[other + 1]):
                    d = np.sqrt((xyz[j, 0] - xyz[i, 0]) ** 2 + (xyz[j, 1] - xyz[i, 1]) ** 2)
                    if d <= _REACH * cell_m:
                        count += abs(xyz[j, 2] - xyz[i, 2]) <= DEPTH_M + TILT * d
        out[i] = count + 1 >= SUPPORTED
