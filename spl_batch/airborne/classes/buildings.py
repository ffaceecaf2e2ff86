"""Which returns are of buildings: planes that stand high above the ground, side by side.

Domain: space. The idea is that of planar surfaces and their height, as in G. Vosselman & S. Dijkman
(2001, *3D building model reconstruction from point clouds and ground plans*, IAPRS 34-3/W4) and
N. Haala & C. Brenner (1999, *Extraction of buildings and trees in urban environments*, ISPRS J. 54,
130-137), reduced to what needs no region that grows, so that no tiling changes it:

1. What stands :data:`STANDS_M` or more above the ground around takes part. The ground is the mean
   of ground returns of each square metre, the nearest one where a square has none.
2. Of each window of 3 x 3 cells of an absolute grid the plane by least squares is found; it is a
   roof's if the returns spread by no more than :data:`FLAT_M` about it, lie in all directions, and
   are as many as those of the ground there: conductors side by side let light pass. A return is
   planar that lies near the plane of a window around it. Cells of 1 m are tried first; where no
   window holds :data:`FEWEST` returns, those of 2 m, and of 4 m.
3. Planar returns are of a building where many returns of the 5 x 5 cells around are planar; so are
   others where most are, as chimneys and ridges.

What is flat, high, and no building, as a deck of a bridge, is taken for one.
"""

from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from spl_batch.lattice.tables import ROWS_AT_ONCE, PointTable
from spl_batch.lattice.tiles import Bounds, quanta

Heights = NDArray[np.int64]

STANDS_M: Final = 2.0
"""Buildings stand so high above the ground, at least [m]."""

CELLS_M: Final = (1.0, 2.0, 4.0)
"""Edges of the cells that are tried [m]; those of the ground are as the smallest."""

FEWEST: Final = 6
"""Returns that make a plane [count]."""

FLAT_M: Final = 0.30
"""Standard deviation about a roof's plane, at most [m]."""

STEEPEST: Final = 1.8
"""Slope of a roof, at most: 60 degrees [rise/run]."""

WIDE: Final = 0.12
"""Standard deviation of a window's returns in each direction, at least [edges of the window]."""

NEAR_SIGMA: Final = 2.5
"""A return is near a plane within so many of its standard deviations."""

MANY: Final = 0.4
MOST: Final = 0.6
"""Shares of planar returns around that make a building of planar, and of other returns, 0..1."""

AROUND: Final = 2
"""Cells on each side in which that share is taken [count]."""

REACH_M: Final = (AROUND + 2) * max(CELLS_M)
"""How far around a return its neighbours decide [m]; the ground may lie farther."""


class _Planes(NamedTuple):
    """Plane of the window around each cell: (rows, cols)."""

    returns: NDArray[np.int64]  #: Returns of the window.
    roof: NDArray[np.bool_]  #: Whether it is a roof's.
    #: Mean of its returns [quanta].
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    #: Slope [rise/run].
    east: NDArray[np.float64]
    north: NDArray[np.float64]
    sigma: NDArray[np.float64]  #: Standard deviation about it [quanta].


class Floor:
    """The ground around buildings of a region [quanta]: mean of each square metre."""

    def __init__(self, region: Bounds, table: PointTable, usable: NDArray[np.bool_]) -> None:
        self.region = region
        self._grid = _Grid(region, quanta(min(CELLS_M)))
        cells = self._grid.rows * self._grid.columns
        self._sum, self._count = np.zeros((2, cells), np.int64)
        ground = usable & (table["ground"] == 1)
        number = self._grid.number(table["x"][ground], table["y"][ground])
        np.add.at(self._sum, number, table["z"][ground])
        np.add.at(self._count, number, 1)

    @property
    def held(self) -> bool:
        """Whether there is any ground."""
        return bool(self._count.any())

    @cached_property
    def lowest(self) -> int:
        """Lowest mean of a square [quanta]."""
        return int(self.levels.min())

    @cached_property
    def levels(self) -> NDArray[np.int64]:
        """Height of the nearest ground of each square [quanta]."""
        mean = self._sum // np.maximum(self._count, 1)
        shape = self._grid.rows, self._grid.columns
        void = (self._count == 0).reshape(shape)
        at = distance_transform_edt(void, return_distances=False, return_indices=True)
        levels: Heights = mean.reshape(shape)[tuple(at)].ravel()
        return levels

    def height(self, x: NDArray[np.int64], y: NDArray[np.int64], z: NDArray[np.int32]) -> Heights:
        """Heights above the ground around [quanta]: (n,) int64."""
        height: Heights = z - self.levels[self._grid.number(x, y)]
        return height


def buildings(table: PointTable, usable: NDArray[np.bool_], floor: Floor) -> NDArray[np.bool_]:
    """Which returns are of buildings: (n,) bool.

    ``table``: those that are judged and :data:`REACH_M` around them, with ``x, y, z, ground``, in
    any order; ``usable``: signal, the others are no building and count for nothing; ``floor``: the
    ground of the whole region. Returns nearer to its edge than :data:`REACH_M` lack neighbours.
    """
    found = np.zeros(len(table), np.bool_)
    if not floor.held:
        return found
    ground = usable & (table["ground"] == 1)
    rows = np.flatnonzero(usable & ~ground)
    high = floor.height(*(table[axis][rows] for axis in "xyz")) >= quanta(STANDS_M)
    rows = rows[high]
    corner = (floor.region.xmin, floor.region.ymin, floor.lowest)
    xyz = np.empty((len(rows), 3), np.int32)
    for k, axis in enumerate("xyz"):
        xyz[:, k] = table[axis][rows].astype(np.int64) - corner[k]
    judged = np.zeros(len(rows), np.bool_)
    for cell_m in CELLS_M:
        if judged.all():
            break
        grid = _Grid(floor.region, quanta(cell_m))
        below = np.bincount(
            grid.number(table["x"][ground], table["y"][ground]), minlength=grid.rows * grid.columns
        ).reshape(grid.rows, grid.columns)
        able, building = _of_cells(xyz, grid, below)
        found[rows[building & ~judged]] = True
        judged |= able
    return found


