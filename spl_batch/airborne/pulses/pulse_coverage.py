"""How evenly first returns cover the ground: density, spatial distribution, data voids.

Source: USGS Lidar Base Specification, Collection Requirements: nominal pulse density and spacing;
spatial distribution, 90 % of the squares of twice the nominal spacing hold a first return; data
voids, areas of (4 x spacing)^2 without one.

Squares lie on absolute grids, so that no tiling changes them. All swaths count together: voids may
be filled by another one. Single swaths are those of
:mod:`~spl_batch.airborne.pulses.swath_coverage`. Deviations: a void is a whole empty square of four
spacings, not any shape of its area; only places that were flown count
(:mod:`~spl_batch.airborne.products.flown_cells`).
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.pulses.square_kernels import mark_squares
from spl_batch.constants import NODATA
from spl_batch.lattice.tiles import Bounds, grow

SPACINGS: Final[Mapping[str, int]] = {"QL1": 350, "QL2": 710, "QL3": 1410}
"""Aggregate nominal pulse spacing of a quality level, that of QL0 is QL1's [quanta]; USGS Lidar
Base Specification, table of nominal pulse spacing and density."""

VOID_SPACINGS: Final = 4
"""Edge of a data void [spacings]."""

MARGIN: Final = 2 * VOID_SPACINGS
"""Squares around a region that decide on those in it [spacings]."""


class Coverage(NamedTuple):
    """Squares of a region that were flown, water excepted; counts of several regions add up."""

    #: Squares of twice the spacing; those that hold a first return [count].
    squares: int
    filled: int
    #: Squares of the spacing; those that lie in a data void [count].
    places: int
    void: int


def reach_q() -> int:
    """How far around a region :class:`EmptySquares` looks [quanta]."""
    return (MARGIN + 2) * max(SPACINGS.values())


class EmptySquares:
    """Squares of the nominal spacings in and around a region that hold no first return.

    Parameters
    ----------
    core : Bounds
        The region [quanta].
    """

    def __init__(self, core: Bounds) -> None:
        self._core = core
        self._whole = {spacing: _whole(core, spacing) for spacing in SPACINGS.values()}
        self._held = {
            spacing: np.zeros(
                ((whole.ymax - whole.ymin) // spacing, (whole.xmax - whole.xmin) // spacing),
                np.bool_,
            )
            for spacing, whole in self._whole.items()
        }

    def add(self, x: NDArray[np.int64], y: NDArray[np.int64]) -> None:
        """Look at some first returns of the region and of :func:`reach_q` around it, in any order.

        Parameters
        ----------
        x, y : (n,) int64
            Places [quanta].
        """
        x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
        for spacing, whole in self._whole.items():
            west, south = whole.xmin // spacing, whole.ymin // spacing
            mark_squares(x, y, west, south, spacing, self._held[spacing])

    def coverage(
        self, flown: NDArray[np.bool_], spacing: int
    ) -> tuple[Coverage, NDArray[np.bool_]]:
        """Squares of the region by one spacing.

        Parameters
        ----------
        flown : (rows, cols) bool
            Which of its raster cells were flown and are no water, row 0 southernmost.
        spacing : int
            Nominal pulse spacing [quanta].

        Returns
        -------
        coverage : Coverage
            Counts of the squares whose centres lie in the region.
        void : (rows, cols) bool
            Which raster cells have their centre in a data void, row 0 southernmost.
        """
        core, empty, whole = self._core, ~self._held[spacing], self._whole[spacing]
        i, j = whole.xmin // spacing, whole.ymin // spacing
        void = _opened(empty, VOID_SPACINGS)
        size = (core.xmax - core.xmin) // flown.shape[1]
        places, in_void = _counted(void, i, j, spacing, core, flown, size)
        # Two by two squares, the first of them of even number.
        pairs = empty[j % 2 :, i % 2 :]
        rows, cols = (side // 2 * 2 for side in pairs.shape)
        halves = pairs[:rows:2, :cols] & pairs[1:rows:2, :cols]
        bare: NDArray[np.bool_] = halves[:, ::2] & halves[:, 1::2]
        west, south = (i + i % 2) // 2, (j + j % 2) // 2
        squares, unfilled = _counted(bare, west, south, 2 * spacing, core, flown, size)
        col = (np.arange(core.xmin + size // 2, core.xmax, size) // spacing) - i
        row = (np.arange(core.ymin + size // 2, core.ymax, size) // spacing) - j
        of_cells = void.take(row, axis=0).take(col, axis=1) & flown
        return Coverage(squares, squares - unfilled, places, in_void), of_cells


def _whole(core: Bounds, spacing: int) -> Bounds:
    """Whole squares that decide on those of a region [quanta]."""
    wide = grow(core, MARGIN * spacing)
    west, south = (low // spacing * spacing for low in wide[:2])
    return Bounds(west, south, *((high // spacing + 1) * spacing for high in wide[2:]))


def _opened(empty: NDArray[np.bool_], edge: int) -> NDArray[np.bool_]:
    """Squares that lie in some empty square of so many times their edge."""
    begins = np.zeros_like(empty)
    rows, cols = (max(side - edge + 1, 0) for side in empty.shape)
    begins[:rows, :cols] = True
    for k in range(edge):
        begins[:rows] &= empty[k : k + rows]
    across = begins.copy()
    for k in range(1, edge):
        begins[:, :cols] &= across[:, k : k + cols]
    begins[:, cols:] = False
    opened = begins.copy()
    for k in range(1, edge):
        opened[k:] |= begins[:-k]
    down = opened.copy()
    for k in range(1, edge):
        opened[:, k:] |= down[:, :-k]
    return opened


def _counted(
    marked: NDArray[np.bool_],
    i: int,
    j: int,
    edge: int,
    core: Bounds,
    flown: NDArray[np.bool_],
    size: int,
) -> tuple[int, int]:
    """Squares whose centres lie where a region was flown, and how many of them are marked."""
    rows, cols = marked.shape
    x = (i + np.arange(cols)) * edge + edge // 2
    y = (j + np.arange(rows)) * edge + edge // 2
    col, row = (x - core.xmin) // size, (y - core.ymin) // size
    west, south = (col >= 0) & (col < flown.shape[1]), (row >= 0) & (row < flown.shape[0])
    there = flown.take(row[south], axis=0).take(col[west], axis=1)
    found = marked[south][:, west] & there
    return int(np.count_nonzero(there)), int(np.count_nonzero(found))


def not_flown(raster: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Cells of a delivered density raster that were not flown, row 0 southernmost."""
    nothing: NDArray[np.bool_] = raster[::-1] == np.float32(NODATA)
    return nothing
