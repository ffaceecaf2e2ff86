"""Parts and overviews of delivered rasters in metres, for statistics and pictures.

A file states itself what its units are: by its CRS those of its cells, by its band those of values.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window

from spl_batch.constants import NODATA
from spl_batch.errors import DamagedError
from spl_batch.formats.units import Units, metres_in

BLOCK: Final = 1024
"""Rows and columns of a raster that are read or made at once [cells]."""

EVEN: Final = 1e-6
"""An edge this near to one of a cell lies on it [cells]."""

LARGEST: Final = 1200
"""Cells that a side of an overview may have [count]."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells of a raster where they lie."""

    rows: int
    columns: int
    #: left_m, top_m: easting and northing of the upper left corner [m].
    left_m: float
    top_m: float
    cell_m: float

    def cells(
        self, xy_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Row and column of each point, and whether the raster reaches there."""
        # A northing on a cell's lower edge belongs to that cell: cells are half-open upward.
        row = -np.floor((xy_m[:, 1] - self.top_m) / self.cell_m).astype(np.int64) - 1
        col = np.floor((xy_m[:, 0] - self.left_m) / self.cell_m).astype(np.int64)
        return row, col, (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.columns)


@dataclass(frozen=True, slots=True)
class RasterPart:
    """Values and where they lie."""

    values: NDArray[np.float32]  #: (rows, cols): row 0 northernmost; nodata as in the file.
    #: left_m, top_m: easting and northing of the upper left corner [m].
    left_m: float
    top_m: float
    cell_m: float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """West, east, south and north edges [m]."""
        rows, cols = self.values.shape
        right, bottom = self.left_m + cols * self.cell_m, self.top_m - rows * self.cell_m
        return (self.left_m, right, bottom, self.top_m)

    @property
    def grid(self) -> Grid:
        """Its cells."""
        rows, columns = self.values.shape
        return Grid(rows, columns, self.left_m, self.top_m, self.cell_m)

    def at(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value of the cell that each point lies in: (n,) float64; NaN where there is none."""
        row, col, held = self.grid.cells(xy_m)
        out = np.full(len(xy_m), np.nan)
        out[held] = known(self.values[row[held], col[held]])
        return out

    def bilinear(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value between the four cell centres around each point (n, 2) [m]; NaN if one is void."""
        rows, cols = self.values.shape
        v = (self.top_m - xy_m[:, 1]) / self.cell_m - 0.5
        u = (xy_m[:, 0] - self.left_m) / self.cell_m - 0.5
        # A point exactly on the last centre has its four centres on the near side.
        r = np.minimum(np.floor(v), np.where(v == rows - 1, rows - 2, rows)).astype(np.int64)
        c = np.minimum(np.floor(u), np.where(u == cols - 1, cols - 2, cols)).astype(np.int64)
        held = (r >= 0) & (r < rows - 1) & (c >= 0) & (c < cols - 1)
        out = np.full(len(xy_m), np.nan)
        r, c, fv, fu = r[held], c[held], (v - r)[held], (u - c)[held]
        upper = known(self.values[r, c]) * (1 - fu) + known(self.values[r, c + 1]) * fu
        lower = known(self.values[r + 1, c]) * (1 - fu) + known(self.values[r + 1, c + 1]) * fu
        out[held] = upper * (1 - fv) + lower * fv
        return out

    def sampled(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """As :meth:`bilinear`; beside voids, and at the rim, the value of the point's cell."""
        cell, between = self.at(xy_m), self.bilinear(xy_m)
        return np.where(np.isnan(cell) | np.isnan(between), cell, between)


def known(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Float64 with NaN for nodata."""
    return np.where(values == np.float32(NODATA), np.nan, values.astype(np.float64))


def read_overview(path: Path, largest: int = LARGEST) -> RasterPart:
    """Raster, averaged so that no side has more cells than ``largest``.

    Raises
    ------
    DamagedError
        If the raster cannot be read: it can be made again.
    """
    with opened(path) as source:
        step, shape = _reduced(source.shape, largest)
        # A window beyond the edge keeps cells square where the step does not divide it.
        values = source.read(
            1,
            window=Window(0, 0, shape[1] * step, shape[0] * step),
            out_shape=shape,
            boundless=step > 1,
            fill_value=source.nodata,
            resampling=Resampling.average if step > 1 else Resampling.nearest,
        )
        return _part(source, values, (0, 0), step)


def overview_frame(path: Path) -> tuple[int, int, float, float, float]:
    """Rows, columns, left and upper edge and edge of a cell of :func:`read_overview` [count, m].

    Raises
    ------
    DamagedError
        If the raster cannot be read: it can be made again.
    """
    with opened(path) as source:
        step, shape = _reduced(source.shape, LARGEST)
        left_m, top_m, cell_m = geotransform_m(source)
        return (*shape, left_m, top_m, cell_m * step)


def read_part(path: Path, bounds_m: tuple[float, float, float, float]) -> RasterPart | None:
    """Cells that a region touches, and one more around; None where the raster has none.

    ``bounds_m``: (float, float, float, float), west, south, east, north [m].

    Raises
    ------
    DamagedError
        If the raster cannot be read: it can be made again.
    """
    with opened(path) as source:
        left, top, cell = geotransform_m(source)
        west, south, east, north = bounds_m
        row, col = (max(math.floor(side / cell) - 1, 0) for side in (top - north, west - left))
        rows = min(math.ceil((top - south) / cell) + 1, source.height) - row
        cols = min(math.ceil((east - left) / cell) + 1, source.width) - col
        if rows < 1 or cols < 1:
            return None
        values = source.read(1, window=Window(col, row, cols, rows))
        return _part(source, values, (row, col), 1)


@contextmanager
def opened(path: Path, **options: int) -> Iterator[Any]:
    """A delivered raster to read, by rasterio's options.

    Raises
    ------
    DamagedError
        If it cannot be read: it can be made again.
    """
    try:
        with rasterio.open(path, **options) as source:
            yield source
    except RasterioError as error:
        raise DamagedError(path, error) from error


def windows(whole: Window, edge: int, *, beyond: int = 0) -> Iterator[Window]:
    """Pieces of a window, each up to ``edge`` cells wide and high.

    ``beyond``: cells that a piece shares with the next one.
    """
    top, left = int(whole.row_off), int(whole.col_off)
    bottom, right = top + int(whole.height), left + int(whole.width)
    for row, col in product(range(top, bottom, edge), range(left, right, edge)):
        width, height = min(edge + beyond, right - col), min(edge + beyond, bottom - row)
        yield Window(col, row, width, height)


def cells_between(low: float, high: float) -> tuple[int, int]:
    """First cell that two edges [cells] include a part of, and the one past the last."""
    return math.floor(low + EVEN), math.ceil(high - EVEN)


def centres(
    corner: tuple[float, float], cell: float, window: Window
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eastings and northings of a window's cells, (rows, columns) each.

    ``corner``: left and upper edge of the raster, in the unit of ``cell``.
    """
    east = corner[0] + (window.col_off + np.arange(window.width) + 0.5) * cell
    north = corner[1] - (window.row_off + np.arange(window.height) + 0.5) * cell
    x, y = np.meshgrid(east, north)
    return x, y


def _reduced(size: tuple[int, int], largest: int) -> tuple[int, tuple[int, int]]:
    """Cells along a side of one of an overview's, and the overview's shape."""
    step = max(1, math.ceil(max(size) / largest))
    rows, columns = (math.ceil(side / step) for side in size)
    return step, (rows, columns)


def _part(source: Any, values: NDArray[Any], first: tuple[int, int], step: int) -> RasterPart:
    """Values from a row and a column on, each of ``step`` cells of the raster."""
    left, top, cell = geotransform_m(source)
    left_m, top_m = left + first[1] * cell, top - first[0] * cell
    unit_m = metres_in(source.units[0] or "") or 1.0
    if unit_m != 1.0:
        values = np.where(values == source.nodata, source.nodata, values * np.float64(unit_m))
    return RasterPart(values.astype(np.float32), left_m, top_m, cell * step)


def geotransform_m(source: Any) -> tuple[float, float, float]:
    """Left and upper edge of a raster and edge of its cells, in metres on its axes [m]."""
    placed = source.transform.c, source.transform.f, source.transform.a
    crs = CRS.from_wkt(source.crs.to_wkt()) if source.crs else None
    unit_m = Units.of(crs).horizontal_m
    # Edges are whole millimetres; what a factor and its inverse leave of one is not.
    left, top, cell = placed if unit_m == 1.0 else (round(v * unit_m, 6) for v in placed)
    return left, top, cell
