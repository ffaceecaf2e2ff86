r"""Clearance of a tube: what is around it, whether its line hangs free and goes from end to end.

====== ==========================================================================
symbol name
====== ==========================================================================
x, y, v offset of a return from a tube's line: along, across, upwards [quanta]
d       max(|y|, |v|): how far it is off the line, in square rings [quanta]
====== ==========================================================================
"""

import math
from typing import Final

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.lattice_columns import first_above, stretch_of

PARTS: Final = 8
"""Equal parts of a tube that are told apart [count]."""


@njit()
def around_tubes(  # type: ignore[no-untyped-def]
    points, start, nx, ny, edge, corner, middle, azimuth, slope, length, rings, bend, count, held
):  # fmt: skip
    """Count the returns within some distances of each tube's line.

    Parameters
    ----------
    points, start, nx, ny, edge, corner
        The columns.
    middle, azimuth, slope, length
        The tubes: (m, 3) [quanta], (m,) [rad, rise/run, quanta].
    rings : (k,) float64
        Distances d, ascending [quanta].
    bend : float
        Parabola of a hanging line [1/quanta].
    count : (m, k) int32
        Receives the returns of ``|x| <= length`` no farther off than each distance.
    held : (m, PARTS) bool
        Receives which parts of the tube hold returns within the first distance; must be False.
    """
    wide = rings[-1]
    for s in range(len(middle)):
        along_x, along_y = math.cos(azimuth[s]), math.sin(azimuth[s])
        reach = length[s]
        far = reach + wide
        i0, i1 = stretch_of(middle[s, 0] - corner[0], far, edge, nx)
        j0, j1 = stretch_of(middle[s, 1] - corner[1], far, edge, ny)
        for i in range(i0, i1):
            for j in range(j0, j1):
                cx = corner[0] + (i + 0.5) * edge - middle[s, 0]
                cy = corner[1] + (j + 0.5) * edge - middle[s, 1]
                if abs(cy * along_x - cx * along_y) > wide + 0.71 * edge:
                    continue
                x = cx * along_x + cy * along_y
                low = middle[s, 2] + slope[s] * x - abs(slope[s]) * edge - wide
                high = low + 2.0 * (abs(slope[s]) * edge + wide) + bend * (abs(x) + edge) ** 2
                end = start[i * ny + j + 1]
                for slot in range(first_above(points, start[i * ny + j], end, low), end):
                    if points[2, slot] > high:
                        break
                    dx, dy = points[0, slot] - middle[s, 0], points[1, slot] - middle[s, 1]
                    x = dx * along_x + dy * along_y
                    if abs(x) > reach:
                        continue
                    up = points[2, slot] - middle[s, 2] - slope[s] * x - bend * x * x
                    off = max(abs(dy * along_x - dx * along_y), abs(up))
                    for ring in range(len(rings)):
                        count[s, ring] += off <= rings[ring]
                    if off <= rings[0]:
                        part = np.int64((x + reach) / (2.0 * reach) * PARTS)
                        held[s, min(part, PARTS - 1)] = True
