r"""Agreement of tubes with one another, and the points that they hold.

A conductor is longer than a tube, and seldom alone: tubes along it point along one another, those
of its neighbours lie side by side. Chance tubes point anywhere.

====== ==========================================================================
symbol name
====== ==========================================================================
x, y, v offset of a tube's middle from another's line: along, across, upwards [quanta]
w       r + ``spread`` |x|: half-width of a line drawn out [quanta]
====== ==========================================================================
"""

import math

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.lattice_columns import first_above, stretch_of


@njit(inline="always")
def _offset(dx, dy, dz, along_x, along_y, slope, bend):  # type: ignore[no-untyped-def]
    """Offset along, across and upwards of a hanging line through the origin."""
    x = dx * along_x + dy * along_y
    return x, dy * along_x - dx * along_y, dz - slope * x - bend * x * x


@njit(inline="always")
def _stretch(x, z, slope, bend, width, edge):  # type: ignore[no-untyped-def]
    """Lowest and highest point that a line may hold in a column ``x`` along it."""
    sag = bend * (abs(x) + edge) ** 2
    return z + slope * x - abs(slope) * edge - width, z + slope * x + abs(
        slope
    ) * edge + width + sag


@njit()
def refine(  # type: ignore[no-untyped-def]  # noqa: C901
    points, start, nx, ny, edge, corner, length, radius, bend, azimuth, slope, middle, flank
):  # fmt: skip
    """Line through the returns of each tube, by least squares.

    Parameters
    ----------
    points, start, nx, ny, edge, corner
        The columns.
    length, azimuth, slope : (m,) float64
        Half-length and direction; the latter is replaced [quanta, rad, rise/run].
    radius, bend : float
        Half-width [quanta], and the parabola taken away [1/quanta].
    middle : (m, 3) float64
        Middle of the tube; replaced by the point of the new line beside it [quanta].
    flank : (m,) int32
        Receives the returns beside or above and below the tube, whichever are more, out to
        three times its half-width, less those inside. A plane has twice as many.
    """
    for s in range(len(middle)):
        along_x, along_y = math.cos(azimuth[s]), math.sin(azimuth[s])
        reach = length[s]
        x0, y0, z0 = middle[s, 0], middle[s, 1], middle[s, 2]
        i0, i1 = stretch_of(x0 - corner[0], reach, edge, nx)
        j0, j1 = stretch_of(y0 - corner[1], reach, edge, ny)
        n, beside, above = 0, 0, 0
        sx = sy = sv = sxx = sxy = sxv = 0.0
        for i in range(i0, i1):
            for j in range(j0, j1):
                # A column whose axis is farther off than its half diagonal holds nothing.
                cx = corner[0] + (i + 0.5) * edge - x0
                cy = corner[1] + (j + 0.5) * edge - y0
                if abs(cy * along_x - cx * along_y) > 3.0 * radius + 0.71 * edge:
                    continue
                x = cx * along_x + cy * along_y
                low, high = _stretch(x, z0, slope[s], bend, 3.0 * radius, edge)
                end = start[i * ny + j + 1]
                for slot in range(first_above(points, start[i * ny + j], end, low), end):
                    if points[2, slot] > high:
                        break
                    dx = np.float64(points[0, slot] - x0)
                    dy = np.float64(points[1, slot] - y0)
                    dz = np.float64(points[2, slot] - z0)
                    x, y, v = _offset(dx, dy, dz, along_x, along_y, slope[s], bend)
                    if abs(x) > reach or abs(y) > 3.0 * radius or abs(v) > 3.0 * radius:
                        continue
                    if abs(y) > radius:
                        beside += abs(v) <= radius
                    elif abs(v) > radius:
                        above += 1
                    else:
                        n += 1
                        sx, sy, sv = sx + x, sy + y, sv + v
                        sxx, sxy, sxv = sxx + x * x, sxy + x * y, sxv + x * v
        flank[s] = max(beside, above) - n
        if n < 2:
            continue
        spread = n * sxx - sx * sx
        turn = rise = 0.0
        if spread > 0.0:
            turn, rise = (n * sxy - sx * sy) / spread, (n * sxv - sx * sv) / spread
        aside, up = (sy - turn * sx) / n, (sv - rise * sx) / n
        middle[s, 0], middle[s, 1] = x0 - along_y * aside, y0 + along_x * aside
        middle[s, 2] = z0 + up
        azimuth[s] += math.atan(turn)
        slope[s] += rise


