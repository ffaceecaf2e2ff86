"""Squares of single flightlines, and the plane through the first returns of each.

Domain: space, on first signal returns. Squares of :data:`SQUARE_M` lie on an absolute grid, so that
no tiling changes them. What holds a few returns of a flightline is a place; the plane by least
squares has its slope and thickness. Smooth surfaces
(:mod:`~spl_batch.airborne.pulses.smooth_surfaces`) are judged on such places.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.pulses.place_sums import add_up, number_places
from spl_batch.lattice.distinct import distinct
from spl_batch.lattice.tiles import Bounds, inside, quanta

DOMAIN: Final = "space"

SQUARE_M: Final = 8.0
"""Edge of a place [m]."""

RETURNS: Final = 24
"""Returns of a place, at least [count]."""


class Places(NamedTuple):
    """Places, and the returns in them."""

    rows: NDArray[np.intp]  #: (m,): which of all returns lie in a place.
    place: NDArray[np.intp]  #: (m,): which place.
    #: (m, 3): offsets from the place's corner and above its lowest return: what lies elsewhere
    #: changes no rounding [quanta].
    offset: NDArray[np.int64]
    line: NDArray[np.int64]  #: (k,): flightline of each place.
    #: (k,) each: rise to the east and north, standard deviation about the plane [quanta].
    east: NDArray[np.float64]
    north: NDArray[np.float64]
    thickness: NDArray[np.float64]

    @property
    def slope(self) -> NDArray[np.float64]:
        """(k,): slope of each place [rise/run]."""
        slope: NDArray[np.float64] = np.hypot(self.east, self.north)
        return slope


def places_in(first: NDArray[np.int64], line: NDArray[np.int64], core: Bounds) -> Places | None:
    """Places of a region; None where no square holds enough returns.

    Parameters
    ----------
    first : (n, 3) int64
        First signal returns in the region and around it, in any order [quanta].
    line : (n,) int64
        Flightline of each.
    core : Bounds
        The region: squares that lie in it as a whole count [quanta].
    """
    square = quanta(SQUARE_M)
    west, south = -(-core.xmin // square), -(-core.ymin // square)
    grid = _Grid(
        west * square, south * square, core.xmax // square - west, core.ymax // square - south
    )
    rows = np.flatnonzero(
        inside(first[:, 0], first[:, 1], Bounds(
            grid.west, grid.south,
            grid.west + grid.columns * square, grid.south + grid.rows * square,
        ))
    )  # fmt: skip
    if not len(rows):
        return None
    lines, rank = distinct(line)
    found = _places(first, rank, rows, grid)
    return None if found is None else found._replace(line=lines[found.line])


class _Grid(NamedTuple):
    """South-western corner of whole squares [quanta], and how many they are."""

    west: int
    south: int
    columns: int
    rows: int


def _places(
    first: NDArray[np.int64], rank: NDArray[np.intp], rows: NDArray[np.intp], grid: _Grid
) -> Places | None:
    """Places that some returns lie in; ``line`` is a rank. None where none holds enough."""
    square = quanta(SQUARE_M)
    xyz, at = first[rows], np.empty(len(rows), np.int64)
    number_places(xyz, rank[rows], grid.west, grid.south, square, grid.columns, grid.rows, at)
    squares = np.arange(0)
    if at.max(initial=0) > len(at):  # flightlines beyond number must not need memory for squares
        squares, at = distinct(at)
    full = np.bincount(at, minlength=1) >= RETURNS
    enough = full[at]
    if not enough.any():
        return None
    owner = np.flatnonzero(full)
    owner = squares[owner] if len(squares) else owner
    xyz, place = xyz[enough], (np.cumsum(full) - 1)[at[enough]]
    sums, low = np.zeros((len(owner), 10)), np.full(len(owner), np.iinfo(np.int64).max)
    add_up(xyz, grid.west, grid.south, square, place, low, sums)
    return Places(rows[enough], place, xyz, owner // (grid.rows * grid.columns), *_planes(sums))


def _planes(
    sums: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Slopes to the east and north [rise/run], and standard deviation [quanta], by place.

    Parameters
    ----------
    sums : (k, 10) float64
        Returns, and sums of x, y, z, xx, xy, yy, xz, yz, zz: of whole numbers below 2**53, exact in
        any order.
    """
    n, sx, sy, sz, xx, xy, yy, xz, yz, zz = sums.T
    n = np.maximum(n, 1)
    xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
    xz, yz, zz = xz - sx * sz / n, yz - sy * sz / n, zz - sz * sz / n
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy * xy
        east, north = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
        spread = np.sqrt(np.maximum(zz - east * xz - north * yz, 0.0) / (n - 3))
    lost = ~(determinant > 0) | (n <= 3)
    east, north, spread = (np.where(lost, np.inf, values) for values in (east, north, spread))
    return east, north, spread
