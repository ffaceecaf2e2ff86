"""Delivered rasters: cloud-optimised GeoTIFF."""

import shutil
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.transform import Affine
from rasterio.windows import Window

from spl_batch.constants import NODATA
from spl_batch.errors import InputError, StoppedError
from spl_batch.io.atomic import replacing

Blocks = Iterable[tuple[int, int, NDArray[np.float32]]]
"""First row, first column and values of pieces of a raster, row 0 northernmost."""

TILE_PX: Final = 256
"""Edge of a COG's internal tile [cells]."""

CACHE_BYTES: Final = 64 * 2**20
"""GDAL's block cache while a COG is written: memory does not grow with the raster [bytes]."""


def write_cog(
    path: Path,
    blocks: NDArray[np.float32] | Blocks,
    *,
    shape: tuple[int, int],
    origin_xy_m: tuple[float, float],
    cell_m: float,
    crs: str | None,
    description: str,
    nodata: float = NODATA,
) -> None:
    """Write a cloud-optimised GeoTIFF: tiled, deflated, with overviews; equal input, equal bytes.

    Parameters
    ----------
    path : Path
        Destination; replaced only by a finished file.
    blocks : (rows, cols) float32, or iterable of (row, col, block)
        The raster, or pieces of it in any order; what no piece covers is nodata.
    shape : (int, int)
        Rows and columns, both > 0.
    origin_xy_m : (float, float)
        Easting and northing of the upper left corner [m].
    cell_m : float
        Edge of a cell [m].
    crs : str, optional
        Anything that GDAL understands as a CRS: EPSG code, WKT.
    description : str
        Name of the band.
    nodata : float
        Value of cells that hold nothing.

    Raises
    ------
    StoppedError
        If the disk is full.
    WorkflowError
        If the place cannot be written.
    InputError
        If ``crs`` is not understood.
    """
    pieces: Blocks = [(0, 0, blocks)] if isinstance(blocks, np.ndarray) else blocks
    try:
        known_crs = None if crs is None else rasterio.crs.CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(str(path), f"CRS {crs!r} is not understood: {error}") from None
    profile = {
        "driver": "GTiff",
        "height": shape[0],
        "width": shape[1],
        "count": 1,
        "dtype": "float32",
        "nodata": nodata,
        "crs": known_crs,
        "transform": Affine(cell_m, 0.0, origin_xy_m[0], 0.0, -cell_m, origin_xy_m[1]),
    }
    try:
        with (
            replacing(path) as cog,
            TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder,
            rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES, GDAL_NUM_THREADS="1"),
        ):
            # Overviews and other by-products of GDAL come and go with the folder.
            plain, finished = Path(folder, "plain.tif"), Path(folder, "cog.tif")
            _write_plain(plain, pieces, profile, description)
            _add_overviews(plain, shape)
            _copy_as_cog(plain, finished)
            finished.replace(cog)
    except RasterioError as error:
        raise _stopped(path, shape, error) from error


def _write_plain(path: Path, pieces: Blocks, profile: dict[str, Any], description: str) -> None:
    """Write pieces as they come; uncompressed, so that rewriting a tile leaves no waste."""
    layout = {"tiled": True, "blockxsize": TILE_PX, "blockysize": TILE_PX, "sparse_ok": True}
    with rasterio.open(path, "w", bigtiff="if_safer", **layout, **profile) as out:
        out.set_band_description(1, description)
        for row, col, block in pieces:
            rows, cols = block.shape
            out.write(block.astype(np.float32, copy=False), 1, window=Window(col, row, cols, rows))


def _add_overviews(path: Path, shape: tuple[int, int]) -> None:
    """Overviews down to one tile, and one always: GDAL by itself leaves small rasters without."""
    factors = [2]
    while max(shape) // factors[-1] > TILE_PX:
        factors.append(2 * factors[-1])
    with rasterio.open(path, "r+") as raster:
        raster.build_overviews(factors, Resampling.average)


def _copy_as_cog(plain: Path, cog: Path) -> None:
    rasterio.shutil.copy(
        plain,
        cog,
        driver="COG",
        compress="deflate",
        predictor="yes",
        level=6,
        blocksize=TILE_PX,
        overviews="force_use_existing",
        overview_compress="deflate",
        bigtiff="if_safer",
        num_threads="1",
    )


def _free_bytes(folder: Path) -> int:
    return shutil.disk_usage(folder).free


def _stopped(path: Path, shape: tuple[int, int], error: RasterioError) -> StoppedError:
    """GDAL tells a full disk only in prose, so the free space is looked at."""
    needed = 2 * 4 * shape[0] * shape[1]
    if _free_bytes(path.parent) < needed:
        return StoppedError(f"{path}: disk full; free {needed // 10**6 + 1} MB and run again")
    return StoppedError(f"{path}: cannot be written: {' '.join(str(error).split())}")


def read_raster(path: Path) -> tuple[NDArray[np.float32], Affine, str | None]:
    """First band of a raster file.

    Parameters
    ----------
    path : Path
        Any raster that GDAL reads.

    Returns
    -------
    values : (rows, cols) float32
        The band; its nodata value becomes :data:`~spl_batch.constants.NODATA`.
    transform : Affine
        Cell (col, row) to easting and northing [m].
    crs : str or None
        WKT.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with rasterio.open(path) as source:
            values: NDArray[np.float32] = source.read(1).astype(np.float32)
            if source.nodata is not None:
                values[values == np.float32(source.nodata)] = NODATA
            return values, source.transform, source.crs.to_wkt() if source.crs else None
    except RasterioError as error:
        raise InputError(str(path), " ".join(str(error).split())) from None