@njit()
def agreeing(  # type: ignore[no-untyped-def]  # noqa: C901
    points, start, nx, ny, edge, corner, middle, azimuth, slope, length,
    stretch, radius, spread, beside, above, turn_max, rise_max, bend, inline, abreast, against,
):  # fmt: skip
    """Count the tubes that prolong each one, and those beside it that point the same way.

    Parameters
    ----------
    points, start, nx, ny, edge, corner
        Columns of the tubes' middles, rounded; rows number the tubes.
    middle, azimuth, slope, length
        The tubes: (m, 3) [quanta], (m,) [rad, rise/run, quanta].
    stretch : (m,) float64
        Farthest tube that counts, along [quanta].
    radius, spread : float
        Half-width of a line drawn out [quanta; quanta per quantum].
    beside, above : float
        Farthest parallel tube, across and upwards [quanta].
    turn_max, rise_max : float
        Largest difference of direction [rad, rise/run].
    bend : float
        Parabola of a hanging line [1/quanta].
    inline, abreast, against : (m,) int32
        Receive the counts. In line are agreeing tubes beyond the own half-length, which share
        no return with it; abreast those off its line. Against it speak the tubes on
        its line that point elsewhere, less those that agree.
    """
    for s in range(len(middle)):
        along_x, along_y = math.cos(azimuth[s]), math.sin(azimuth[s])
        wide = abs(along_x) * stretch[s] + abs(along_y) * beside
        deep = abs(along_y) * stretch[s] + abs(along_x) * beside
        i0, i1 = stretch_of(middle[s, 0] - corner[0], wide, edge, nx)
        j0, j1 = stretch_of(middle[s, 1] - corner[1], deep, edge, ny)
        for i in range(i0, i1):
            for j in range(j0, j1):
                cx = corner[0] + (i + 0.5) * edge - middle[s, 0]
                cy = corner[1] + (j + 0.5) * edge - middle[s, 1]
                if abs(cy * along_x - cx * along_y) > beside + 0.71 * edge:
                    continue
                for slot in range(start[i * ny + j], start[i * ny + j + 1]):
                    t = points[3, slot]
                    if t == s:
                        continue
                    x, y, v = _offset(
                        middle[t, 0] - middle[s, 0], middle[t, 1] - middle[s, 1],
                        middle[t, 2] - middle[s, 2], along_x, along_y, slope[s], bend,
                    )  # fmt: skip
                    if abs(x) > stretch[s] or abs(y) > beside or abs(v) > above:
                        continue
                    width = radius + spread * abs(x)
                    on_line = abs(y) <= width and abs(v) <= width
                    turn = abs(azimuth[t] - azimuth[s]) % math.pi
                    turn = min(turn, math.pi - turn)
                    ahead = math.cos(azimuth[t]) * along_x + math.sin(azimuth[t]) * along_y
                    rise = slope[t] if ahead >= 0.0 else -slope[t]
                    if turn > turn_max or abs(rise - slope[s] - 2.0 * bend * x) > rise_max:
                        against[s] += on_line and abs(x) <= length[s]
                    elif not on_line:
                        abreast[s] += 1
                    elif abs(x) > length[s]:
                        inline[s] += 1
                    else:
                        against[s] -= 1


@njit()
def vote(  # type: ignore[no-untyped-def]
    points, start, nx, ny, edge, corner, middle, azimuth, slope, length, radius, spread, bend, votes
):  # fmt: skip
    """Count for every point the tubes that hold it: ``votes`` (n,) int32 by row.

    The other parameters are those of :func:`agreeing`; the columns are the points'.
    """
    for s in range(len(middle)):
        along_x, along_y = math.cos(azimuth[s]), math.sin(azimuth[s])
        reach = length[s]
        i0, i1 = stretch_of(middle[s, 0] - corner[0], reach, edge, nx)
        j0, j1 = stretch_of(middle[s, 1] - corner[1], reach, edge, ny)
        for i in range(i0, i1):
            for j in range(j0, j1):
                cx = corner[0] + (i + 0.5) * edge - middle[s, 0]
                cy = corner[1] + (j + 0.5) * edge - middle[s, 1]
                if abs(cy * along_x - cx * along_y) > radius + spread * reach + 0.71 * edge:
                    continue
                x = cx * along_x + cy * along_y
                width = radius + spread * (abs(x) + edge)
                low, high = _stretch(x, middle[s, 2], slope[s], bend, width, edge)
                end = start[i * ny + j + 1]
                for slot in range(first_above(points, start[i * ny + j], end, low), end):
                    if points[2, slot] > high:
                        break
                    x, y, v = _offset(
                        points[0, slot] - middle[s, 0], points[1, slot] - middle[s, 1],
                        points[2, slot] - middle[s, 2], along_x, along_y, slope[s], bend,
                    )  # fmt: skip
                    width = radius + spread * abs(x)
                    if abs(x) <= reach and abs(y) <= width and abs(v) <= width:
                        votes[points[3, slot]] += 1
