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

from spl_batch.airborne.ground.smrf import fill_gaps
from spl_batch.numerics.compiled import njit

STEP_M = 4.0
"""Edge of the lattice [m]."""

REACH_M = 12.0
"""Ground up to this far from a lattice node counts there: a crown seldom hides as much [m]."""

_FAR_M = 6.0
"""Where the ground's centre is farther than this from a lattice node its plane is not carried on
[m]."""

_DAMPING_M2 = 0.1
"""Added to the horizontal scatter of that ground: a slope that it does not tell is none [m2]."""

_SUMS = 9

Float = NDArray[np.float64]


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
        Nodes of the ground [m]; at least one. Sums are taken in their order.
    x, y : (n,) float64
        Places whose bounding box the trend covers [m]; those of the ground lie within.

    Returns
    -------
    Trend
        Where no ground is near, a TIN through the rims of that gap, and level beyond them.
    """
    left, bottom = (int(np.floor(v.min() / STEP_M)) for v in (x, y))
    right, top = (int(np.floor(v.max() / STEP_M)) + 1 for v in (x, y))
    sums = np.zeros((top - bottom + 1, right - left + 1, _SUMS))
    base = float(ground[0, 2])
    _add_up(ground, base, left, bottom, sums)
    height = base + _heights(sums)
    if np.isnan(height).all():
        height[:] = ground[:, 2].mean()
    return Trend(fill_gaps(height), left, bottom)


@njit()
def _add_up(ground: Float, base: float, left: int, bottom: int, sums: Float) -> None:
    """Weights and weighted x, y, z, xx, xy, yy, xz, yz about each lattice node."""
    rows, columns, _ = sums.shape
    span = int(np.ceil(REACH_M / STEP_M))
    for i in range(len(ground)):
        column = int(np.floor(ground[i, 0] / STEP_M)) - left
        row = int(np.floor(ground[i, 1] / STEP_M)) - bottom
        z = ground[i, 2] - base
        for r in range(max(row - span, 0), min(row + span + 2, rows)):
            y = ground[i, 1] - (r + bottom) * STEP_M
            for c in range(max(column - span, 0), min(column + span + 2, columns)):
                x = ground[i, 0] - (c + left) * STEP_M
                nearness = 1.0 - (x * x + y * y) / REACH_M**2
                if nearness > 0.0:
                    w = nearness * nearness
                    out = sums[r, c]
                    out[0] += w
                    out[1] += w * x
                    out[2] += w * y
                    out[3] += w * z
                    out[4] += w * x * x
                    out[5] += w * x * y
                    out[6] += w * y * y
                    out[7] += w * x * z
                    out[8] += w * y * z


def _heights(sums: Float) -> Float:
    """Height of each lattice node's plane there; NaN where it has none: (rows, columns)."""
    with np.errstate(invalid="ignore"):
        x, y, z, xx, xy, yy, xz, yz = np.moveaxis(sums[:, :, 1:] / sums[:, :, :1], 2, 0)
    xx, yy, xy = xx - x * x + _DAMPING_M2, yy - y * y + _DAMPING_M2, xy - x * y
    xz, yz = xz - x * z, yz - y * z
    east, north = yy * xz - xy * yz, xx * yz - xy * xz
    height: Float = z - (east * x + north * y) / (xx * yy - xy * xy)
    return np.where(x * x + y * y <= _FAR_M**2, height, np.nan)


@njit()
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
    out = np.empty(len(x))
    for i in range(len(x)):
        u, v = x[i] / STEP_M - trend.left, y[i] / STEP_M - trend.bottom
        c, r = int(np.floor(u)), int(np.floor(v))
        u -= c
        v -= r
        south = (1.0 - u) * trend.height[r, c] + u * trend.height[r, c + 1]
        north = (1.0 - u) * trend.height[r + 1, c] + u * trend.height[r + 1, c + 1]
        out[i] = (1.0 - v) * south + v * north
    return out
