"""Trend of the ground: how high it lies, and so how it tilts, within some metres.

What tells ground from crowns and roofs are differences of height between neighbours. On a slope
of 60 degrees the ground itself rises by 1.7 m from one metre to the next, more than a shrub does:
there such rules see nothing. Heights above a trend are those above a level ground. Pingel, Clarke
and McBride 2013 leave the slope to a parameter of the whole survey, Zhang and Lin 2013 segment
smooth surfaces before they densify: both for the same reason.

At each node of an absolute lattice a plane is fitted to the nodes of the ground around, near ones
counting most; between them heights are bilinear. The reach is bounded, so that neighbouring
ground cells agree.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.scales import DAMPING_M2, PLANE_M, WIDE_M
from spl_batch.airborne.ground.smrf import fill_gaps
from spl_batch.numerics.cell_groups import group_by_cell
from spl_batch.numerics.compiled import njit

REACH_M = 2 * PLANE_M
"""Ground up to this far from a lattice node counts there: a crown seldom hides as much [m]."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]


class Trend(NamedTuple):
    """Heights on an absolute lattice.

    Parameters
    ----------
    height : (rows, columns) float64
        Height at each lattice node [m], no gaps.
    left, bottom : int
        Column and row of the first one, counted from the origin.
    """

    height: Float
    left: int
    bottom: int


def fit_trend(ground: Float, x: Float, y: Float) -> Trend:
    """Trend through some ground, over an area.

    Parameters
    ----------
    ground : (m, 3) float64
        Nodes of the ground [m]; at least one. Sums are taken cell by cell, in their order.
    x, y : (n,) float64
        Places whose bounding box the trend covers [m]; those of the ground lie within.

    Returns
    -------
    Trend
        Where no ground is near, a TIN through the rims of that gap, and level beyond them.
    """
    left, bottom = (int(np.floor(v.min() / WIDE_M)) for v in (x, y))
    right, top = (int(np.floor(v.max() / WIDE_M)) + 1 for v in (x, y))
    height = np.empty((top - bottom + 1, right - left + 1))
    east, north = ground[:, :2].T.copy()
    cells = group_by_cell(east, north, WIDE_M)
    west, south = (int(np.floor(v.min() / WIDE_M)) for v in (east, north))
    _planes(
        ground[cells.order], cells.start, (south, west, cells.rows, cells.columns),
        (bottom, left), float(ground[0, 2]), height,
    )  # fmt: skip
    if np.isnan(height).all():
        height[:] = ground[:, 2].mean()
    return Trend(fill_gaps(height), left, bottom)


@njit()
def _planes(
    ground: Float,
    start: Index,
    cells: tuple[int, int, int, int],
    corner: tuple[int, int],
    base: float,
    out: Float,
) -> None:
    """Height of each lattice node's plane there; NaN where it has none.

    ``ground`` lies cell by cell, ``start`` is where each begins; ``cells`` are the row and column
    of the first one and how many there are, ``corner`` those of the first lattice node.
    """
    span = int(np.ceil(REACH_M / WIDE_M))
    south, west, rows, columns = cells
    for r in range(len(out)):
        for c in range(out.shape[1]):
            row, column = r + corner[0] - south, c + corner[1] - west
            first, last = max(column - span, 0), min(column + span, columns)
            n, x, y, z = 0.0, 0.0, 0.0, 0.0
            xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0
            out[r, c] = np.nan
            if first >= last:
                continue
            for k in range(max(row - span, 0), min(row + span, rows)):
                for i in range(start[k * columns + first], start[k * columns + last]):
                    dx = ground[i, 0] - (c + corner[1]) * WIDE_M
                    dy = ground[i, 1] - (r + corner[0]) * WIDE_M
                    nearness = 1.0 - (dx * dx + dy * dy) / REACH_M**2
                    if nearness > 0.0:
                        w, dz = nearness * nearness, ground[i, 2] - base
                        n, x, y, z = n + w, x + w * dx, y + w * dy, z + w * dz
                        xx, xy, yy = xx + w * dx * dx, xy + w * dx * dy, yy + w * dy * dy
                        xz, yz = xz + w * dx * dz, yz + w * dy * dz
            if n == 0.0:
                continue
            x, y, z = x / n, y / n, z / n
            if x * x + y * y > PLANE_M**2:  # the ground around is too far to be carried on
                continue
            xx, yy = xx / n - x * x + DAMPING_M2, yy / n - y * y + DAMPING_M2
            xy, xz, yz = xy / n - x * y, xz / n - x * z, yz / n - y * z
            east, north = yy * xz - xy * yz, xx * yz - xy * xz
            out[r, c] = base + (z - (east * x + north * y) / (xx * yy - xy * xy))


def trend_at(trend: Trend, x: Float, y: Float) -> Float:
    """Height of a trend at places.

    Parameters
    ----------
    trend : Trend
        Trend.
    x, y : (n,) float64
        Places within the area that it covers [m].

    Returns
    -------
    (n,) float64
        Height [m].
    """
    at = y / WIDE_M - trend.bottom, x / WIDE_M - trend.left
    height: Float = ndimage.map_coordinates(trend.height, at, order=1, mode="nearest")
    return height
