"""Area that the returns of a ground cell cover, whatever the raster cells are.

Squares of a fixed absolute grid that hold a return count, and gaps between them as in
:mod:`~spl_batch.airborne.products.flown_cells`, which says where ``density.tif`` has a value. There
a raster cell at the edge of a survey counts as a whole, so coarse cells would cover more. Around
sparse returns a rim of half their mean spacing counts too. Each square belongs to one ground cell,
so areas add up.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.flown_cells import about_ground, close, ground_heights
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta, shared
from spl_batch.numerics.nearest_cells import within_discs

DOMAIN: Final = "space"
"""Needs every flightline of a place."""

SQUARE_Q: Final = 250
"""Edge of a square [quanta]: at the edge of a plot of 20 m half a square is 1 % of its width."""

SQUARE_M2: Final = (SQUARE_Q * QUANTUM_M) ** 2
"""Area of a square [m2]."""

COARSE: Final = 4
"""Squares along those that tell soon that all of a cell is covered [count]."""

WIDEST_RIM: Final = 20
"""Half the mean spacing of returns, up to which they stand for what lies around [squares]."""

Within = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]
"""Which places, by easting and northing [quanta], count."""


class Covered:
    """Squares of a ground cell that some returns cover.

    Off the edge of a swath, and of a lake, there is noise but no signal: what is covered depends on
    which returns are asked.

    Parameters
    ----------
    cell : Bounds
        The ground cell [quanta].
    settings : ProductSettings
        The widest void; twice as far around the cell returns are looked at.
    """

    def __init__(self, cell: Bounds, settings: ProductSettings) -> None:
        self._wide = _squares(grow(cell, quanta(2 * settings.void_max_m)))
        self._core = _squares(cell)
        # the margin is that of two discs; a square's own width is taken off them
        self._reach = quanta(settings.void_max_m) // SQUARE_Q - 1
        self._held = np.zeros(_shape(self._wide), np.bool_)
        self._count = 0

    @property
    def region(self) -> Bounds:
        """What is looked at [quanta]."""
        return _quanta(self._wide)

    def add(self, x: NDArray[np.int64], y: NDArray[np.int64]) -> None:
        """Look at some returns, in any order [quanta]; each comes once."""
        near = inside(x, y, self.region)
        row, column = y[near] // SQUARE_Q, x[near] // SQUARE_Q
        self._held[row - self._wide.ymin, column - self._wide.xmin] = True
        self._count += len(row)

    def squares(self) -> NDArray[np.bool_]:
        """Squares of :func:`whole_squares`, from the south: (rows, cols) bool."""
        covered = np.zeros(_shape(self._core), np.bool_)
        if not self._count:
            return covered
        if self._all_is_near():
            return ~covered
        row, column = (np.flatnonzero(self._held.any(axis=axis)) for axis in (1, 0))
        west, south = self._wide.xmin, self._wide.ymin
        hull = Bounds(
            west + int(column[0]), south + int(row[0]),
            west + int(column[-1]) + 1, south + int(row[-1]) + 1,
        )  # fmt: skip
        # farther out than a disc nothing is covered
        around = shared(grow(hull, self._reach + 2), self._wide)
        held = self._held[_place(around, self._wide)]
        closed = _with_rim(close(held, self._reach), self._count)
        mine = shared(around, self._core)
        if mine.area_m2 > 0:
            covered[_place(mine, self._core)] = closed[_place(mine, around)]
        return covered

    def _all_is_near(self) -> bool:
        """Whether coarse squares already tell that no place is far from all returns."""
        reach = self._reach // COARSE - 2
        if reach < 1:
            return False
        south, west = self._wide.ymin % COARSE, self._wide.xmin % COARSE
        rows, cols = self._held.shape
        after = -(south + rows) % COARSE, -(west + cols) % COARSE
        whole = np.pad(self._held, ((south, after[0]), (west, after[1])))
        # Squares that lie side by side are read as one number.
        blocks = whole.view(f"u{COARSE}").reshape(len(whole) // COARSE, COARSE, -1)
        held: NDArray[np.bool_] = np.any(blocks, axis=1)
        return bool(within_discs(held, reach).all())


def footprint(
    table: PointTable, cell: Bounds, settings: ProductSettings, within: Within | None = None
) -> NDArray[np.bool_]:
    """Squares of a ground cell that were flown: covered by returns about as high as its ground.

    Parameters
    ----------
    table : PointTable
        Points of the cell and twice the widest void around it, with ``x, y, z, ground``.
    cell, settings
        As of :class:`Covered`.
    within : callable, optional
        Which squares count, by their centres.

    Returns
    -------
    (rows, cols) bool
        Squares of :func:`whole_squares`, from the south.
    """
    covered = Covered(cell, settings)
    region = covered.region
    there = about_ground(table, region, ground_heights(table, region))
    covered.add(table["x"][there], table["y"][there])
    squares = covered.squares()
    return squares if within is None else refused(squares, cell, within)


def whole_squares(cell: Bounds) -> Bounds:
    """The squares whose south-western corner a ground cell owns [quanta]."""
    return _quanta(_squares(cell))


def refused(covered: NDArray[np.bool_], cell: Bounds, within: Within) -> NDArray[np.bool_]:
    """Squares without those whose centre ``within`` refuses; shapes as of :func:`footprint`."""
    row, column = np.nonzero(covered)
    core, half = _squares(cell), SQUARE_Q // 2
    east, north = (core.xmin + column) * SQUARE_Q + half, (core.ymin + row) * SQUARE_Q + half
    kept = np.zeros_like(covered)
    kept[row, column] = within(east, north)
    return kept


def _squares(region: Bounds) -> Bounds:
    """Columns and rows of squares whose south-western corner a region owns."""
    return Bounds(*(-(-side // SQUARE_Q) for side in region))


def _quanta(squares: Bounds) -> Bounds:
    return Bounds(*(side * SQUARE_Q for side in squares))


def _shape(squares: Bounds) -> tuple[int, int]:
    return squares.ymax - squares.ymin, squares.xmax - squares.xmin


def _with_rim(closed: NDArray[np.bool_], points: int) -> NDArray[np.bool_]:
    """Squares with those that lie less than half the mean spacing from one.

    Sparse returns end inside the place that they stand for; a held square already reaches half its
    width beyond its returns.
    """
    spacing = np.sqrt(np.count_nonzero(closed) / points)
    rim = min(spacing / 2 - 0.5, WIDEST_RIM)
    if rim < 1:
        return closed
    return within_discs(closed, rim)


def _place(part: Bounds, frame: Bounds) -> tuple[slice, slice]:
    """Rows and columns of a part of a frame."""
    return (
        slice(part.ymin - frame.ymin, part.ymax - frame.ymin),
        slice(part.xmin - frame.xmin, part.xmax - frame.xmin),
    )