class _Grid:
    """Absolute cells over a region."""

    def __init__(self, region: Bounds, edge: int) -> None:
        self.region, self.edge = region, edge
        self.west, self.south = region.xmin // edge, region.ymin // edge
        self.columns = -(-region.xmax // edge) - self.west
        self.rows = -(-region.ymax // edge) - self.south

    def number(self, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
        """Number of the cell of each place, row by row."""
        found: NDArray[np.int64] = (y // self.edge - self.south) * self.columns
        return found + x // self.edge - self.west


def _of_cells(
    xyz: NDArray[np.int32], grid: _Grid, below: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which returns cells of one size can judge, and which of them are of buildings.

    ``xyz``: what stands above the ground, from the corner of the region [quanta]; ``below``: ground
    returns of each cell [count].
    """
    shape = below.shape
    corner = grid.region.xmin, grid.region.ymin
    number = grid.number(*(xyz[:, k].astype(np.int64) + corner[k] for k in (0, 1)))
    planes = _planes(xyz, number, (grid.rows, grid.columns), grid.edge)
    planes = planes._replace(roof=planes.roof & (_around(below, 1) <= planes.returns))
    able, planar = np.zeros((2, len(xyz)), np.bool_)
    for start in range(0, len(xyz), ROWS_AT_ONCE):
        part = slice(start, start + ROWS_AT_ONCE)
        able[part], planar[part] = _planar(xyz[part], np.divmod(number[part], shape[1]), planes)
    cells = shape[0] * shape[1]
    total, flat = (
        _around(np.bincount(of, minlength=cells).reshape(shape), AROUND).ravel()[number]
        for of in (number, number[planar])
    )
    building = planar & (flat >= MANY * total) | (flat >= MOST * total)
    return able, building


def _planar(
    xyz: NDArray[np.int32], cell: tuple[NDArray[np.int64], NDArray[np.int64]], planes: _Planes
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which returns have windows that suffice, and which lie near a roof's plane."""
    able, planar = np.zeros((2, len(xyz)), np.bool_)
    rows, columns = planes.roof.shape
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            at = np.clip(cell[0] + i, 0, rows - 1), np.clip(cell[1] + j, 0, columns - 1)
            able |= planes.returns[at] >= FEWEST
            away = xyz[:, 2] - planes.z[at]
            away -= planes.east[at] * (xyz[:, 0] - planes.x[at])
            away -= planes.north[at] * (xyz[:, 1] - planes.y[at])
            planar |= planes.roof[at] & (np.abs(away) <= NEAR_SIGMA * planes.sigma[at])
    return able, planar


def _around(values: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    """Sum over the cells up to so many on each side, whole numbers."""
    for axis in (0, 1):
        pad = [(reach + 1, reach) if k == axis else (0, 0) for k in (0, 1)]
        run = np.cumsum(np.pad(values, pad), axis=axis)
        size = values.shape[axis]
        ends = [np.take(run, np.arange(k, k + size), axis=axis) for k in (2 * reach + 1, 0)]
        values = ends[0] - ends[1]
    return values


def _planes(
    xyz: NDArray[np.int32], number: NDArray[np.int64], shape: tuple[int, int], edge: int
) -> _Planes:
    """Planes by least squares; sums are whole numbers, so that no order matters."""
    order = np.argsort(number, kind="stable")
    held = number[order]
    first = np.flatnonzero(np.diff(held, prepend=-1))
    x, y, z = (xyz[order, k].astype(np.int64) for k in range(3))

    def added(values: NDArray[np.int64]) -> NDArray[np.int64]:
        sums = np.zeros(shape[0] * shape[1], np.int64)
        if len(first):
            sums[held[first]] = np.add.reduceat(values, first)
        return _around(sums.reshape(shape), 1)

    n = added(np.ones_like(x))
    count = np.maximum(n, 1)
    mx, my, mz = (added(axis) / count for axis in (x, y, z))
    xx, xy, yy = (
        added(x * x) / count - mx * mx,
        added(x * y) / count - mx * my,
        added(y * y) / count - my * my,
    )
    xz, yz, zz = (
        added(x * z) / count - mx * mz,
        added(y * z) / count - my * mz,
        added(z * z) / count - mz * mz,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy * xy
        east, north = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
        square = np.maximum(zz - east * xz - north * yz, 0.0) * n / np.maximum(n - 3, 1)
    narrowest = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    roof = (n >= FEWEST) & (narrowest >= (WIDE * 3 * edge) ** 2)
    roof &= (square <= quanta(FLAT_M) ** 2) & (np.hypot(east, north) <= STEEPEST)
    # Returns of one line have no plane, and no slope that could be multiplied.
    east, north, sigma = (np.where(roof, values, 0.0) for values in (east, north, np.sqrt(square)))
    return _Planes(n, roof, mx, my, mz, east, north, sigma)
