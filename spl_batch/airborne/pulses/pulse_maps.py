"""Maps of pulses that clients ask for: density of first and last returns, voids, swaths.

Domain: space. Each cell has its own value; only :mod:`~spl_batch.airborne.pulses.pulse_coverage`
looks at cells around it.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.pulses.pulse_coverage import SPACINGS, VOID_SPACINGS, EmptySquares
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.lattice.tiles import Bounds, inside

NAMES: Final = ("first_returns", "last_returns", "voids", "swaths")
"""Rasters that :class:`PulseMaps` makes."""


class PulseMaps:
    """Maps of a region, made of its pulses part by part.

    Parameters
    ----------
    core : Bounds
        The region [quanta].
    size : int
        Edge of a raster cell [quanta].
    """

    def __init__(self, core: Bounds, size: int) -> None:
        self._core, self._size = core, size
        self._shape = (core.ymax - core.ymin) // size, (core.xmax - core.xmin) // size
        self._empty = EmptySquares(core)
        self._first, self._last, self._swaths = np.zeros((3, *self._shape))

    def add(
        self, first: NDArray[np.int64], last: NDArray[np.int64], line: NDArray[np.int64]
    ) -> None:
        """Take some pulses in.

        Parameters
        ----------
        first, last : (n, 2) int64
            Places of first and of last returns, the first of those that lie around the region too;
            all of a raster cell come at once [quanta].
        line : (n,) int64
            Flightline of each first return.
        """
        self._empty.add(first[:, 0], first[:, 1])
        self._first += _counts(first, self._core, self._shape)
        self._last += _counts(last, self._core, self._shape)
        self._swaths += _swaths(first, line, self._core, self._shape)

    def rasters(
        self, flown: NDArray[np.bool_], judged: NDArray[np.bool_]
    ) -> dict[str, NDArray[np.float32]]:
        """What was made.

        Parameters
        ----------
        flown : (rows, cols) bool
            Which raster cells were flown, row 0 southernmost.
        judged : (rows, cols) bool
            Which of them voids are looked for in: with signal around, no water.

        Returns
        -------
        dict of str to (rows, cols) float32
            Row 0 northernmost, nodata where nothing was flown: ``first_returns`` and
            ``last_returns`` [1/m2]; ``voids``, edge of the largest empty square of four nominal
            spacings that covers the cell's centre, 0 without any, nodata where nothing was judged
            [m]; ``swaths``, flightlines with a first return in the cell [count].
        """
        area_m2 = (self._size * QUANTUM_M) ** 2
        voids = np.where(judged, 0.0, np.nan)
        for spacing in sorted(SPACINGS.values()):
            _, empty = self._empty.coverage(judged, spacing)
            voids[empty] = VOID_SPACINGS * spacing * QUANTUM_M
        found = {
            "first_returns": self._first / area_m2,
            "last_returns": self._last / area_m2,
            "voids": voids,
            "swaths": self._swaths,
        }
        return {name: _delivered(values, flown) for name, values in found.items()}


def _cells(xy: NDArray[np.int64], core: Bounds, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Number of the cell of each place within the region, and which places lie there."""
    size = (core.xmax - core.xmin) // shape[1]
    number: NDArray[np.int64] = (xy[:, 1] - core.ymin) // size * shape[1]
    return number + (xy[:, 0] - core.xmin) // size


def _counts(xy: NDArray[np.int64], core: Bounds, shape: tuple[int, ...]) -> NDArray[np.float64]:
    mine = xy[inside(xy[:, 0], xy[:, 1], core)]
    counts = np.bincount(_cells(mine, core, shape), minlength=shape[0] * shape[1])
    return counts.reshape(shape).astype(np.float64)


def _swaths(
    xy: NDArray[np.int64], line: NDArray[np.int64], core: Bounds, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    mine = inside(xy[:, 0], xy[:, 1], core)
    cells = shape[0] * shape[1]
    pairs = np.unique(line[mine] * cells + _cells(xy[mine], core, shape))
    return np.bincount(pairs % cells, minlength=cells).reshape(shape).astype(np.float64)


def _delivered(values: NDArray[np.float64], flown: NDArray[np.bool_]) -> NDArray[np.float32]:
    north_up = np.where(flown & ~np.isnan(values), values, NODATA)[::-1]
    return np.ascontiguousarray(north_up, dtype=np.float32)
