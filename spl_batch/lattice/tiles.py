"""Ownership, halo and index arithmetic on the absolute lattice; pure functions.

Every region is half-open, ``[min, max)``, in integer quanta of
:data:`~spl_batch.constants.QUANTUM_M`, and every grid is anchored at coordinate zero. So a point
belongs to exactly one tile, ground cell, voxel and raster cell, whatever else is in the survey.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M


class Bounds(NamedTuple):
    """Half-open rectangle ``[xmin, xmax) x [ymin, ymax)`` [quanta]."""

    xmin: int
    ymin: int
    xmax: int
    ymax: int

    @property
    def area_m2(self) -> float:
        """Area of the rectangle [m2]."""
        return (self.xmax - self.xmin) * (self.ymax - self.ymin) / QUANTA_PER_M**2


class CellId(NamedTuple):
    """Column and row of a square on an absolute grid."""

    i: int
    j: int

    def __str__(self) -> str:
        return f"{self.i}_{self.j}"


def parse_cell(name: str) -> CellId:
    """Cell of a name such as ``"-3_12"``."""
    i, j = name.split("_")
    return CellId(int(i), int(j))


def quanta(length_m: float) -> int:
    """Length on the lattice, rounded to the nearest quantum [quanta]."""
    return round(length_m * QUANTA_PER_M)


def cell_bounds(cell: CellId, size: int) -> Bounds:
    """Region that a cell of an absolute grid owns.

    ``size``: edge of the grid's squares [quanta], > 0.
    """
    return Bounds(cell.i * size, cell.j * size, (cell.i + 1) * size, (cell.j + 1) * size)


def cells_touching(bounds: Bounds, size: int) -> Iterator[CellId]:
    """Cells of an absolute grid that share area with a region, row by row.

    Parameters
    ----------
    bounds : Bounds
        Region; an empty one touches nothing.
    size : int
        Edge of the grid's squares [quanta], > 0.
    """
    if bounds.xmax <= bounds.xmin or bounds.ymax <= bounds.ymin:
        return
    for j in range(bounds.ymin // size, -(-bounds.ymax // size)):
        for i in range(bounds.xmin // size, -(-bounds.xmax // size)):
            yield CellId(i, j)


def grow(bounds: Bounds, halo: int) -> Bounds:
    """Region with a halo around it.

    ``halo``: width of the halo [quanta], >= 0.
    """
    return Bounds(bounds.xmin - halo, bounds.ymin - halo, bounds.xmax + halo, bounds.ymax + halo)


def whole_cells(bounds: Bounds, size: int) -> Bounds:
    """Smallest region of whole squares of an absolute grid that holds a region.

    ``size``: edge of the grid's squares [quanta], > 0.
    """
    west, south = bounds.xmin // size, bounds.ymin // size
    east, north = -(-bounds.xmax // size), -(-bounds.ymax // size)
    return Bounds(west * size, south * size, east * size, north * size)


def overlap(a: Bounds, b: Bounds) -> bool:
    """Whether two half-open regions share area."""
    return a.xmin < b.xmax and b.xmin < a.xmax and a.ymin < b.ymax and b.ymin < a.ymax


def shared(a: Bounds, b: Bounds) -> Bounds:
    """What two half-open regions share; without any area where they do not."""
    west, south = max(a.xmin, b.xmin), max(a.ymin, b.ymin)
    return Bounds(west, south, max(min(a.xmax, b.xmax), west), max(min(a.ymax, b.ymax), south))


def inside(x: NDArray[np.int64], y: NDArray[np.int64], bounds: Bounds) -> NDArray[np.bool_]:
    """Which points a region owns: (n,) bool.

    Parameters
    ----------
    x, y : (n,) int64
        Coordinates [quanta].
    """
    owned: NDArray[np.bool_] = (
        (x >= bounds.xmin) & (x < bounds.xmax) & (y >= bounds.ymin) & (y < bounds.ymax)
    )
    return owned


def cell_index(coordinate: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Column (or row) of each coordinate on an absolute grid; exact for negative ones: (n,) int64.

    Parameters
    ----------
    coordinate : (n,) int64
        Coordinates [quanta].
    size : int
        Edge of the grid's squares [quanta], > 0.
    """
    index: NDArray[np.int64] = np.floor_divide(coordinate, size)
    return index


def far_apart(
    places: NDArray[np.int64], gap: int, ends: NDArray[np.int64] | None = None
) -> Iterator[NDArray[np.intp]]:
    """Rows of places in groups that wide empty columns or rows keep apart, again and again.

    Parameters
    ----------
    places : (n, 2) int64
        Easting and northing, or column and row.
    gap : int
        Places along an axis that differ by more than this, with none between, are apart.
    ends : (n, 2) int64, optional
        The same of the other corners, where the places are rectangles.

    Yields
    ------
    (k,) intp
        Rows of a group, in any order; each row is in one group.
    """
    ends = places if ends is None else ends
    waiting = [np.arange(len(places))] if len(places) else []
    while waiting:
        rows = waiting.pop()
        for axis in (0, 1):
            rows = rows[np.argsort(places[rows, axis], kind="stable")]
            reached = np.maximum.accumulate(ends[rows, axis])[:-1]
            cuts = np.flatnonzero(places[rows[1:], axis] - reached > gap) + 1
            if len(cuts):
                waiting.extend(reversed(np.split(rows, cuts)))
                break
        else:
            yield rows


class BoxIndex:
    """Rectangles by name, found by the regions that they share area with.

    Parameters
    ----------
    boxes : mapping of str to Bounds
        The rectangles; empty ones are never found.
    """

    def __init__(self, boxes: Mapping[str, Bounds]) -> None:
        self._names = sorted(n for n, b in boxes.items() if b.xmin < b.xmax and b.ymin < b.ymax)
        edges = np.array([boxes[n] for n in self._names], np.float64).reshape(-1, 4)
        self._tree = shapely.STRtree(shapely.box(*edges.T))

    def overlapping(self, region: Bounds) -> list[str]:
        """Names of the rectangles that share area with a region, sorted."""
        # Edges are whole numbers: what only touches the region does not reach half a quantum in.
        west, south, east, north = region
        if east <= west or north <= south:
            return []
        inner = shapely.box(west + 0.5, south + 0.5, east - 0.5, north - 0.5)
        return [self._names[k] for k in np.sort(self._tree.query(inner)).tolist()]
