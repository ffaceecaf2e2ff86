"""Area that the returns of a ground cell cover, whatever the raster cells are.

Squares of a fixed absolute grid that hold a return count, and gaps between them as in
:mod:`~spl_batch.airborne.products.flown_cells`, which says where ``density.tif`` has a value. There
a raster cell at the edge of a survey counts as a whole, so coarse cells would cover more. Around
sparse returns a rim of half their mean spacing counts too. Each square belongs to one ground cell,
so that areas add up.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from spl_batch.airborne.products.flown_cells import about_ground, close
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta, shared

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

ENOUGH: Final = 100_000
"""Points that are looked at for that, evenly among more of them [count]."""

Within = Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]
"""Which places, by easting and northing [quanta], count."""


def footprint(
    table: PointTable, cell: Bounds, settings: ProductSettings, within: Within | None = None
) -> NDArray[np.bool_]:
    """Squares of a ground cell that its returns cover.

    Parameters
    ----------
    table : PointTable
        Points of the cell and of twice ``settings.void_max_m`` around it, in any order, with
        ``x, y, z, ground``.
    cell : Bounds
        The ground cell [quanta].
    within : callable, optional
        Takes the centres of squares; those that it refuses do not count.

    Returns
    -------
    (rows, cols) bool
        Squares of :func:`whole_squares`, from the south.
    """
    wide = _squares(grow(cell, quanta(2 * settings.void_max_m)))
    some = table.select(("x", "y", "ground")).take(slice(None, None, len(table) // ENOUGH + 1))
    some = some.take(some["ground"] == 1)

    def all_about_ground() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        there = about_ground(table, _quanta(wide))
        return table["x"][there], table["y"][there]

    covered = _covered(some["x"], some["y"], all_about_ground, cell, settings)
    return covered if within is None else refused(covered, cell, within)


def within_returns(
    x: NDArray[np.int64], y: NDArray[np.int64], cell: Bounds, settings: ProductSettings
) -> NDArray[np.bool_]:
    """Squares of a ground cell that some returns cover, such as those of signal.

    Off the edge of a swath, and of a lake, there is noise but no signal.

    Parameters
    ----------
    x, y : (n,) int64
        Returns of the cell and of twice ``settings.void_max_m`` around it, in any order [quanta].
    cell : Bounds
        The ground cell [quanta].

    Returns
    -------
    (rows, cols) bool
        As of :func:`footprint`.
    """
    near = inside(x, y, _quanta(_squares(grow(cell, quanta(2 * settings.void_max_m)))))
    step = slice(None, None, len(x) // ENOUGH + 1)
    return _covered(x[step], y[step], lambda: (x[near], y[near]), cell, settings)


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


def _held(column: NDArray[np.int64], row: NDArray[np.int64], frame: Bounds) -> NDArray[np.bool_]:
    """Squares of a frame that hold points, from the south."""
    held = np.zeros((frame.ymax - frame.ymin, frame.xmax - frame.xmin), np.bool_)
    held[row - frame.ymin, column - frame.xmin] = True
    return held


def _covered(
    some_x: NDArray[np.int64],
    some_y: NDArray[np.int64],
    everything: Callable[[], tuple[NDArray[np.int64], NDArray[np.int64]]],
    cell: Bounds,
    settings: ProductSettings,
) -> NDArray[np.bool_]:
    """Squares that returns cover; all of them are looked at where some do not tell."""
    wide, core = _squares(grow(cell, quanta(2 * settings.void_max_m))), _squares(cell)
    # the margin is that of two discs; a square's own width is taken off them
    reach = quanta(settings.void_max_m) // SQUARE_Q - 1
    if _cover_all(some_x, some_y, wide, reach // COARSE - 2):
        return np.ones((core.ymax - core.ymin, core.xmax - core.xmin), np.bool_)
    return _closed(*everything(), wide, core, reach)


def _cover_all(x: NDArray[np.int64], y: NDArray[np.int64], wide: Bounds, reach: int) -> bool:
    """Whether some of the returns already tell that no place is far from all of them."""
    there = inside(x, y, _quanta(wide))
    if reach < 1 or not there.any():
        return False
    edge = SQUARE_Q * COARSE
    frame = Bounds(
        wide.xmin // COARSE, wide.ymin // COARSE, -(-wide.xmax // COARSE), -(-wide.ymax // COARSE)
    )
    held = _held(x[there] // edge, y[there] // edge, frame)
    return bool((distance_transform_edt(~held) <= reach).all())


def _closed(
    x: NDArray[np.int64], y: NDArray[np.int64], wide: Bounds, core: Bounds, reach: int
) -> NDArray[np.bool_]:
    """Squares of the core that returns cover, as far as returns reach."""
    covered = np.zeros((core.ymax - core.ymin, core.xmax - core.xmin), np.bool_)
    column, row = x // SQUARE_Q, y // SQUARE_Q
    if not len(column):
        return covered
    hull = Bounds(int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1)
    # farther out than a disc nothing is covered
    around = shared(grow(hull, reach + 2), wide)
    closed = _with_rim(close(_held(column, row, around), reach), len(column))
    mine = shared(around, core)
    if mine.area_m2 > 0:
        covered[_place(mine, core)] = closed[_place(mine, around)]
    return covered


def _with_rim(closed: NDArray[np.bool_], points: int) -> NDArray[np.bool_]:
    """Squares with those that lie less than half the mean spacing from one.

    Sparse returns end inside the place that they stand for; a held square reaches half its width
    beyond its returns already.
    """
    spacing = np.sqrt(np.count_nonzero(closed) / points)
    rim = min(spacing / 2 - 0.5, WIDEST_RIM)
    if rim < 1:
        return closed
    near: NDArray[np.bool_] = distance_transform_edt(~closed) <= rim
    return near


def _place(part: Bounds, frame: Bounds) -> tuple[slice, slice]:
    """Rows and columns of a part of a frame."""
    return (
        slice(part.ymin - frame.ymin, part.ymax - frame.ymin),
        slice(part.xmin - frame.xmin, part.xmax - frame.xmin),
    )
