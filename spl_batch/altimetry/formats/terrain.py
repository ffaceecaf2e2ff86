"""Heights of a terrain raster at geographic points."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import Transformer
from rasterio.errors import NotGeoreferencedWarning
from rasterio.windows import Window
from scipy import ndimage

from spl_batch.errors import InputError, as_input_fault
from spl_batch.formats.declared import bounded
from spl_batch.formats.vector_files import refuse_referring

_BLOCK: Final = 512

_BLOCK_BYTES_MAX: Final = 256 << 20
"""A block of a raster is decoded at once [byte]."""

_TILE_IT: Final = "write it in tiles (gdal_translate -co TILED=YES)"


def sample_terrain(
    path: Path, latitude: NDArray[np.float64], longitude: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Terrain height between the four nearest cell centres of band 1, (n,) float64 [m].

    ``latitude``, ``longitude``: (n,), WGS 84 [deg]; NaN gives NaN, as do points outside and nodata.
    A raster of any size is read by blocks.

    Raises
    ------
    InputError
        If it cannot be read, or has no CRS.
    """
    refuse_referring(path, raster=True)
    heights = np.full(len(latitude), np.nan)
    with as_input_fault(path), _opened(path) as raster:
        transformer = Transformer.from_crs("EPSG:4326", raster.crs, always_xy=True)
        x, y = map(np.asarray, transformer.transform(longitude, latitude))
        # Values are those of the centres of cells.
        to_cell = ~raster.transform
        column = to_cell.a * x + to_cell.b * y + to_cell.c - 0.5
        row = to_cell.d * x + to_cell.e * y + to_cell.f - 0.5
        inside = (column >= 0) & (row >= 0)
        inside &= (column <= raster.width - 1) & (row <= raster.height - 1)
        rows = np.flatnonzero(inside)
        block = np.stack([row[rows] // _BLOCK, column[rows] // _BLOCK]).astype(np.int64)
        for which in np.unique(block, axis=1).T:
            mine = rows[(block == which[:, None]).all(axis=0)]
            heights[mine] = _between(raster, which * _BLOCK, row[mine], column[mine])
    return heights


def extent_deg(path: Path) -> tuple[float, float, float, float]:
    """West, south, east and north end of a raster, WGS 84 [deg].

    Raises
    ------
    InputError
        If it cannot be read, or has no CRS.
    """
    with as_input_fault(path), _opened(path) as raster:
        transformer = Transformer.from_crs(raster.crs, "EPSG:4326", always_xy=True)
        west, south, east, north = transformer.transform_bounds(*raster.bounds)
    return west, south, east, north


@contextmanager
def _opened(path: Path) -> Iterator[rasterio.DatasetReader]:
    """A raster whose cells have a geotransform, and whose blocks can be held."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", NotGeoreferencedWarning)
        try:
            raster = rasterio.open(path)
        except NotGeoreferencedWarning:
            text = "does not state where its cells lie; write a geotransform (gdal_edit -a_ullr)"
            raise InputError(str(path), text) from None
    with raster:
        if raster.crs is None:
            raise InputError(str(path), "raster without a CRS; give it one (gdal_edit -a_srs)")
        tall, wide = raster.block_shapes[0]
        size = tall * wide * np.dtype(raster.dtypes[0]).itemsize
        bounded(path, "bytes of a block", size, least=1, most=_BLOCK_BYTES_MAX, remedy=_TILE_IT)
        yield raster


def _between(
    raster: rasterio.DatasetReader,
    corner: NDArray[np.int64],
    row: NDArray[np.float64],
    column: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Bilinear heights within one block and the cells beside it."""
    top, left = int(corner[0]), int(corner[1])
    tall = min(_BLOCK + 1, raster.height - top)
    wide = min(_BLOCK + 1, raster.width - left)
    values = raster.read(1, window=Window(left, top, wide, tall), masked=True)
    cells = values.astype(np.float64).filled(np.nan)
    centre = [row - top, column - left]
    height: NDArray[np.float64] = ndimage.map_coordinates(cells, centre, order=1, mode="nearest")
    return height
