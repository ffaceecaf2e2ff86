"""Raised blocks that were cut off the terrain as buildings, and do not look like one.

A house ends in walls, on which hardly a return lies. A mound, a dam or a heap that is steep on all
sides is cut off as a house is, but its sides hold returns at all heights, cell beside cell. So what
was cut off is looked at where the lowest returns of cells without ground make a smooth surface well
above the terrain: crowns are rough. If its sides hold returns half-way up, nearly all along its
edge, and are steeper than a roof that comes down to its eaves, nobody knows what it is, and the
terrain model is no surer than half of its height.

A bank between two walls has no such sides. But it goes on: what is as narrow as a house, longer
than rows of them, and leads out of a ground cell is perhaps a bank, a quay or a railway.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.numerics.nearest_cells import nearest_cells

DOMAIN: Final = "space"

RAISED_M: Final = 2.0
"""Height of a block above the terrain model, at least: a low storey [m]."""

LEAST_M2: Final = 100.0
LARGE_M2: Final = 400.0
"""Smaller blocks are not told; area of a large house: trees beside smaller ones pass for sides, but
not all around [m2]."""

FILLED: Final = 0.7
SMALL_FILLED: Final = 0.9
"""Share of the cells of a block, and of a smaller one, that hold a return: in sparser clouds no
side is told from a wall."""

SMOOTH_M: Final = 0.5
SMOOTH: Final = 0.6
"""A smooth cell is so near to the median of the eight around it; of the cells of a block with a
return this share are [m, 1]."""

HALF_WAY: Final = (0.15, 0.85)
AROUND_M: Final = 2.0
"""A return on a side lies above the first share of the block's height, and below the other one of
what stands within so much of it: lower wings of a house end in walls, too [1, m]."""

STEEPER: Final = 1.8
"""A cell on a side lies so much below one beside it, in edges of a cell: no roof is so steep, and
gentler ground is kept."""

LONG_M: Final = 150.0
WIDE_M: Final = 25.0
"""What runs on is at least so long, and on the average no wider [m]: rows of houses are shorter."""

RIM: Final = 4
"""Cells along the edge of a ground cell or of the survey [count]."""

BESIDE: Final = np.ones((3, 3), np.bool_)
"""Cells that hang together."""

SIDES: Final = 0.5
"""Cells half-way up over those along the edge of a block, from which on its sides are no walls."""

ALL_AROUND: Final = 0.95
"""Share of the cells along the edge of a smaller block that have one half-way up beside them, at
least."""

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Block(NamedTuple):
    """A raised block that was cut off."""

    cells: Mask  #: (rows, columns): the block, and its sides.
    area_m2: float
    row: int
    column: int  #: A cell about in its middle.
    height_m: float  #: Above the terrain model.


def cut_off_blocks(lowest: Grid, dtm: Grid, ground: Mask, cell_m: float) -> Iterator[Block]:
    """Blocks whose sides are no walls, or that are long and run on.

    Parameters
    ----------
    lowest : (rows, columns) float64
        Height of the lowest signal in each cell [m]; NaN without any.
    dtm : (rows, columns) float64
        Terrain model [m]; NaN in voids.
    ground : (rows, columns) bool
        Cells with ground.
    cell_m : float
        Edge of a cell [m].
    """
    known, held = ~np.isnan(dtm), ~np.isnan(lowest)
    if not known.any() or not held.any():
        return
    above = lowest[nearest_cells(held)] - dtm[nearest_cells(known)]
    if not (above >= RAISED_M).any():
        return
    typical = ndimage.median_filter(above, 3, mode="nearest")
    raised = (typical >= RAISED_M) & ~ground
    numbers, _ = ndimage.label(raised, BESIDE)
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        near = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in box)
        mine = numbers[near] == number
        own_m2 = mine.sum() * cell_m**2
        small = own_m2 < LARGE_M2
        if own_m2 < LEAST_M2 or held[near][mine].mean() < (SMALL_FILLED if small else FILLED):
            continue
        if not _is_smooth(np.where(held[near], above[near], np.nan), mine):
            continue
        height = float(np.median(above[near][mine]))
        low = HALF_WAY[0] * height
        around = ndimage.maximum_filter(above[near], 2 * round(AROUND_M / cell_m) + 1)
        side = held[near] & (above[near] > low) & (above[near] < HALF_WAY[1] * around)
        side &= ndimage.maximum_filter(above[near], 3) - above[near] > STEEPER * cell_m
        side &= ndimage.binary_dilation(mine, BESIDE, iterations=2) & ~_worn(mine, 3)
        if not _has_sides(mine, side, small=small) and not _runs_on(mine, near, known, cell_m):
            continue
        depth = ndimage.distance_transform_edt(np.pad(mine, 1))[1:-1, 1:-1]
        row, column = (int(k) for k in np.unravel_index(depth.argmax(), mine.shape))
        cells = np.zeros(above.shape, np.bool_)
        cells[near] = mine | side
        area = float(cells.sum() * cell_m**2)
        yield Block(cells, area, row + near[0].start, column + near[1].start, height)


def _has_sides(mine: Mask, side: Mask, *, small: bool) -> bool:
    """Whether cells half-way up lie along most of a block's edge, or all of a small one's."""
    edge = mine & ~_worn(mine, 1)
    if side.sum() < SIDES * max(edge.sum(), 1):
        return False
    return not small or bool(ndimage.binary_dilation(side, BESIDE)[edge].mean() >= ALL_AROUND)


def _runs_on(mine: Mask, near: tuple[slice, ...], known: Mask, cell_m: float) -> bool:
    """Whether a block is long and narrow, and leads out of a ground cell or the survey.

    ``near``: where it lies in ``known``, the cells with terrain.
    """
    length = max(mine.shape) * cell_m
    if length < LONG_M or mine.sum() * cell_m**2 > WIDE_M * length:
        return False
    inner = ndimage.binary_erosion(ndimage.binary_fill_holes(known), BESIDE, iterations=RIM)
    return bool((mine & ~inner[near]).any())


def _worn(mine: Mask, cells: int) -> Mask:
    """A block without so many cells along its edge."""
    worn: Mask = ndimage.binary_erosion(mine, BESIDE, iterations=cells, border_value=1)
    return worn


def _is_smooth(above: Grid, mine: Mask) -> bool:
    """Whether most cells of a block lie as high as those around; NaN without a return."""
    rows, columns = above.shape
    wide = np.pad(above, 1, constant_values=np.nan)
    steps = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    asked = mine & ~np.isnan(above)
    beside = np.stack([wide[i : i + rows, j : j + columns][asked] for i, j in steps])
    counted = ~np.isnan(beside).all(axis=0)
    off = np.abs(above[asked][counted] - np.nanmedian(beside[:, counted], axis=0))
    return bool(counted.any() and np.mean(off <= SMOOTH_M) >= SMOOTH)
