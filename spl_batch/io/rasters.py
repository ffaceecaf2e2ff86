"""Delivered rasters (cloud-optimised GeoTIFF) and the working raster store (Zarr).

The store's arrays cover one huge absolute index space, so that a raster cell has the same
index whatever the survey is, and each chunk is exactly one ground cell: a task writes its
own chunks and no other task's. Chunks that were never written take no space.
"""

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import numpy as np
import rasterio
import rasterio.shutil
import zarr
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.transform import Affine
from rasterio.windows import Window
from zarr.codecs import ZstdCodec
from zarr.errors import ContainsArrayError

from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.errors import InputError, StoppedError, StoreError
from spl_batch.io.atomic import replacing
from spl_batch.tiling import Bounds, CellId

Blocks = Iterable[tuple[int, int, NDArray[np.float32]]]
"""First row, first column and values of pieces of a raster, row 0 northernmost."""

TILE_PX: Final = 256
"""Edge of a COG's internal tile [cells]."""

CACHE_BYTES: Final = 64 * 2**20
"""GDAL's block cache while a COG is written: memory does not grow with the raster [bytes]."""

HALF_CELLS: Final = 2**20
"""Ground cells on each side of coordinate zero that the store has room for [count]."""


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


def create_raster_store(
    path: str, names: Sequence[str], *, ground_cell: int, raster_cell: int
) -> None:
    """Make the arrays of the working store; those that are there already are kept.

    Parameters
    ----------
    path : str
        Folder or URL of the Zarr group.
    names : sequence of str
        One float32 array each.
    ground_cell, raster_cell : int
        Edges of a chunk and of a raster cell [quanta]; the first a multiple of the second.

    Raises
    ------
    StoreError
        If the store was made for other cell sizes.
    """
    px, remainder = divmod(ground_cell, raster_cell)
    if remainder or px < 1:
        raise StoreError(f"{path}: {ground_cell} is not a whole multiple of {raster_cell} quanta")
    group = zarr.open_group(path, mode="a", zarr_format=3)
    side = 2 * HALF_CELLS * px
    facts: dict[str, Any] = {"ground_cell_quanta": ground_cell, "raster_cell_quanta": raster_cell}
    for name in names:
        try:
            group.create_array(
                name,
                shape=(side, side),
                chunks=(px, px),
                dtype="float32",
                fill_value=NODATA,
                compressors=ZstdCodec(level=3),
                attributes=facts,
            )
        except ContainsArrayError:
            # Another process, or an earlier run, has made it: fine when it is the same.
            found = dict(group[name].attrs)
            if found != facts:
                raise StoreError(f"{path}: {name} was made for {found}, not {facts}") from None


def _array(path: str, name: str, mode: Literal["r", "r+"]) -> tuple[Any, int, int]:
    """Array, cells per chunk side, edge of a raster cell [quanta]."""
    try:
        array: Any = zarr.open_array(f"{path}/{name}", mode=mode, zarr_format=3)
    except FileNotFoundError:
        raise StoreError(f"{path}: has no raster {name!r}") from None
    return array, array.chunks[0], int(array.attrs["raster_cell_quanta"])


def write_cell(path: str, cell: CellId, arrays: Mapping[str, NDArray[np.float32]]) -> None:
    """Write the rasters of one ground cell: one chunk each, replaced as a whole.

    Parameters
    ----------
    path : str
        Store from :func:`create_raster_store`.
    cell : CellId
        Column and row of the ground cell.
    arrays : mapping of str to (px, px) float32
        Rasters, row 0 northernmost.

    Raises
    ------
    StoreError
        If there is no such raster or its shape is not that of a chunk.
    StoppedError
        If the disk is full.
    """
    for name, values in arrays.items():
        array, px, _ = _array(path, name, "r+")
        if values.shape != (px, px):
            raise StoreError(f"{path}: {name} of cell {cell} is {values.shape}, not {(px, px)}")
        row = (HALF_CELLS - 1 - cell.j) * px
        col = (HALF_CELLS + cell.i) * px
        try:
            array[row : row + px, col : col + px] = values
        except OSError as error:
            raise StoppedError(f"{path}: cannot be written: {error.strerror}") from error


