"""Terrain under decks and roofs beside walls: carried on from both sides, not from the rims.

A bridge over a gorge is cut off; triangles through what is left join the rims to the floor, and
raise it to the height of the deck. But what was cut off stands above the ground: where a cell
without ground holds a hard surface, its terrain is that of the shortest line across which ends on
ground clearly below that surface on both sides, at about one height. Asked are hard surfaces that
the triangles come near to, where they do and where they are steep; cells are only lowered.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.lattice.tiles import quanta

DOMAIN: Final = "space"

CLEAR_M: Final = 2.0
"""Ground under a deck lies so far below it, at least [m]."""

THICK_M: Final = 1.0
"""Returns of a hard surface lie within this, in a cell [m]."""

STEEP: Final = 0.3
"""Slope of triangles from which on a cell is asked, and most slope of a line across [rise/run]."""

REACH_M: Final = 20.0
"""How far to each side ground is looked for [m]."""

LOWER_M: Final = 0.5
"""Terrain is changed by more than this, or left as it is [m]."""

LINES: Final = tuple((np.sin(a), np.cos(a)) for a in np.arange(24) * np.pi / 24)
"""Directions of lines across: north, east."""

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def under_decks(
    terrain: Grid, ground: Grid, lowest: Grid, highest: Grid, cell_q: int
) -> NDArray[np.float64]:
    """Terrain that goes on under hard surfaces from both sides.

    Parameters
    ----------
    terrain : (rows, columns) float64
        Terrain model [quanta]; NaN in voids.
    ground : (rows + 2 m, columns + 2 m) float64
        Mean height of the ground in each cell, of a margin of m cells as well [quanta]; NaN
        without.
    lowest, highest : (rows, columns) float64
        Lowest and highest return of each cell [quanta]; NaN without.
    cell_q : int
        Edge of a cell [quanta].
    """
    margin = (len(ground) - len(terrain)) // 2
    row, column = np.nonzero(_asked(terrain, ground, lowest, highest, cell_q))
    if not len(row):
        return terrain
    most = lowest[row, column] - quanta(CLEAR_M)
    shortest, height = np.full(len(row), np.inf), terrain[row, column]
    for north, east in LINES:
        (near, one), (far, other) = (
            _first_ground(ground, (row + margin, column + margin), (s * north, s * east), cell_q)
            for s in (1.0, -1.0)
        )
        length = near + far
        good = np.isfinite(length) & (np.maximum(one, other) <= most)
        length, one, other = (np.where(good, some, 0.0) for some in (length, one, other))
        good &= (np.abs(one - other) <= STEEP * length) & (length < shortest)
        shortest = np.where(good, length, shortest)
        share = np.where(good, near, 0.0) / np.where(good, length, 1.0)
        height = np.where(good, one + (other - one) * share, height)
    lower = height < terrain[row, column] - quanta(LOWER_M)
    found = terrain.copy()
    found[row[lower], column[lower]] = height[lower]
    return found


def _asked(terrain: Grid, ground: Grid, lowest: Grid, highest: Grid, cell_q: int) -> Mask:
    """Cells with a hard surface and no ground that triangles may have raised."""
    margin, (rows, columns) = (len(ground) - len(terrain)) // 2, terrain.shape
    bare = np.isnan(ground[margin : margin + rows, margin : margin + columns])
    # Comparisons with NaN are false.
    hard = bare & (highest - lowest <= quanta(THICK_M))
    close: Mask = hard & (terrain > lowest - quanta(CLEAR_M))
    if not close.any() or min(rows, columns) == 1:
        return close
    numbers, _ = ndimage.label(hard)
    slope = np.hypot(*np.gradient(terrain, cell_q))
    asked: Mask = close | (hard & (slope > STEEP) & np.isin(numbers, numbers[close]))
    return asked


def _first_ground(
    ground: Grid, start: tuple[Index, Index], towards: tuple[float, float], cell_q: int
) -> tuple[Grid, Grid]:
    """Distance to the first ground on the way from cells, and its height; infinite without."""
    scale = max(map(abs, towards))
    north, east = (part / scale for part in towards)
    stride = float(np.hypot(north, east)) * cell_q
    away, height = np.full((2, len(start[0])), np.inf)
    going = np.arange(len(away))
    for k in range(1, int(quanta(REACH_M) / stride) + 1):
        r, c = start[0][going] + round(k * north), start[1][going] + round(k * east)
        inside = (r >= 0) & (r < len(ground)) & (c >= 0) & (c < ground.shape[1])
        going, here = going[inside], ground[r[inside], c[inside]]
        held = ~np.isnan(here)
        away[going[held]], height[going[held]] = k * stride, here[held]
        going = going[~held]
        if not len(going):
            break
    return away, height
