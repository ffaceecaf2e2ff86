"""Voids of a terrain model that are too wide to be filled: lakes without light, halls, dense woods.

Ground is interpolated up to ``products.void_max_m`` from where it was found; beyond, it stays void.
A void counts where terrain lies all around it. One that is open to the edge of the survey counts
where it was flown and is wider than :data:`RIM_M` to each side: beams lean, so off the edge of a
swath a narrow rim was flown and has no ground.

Large rasters are looked at in squares of several cells. A square is void where one of its cells is;
areas are those of the cells.
"""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, distance_transform_edt, find_objects, label

from spl_batch.constants import NODATA
from spl_batch.engine.findings import Finding

RIM_M: Final = 5.0
"""Half the width of a void at the edge of a survey, at least [m]."""

SQUARES: Final = 2**22
"""Squares that a raster, or a flightline, is looked at in, at most [count]."""

Blocks = Iterable[tuple[int, int, NDArray[np.float32]]]
"""First row, first column and values of pieces of a raster, row 0 northernmost."""


class Void(NamedTuple):
    """A void of a terrain model."""

    area_m2: float
    east_m: float
    north_m: float


def wide_voids(
    dtm: Blocks,
    density: Blocks,
    shape: tuple[int, int],
    corner_xy_m: tuple[float, float],
    cell_m: float,
) -> list[Void]:
    """Voids that nothing fills, the largest first.

    ``dtm``: terrain, what no block covers is void; ``density``: has a value where it was flown.
    ``shape`` and ``corner_xy_m``: rows and columns of both, and their upper left corner.
    """
    step = max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / SQUARES))))
    ends = [np.minimum(np.arange(step, n + step, step), n) for n in shape]
    rows, columns = (np.diff(end, prepend=0) for end in ends)
    void = rows[:, None] * columns - _held(dtm, (len(rows), len(columns)), step)
    full = void == 0
    inner = binary_fill_holes(full) & ~full
    flown = _held(density, full.shape, step) > 0
    outer = _wide(binary_fill_holes(full | flown) & ~full & ~inner, RIM_M / (step * cell_m))
    edge_m = step * cell_m
    found = [
        Void(
            cells * cell_m**2,
            corner_xy_m[0] + (column + 0.5) * edge_m,
            corner_xy_m[1] - (row + 0.5) * edge_m,
        )
        for area in (inner, outer)
        for cells, row, column in _pieces(area, void)
    ]
    return sorted(found, reverse=True)


def _held(blocks: Blocks, shape: tuple[int, int], step: int) -> NDArray[np.int64]:
    """Cells with a value in each square [count]."""
    held = np.zeros(shape, np.int64)
    for row, column, block in blocks:
        at = np.nonzero(block != np.float32(NODATA))
        np.add.at(held, ((at[0] + row) // step, (at[1] + column) // step), 1)
    return held


def _wide(area: NDArray[np.bool_], rim: float) -> NDArray[np.bool_]:
    """Those of an area's squares that lie in a disc of that radius within it (an opening)."""
    core = distance_transform_edt(np.pad(area, 1))[1:-1, 1:-1] > rim
    if not core.any():
        return core
    wide: NDArray[np.bool_] = area & (distance_transform_edt(~core) <= rim)
    return wide


def _pieces(area: NDArray[np.bool_], void: NDArray[np.int64]) -> Iterable[tuple[int, int, int]]:
    """Void cells of each piece of an area, and the square that lies deepest in it."""
    numbers, _ = label(area)
    depth = distance_transform_edt(np.pad(area, 1))[1:-1, 1:-1]
    for number, place in enumerate(find_objects(numbers), start=1):
        mine = numbers[place] == number
        deepest = np.where(mine, depth[place], -1.0).argmax()
        row, column = np.unravel_index(deepest, mine.shape)
        yield int(void[place][mine].sum()), place[0].start + row, place[1].start + column


def void_findings(found: Sequence[Void], void_max_m: float) -> list[Finding]:
    """A finding on voids, the largest first, wider than ``products.void_max_m``."""
    if not found:
        return []
    largest = found[0]
    values = {
        "count": len(found), "area_m2": float(sum(void.area_m2 for void in found)),
        "largest_m2": float(largest.area_m2), "void_max_m": void_max_m,
    }  # fmt: skip
    half_m = 0.5 * largest.area_m2**0.5
    east_m, north_m = float(largest.east_m), float(largest.north_m)
    place = (east_m - half_m, north_m - half_m, east_m + half_m, north_m + half_m)
    return [Finding("G02", values, place=place)]