def cell_files(path: Path, cell: CellId, names: Iterable[str]) -> list[Path]:
    """Files of one ground cell's chunks; a chunk of nothing but nodata has none.

    Parameters
    ----------
    path : Path
        Store from :func:`create_raster_store`, a folder.
    cell : CellId
        Column and row of the ground cell.
    names : iterable of str
        Rasters.
    """
    row, col = HALF_CELLS - 1 - cell.j, HALF_CELLS + cell.i
    files = [path / name / "c" / str(row) / str(col) for name in names]
    return [file for file in files if file.exists()]


def read_window(path: str, name: str, bounds: Bounds) -> NDArray[np.float32]:
    """Part of a stored raster.

    Parameters
    ----------
    path : str
        Store from :func:`create_raster_store`.
    name : str
        Raster.
    bounds : Bounds
        Region [quanta]; its edges are whole multiples of the raster cell.

    Returns
    -------
    (rows, cols) float32
        Row 0 northernmost; nodata where nothing was written.

    Raises
    ------
    StoreError
        If there is no such raster or the region is not aligned to its cells.
    """
    array, px, size = _array(path, name, "r")
    if any(edge % size for edge in bounds):
        raise StoreError(f"{path}: {bounds} is not aligned to raster cells of {size} quanta")
    zero = HALF_CELLS * px
    rows = slice(zero - bounds.ymax // size, zero - bounds.ymin // size)
    cols = slice(zero + bounds.xmin // size, zero + bounds.xmax // size)
    values: NDArray[np.float32] = np.asarray(array[rows, cols], dtype=np.float32)
    return values


def stored_blocks(
    path: str, name: str, bounds: Bounds, cells: Iterable[CellId], *, ground_cell: int
) -> Iterator[tuple[int, int, NDArray[np.float32]]]:
    """Pieces of a stored raster for :func:`write_cog`, one ground cell at a time.

    Parameters
    ----------
    path : str
        Store from :func:`create_raster_store`.
    name : str
        Raster.
    bounds : Bounds
        Region of the mosaic [quanta]; cells beyond it are cut.
    cells : iterable of CellId
        Ground cells to read, best in rows from north to south.
    ground_cell : int
        Edge of a ground cell [quanta].

    Yields
    ------
    row, col, block
        Place in the mosaic, row 0 northernmost, and values.
    """
    _, _, size = _array(path, name, "r")
    for cell in cells:
        part = Bounds(
            max(cell.i * ground_cell, bounds.xmin),
            max(cell.j * ground_cell, bounds.ymin),
            min((cell.i + 1) * ground_cell, bounds.xmax),
            min((cell.j + 1) * ground_cell, bounds.ymax),
        )
        if part.xmax > part.xmin and part.ymax > part.ymin:
            row = (bounds.ymax - part.ymax) // size
            col = (part.xmin - bounds.xmin) // size
            yield row, col, read_window(path, name, part)


def frame(bounds: Bounds, raster_cell: int) -> tuple[tuple[int, int], tuple[float, float]]:
    """Shape and upper left corner of a mosaic, as :func:`write_cog` wants them.

    Parameters
    ----------
    bounds : Bounds
        Region [quanta], aligned to raster cells.
    raster_cell : int
        Edge of a raster cell [quanta].

    Returns
    -------
    shape : (int, int)
        Rows and columns.
    origin_xy_m : (float, float)
        Easting and northing of the upper left corner [m].
    """
    shape = (bounds.ymax - bounds.ymin) // raster_cell, (bounds.xmax - bounds.xmin) // raster_cell
    return shape, (bounds.xmin * QUANTUM_M, bounds.ymax * QUANTUM_M)
