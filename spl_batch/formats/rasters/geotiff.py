"""Delivered rasters: cloud-optimised GeoTIFF."""

import re
import shutil
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.database import get_units_map
from pyproj.exceptions import ProjError
from rasterio._err import CPLE_BaseError
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.transform import Affine
from rasterio.windows import Window

from spl_batch.constants import NODATA
from spl_batch.errors import InputError, StoppedError
from spl_batch.formats.crs import compound, horizontal, vertical
from spl_batch.formats.files.atomic import replacing, scratch_folder
from spl_batch.formats.units import Units

Blocks = Iterable[tuple[int, int, NDArray[np.float32]]]
"""First row, first column and values of pieces of a raster, row 0 northernmost."""

TILE_PX: Final = 256
"""Edge of a COG's internal tile [cells]."""

CACHE_BYTES: Final = 64 * 2**20
"""GDAL's block cache while a COG is written: memory does not grow with the raster [bytes]."""


_UNIT_OF_HEIGHTS: Final = re.compile(r'(VERTCRS\[.*LENGTHUNIT\["[^"]*",[0-9.]+)\]', re.DOTALL)
"""Unit without a code, within the part of a WKT 2 that is of heights."""

_DATUM_OF_HEIGHTS: Final = re.compile(r'(VDATUM\["[^"]*")\]')
"""Vertical datum without a code in a WKT 2."""


def write_cog(
    path: Path,
    blocks: NDArray[np.float32] | Blocks,
    *,
    shape: tuple[int, int],
    origin_xy_m: tuple[float, float] = (0.0, 0.0),
    cell_m: float = 1.0,
    transform: Affine | None = None,
    crs: str | None,
    description: str,
    unit: str = "",
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
        Easting and northing of the upper left corner, in metres on the axes of the CRS [m].
    transform : Affine, optional
        Corner and cells in the units of the CRS, in place of these.
    crs : str, optional
        Anything that GDAL understands as a CRS: EPSG code, WKT. The file is in its units: corner,
        cells and values in ``m`` are converted.
    unit : str
        Unit of its values, as GDAL's unit type; empty where they have none.

    Raises
    ------
    InputError
        If ``crs`` is not understood.
    """
    pieces: Blocks = [(0, 0, blocks)] if isinstance(blocks, np.ndarray) else blocks
    try:
        known_crs = None if crs is None else rasterio.crs.CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(str(path), f"CRS {crs!r} is not understood: {error}") from None
    whole = None if known_crs is None else CRS.from_wkt(known_crs.to_wkt())
    units = Units.of(whole)
    if whole is not None and len(whole.axis_info) > 2 and not whole.is_compound:
        # GeoTIFF has no keys for a projected CRS in three dimensions; the band states the unit.
        known_crs = rasterio.crs.CRS.from_wkt(horizontal(whole).to_wkt())
    elif whole is not None:
        known_crs = _with_codes(known_crs, whole, units)
    unit, unit_m = units.of_values(unit)
    if unit_m != 1.0:
        pieces = ((row, col, _divided(block, unit_m)) for row, col, block in pieces)
    left, top, cell = (v / units.horizontal_m for v in (*origin_xy_m, cell_m))
    profile = {
        "driver": "GTiff",
        "height": shape[0],
        "width": shape[1],
        "count": 1,
        "dtype": "float32",
        "nodata": NODATA,
        "crs": known_crs,
        "transform": transform or Affine(cell, 0.0, left, 0.0, -cell, top),
    }
    try:
        with (
            replacing(path) as cog,
            scratch_folder(path) as folder,
            rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES, GDAL_NUM_THREADS="1"),
        ):
            # Overviews and other by-products of GDAL come and go with the folder.
            plain, finished = Path(folder, "plain.tif"), Path(folder, "cog.tif")
            marks = _write_plain(plain, pieces, profile, (description, unit))
            _add_overviews(plain, shape, Resampling.average)
            _copy_as_cog(plain, finished)
            _verify(finished, marks)
            finished.replace(cog)
    except (RasterioError, CPLE_BaseError) as error:
        raise _stopped(path, shape, error) from error


def _with_codes(crs: rasterio.crs.CRS, whole: CRS, units: Units) -> rasterio.crs.CRS:
    """The same with the codes that GDAL writes, of a compound's parts, of its datum and unit.

    Where a compound has a code, WKT 2 leaves out those of its parts, and GDAL names another datum
    of heights. Of a vertical CRS without one, as of EGM2008 in feet, it writes no datum but by
    code, and metres but by the unit's, which is EPSG's too.
    """
    code = whole.to_authority(min_confidence=100) if whole.is_compound else None
    if code is not None:
        parts = compound(*CRS.from_authority(*code).sub_crs_list)
        crs = rasterio.crs.CRS.from_wkt(parts.to_wkt())
    unit = get_units_map(auth_name="EPSG", category="linear").get(units.vertical)
    datum = _datum_code(vertical(whole))
    if datum is None and (unit is None or units.vertical_m == 1.0):
        return crs
    text = crs.to_wkt(version="WKT2_2019")
    if unit is not None:
        text = _UNIT_OF_HEIGHTS.sub(rf'\1,ID["EPSG",{unit.code}]]', text)
    if datum is not None:
        text = _DATUM_OF_HEIGHTS.sub(rf'\1,ID["EPSG",{datum}]]', text)
    return rasterio.crs.CRS.from_wkt(text)


def _datum_code(heights: CRS | None) -> int | None:
    """EPSG's code of the datum of a vertical CRS without a code of its own, if it has one."""
    if heights is None or heights.datum is None or "id" in heights.to_json_dict():
        return None
    try:
        known = heights.datum.from_name(heights.datum.name, auth_name="EPSG")
    except ProjError:
        return None  # unknown, or a name of its own
    kind = "Vertical Reference Frame"  # some are dynamic, and an ellipsoid's name is another's
    return int(known.to_json_dict()["id"]["code"]) if known.type_name.endswith(kind) else None


def _divided(block: NDArray[np.float32], unit_m: float) -> NDArray[np.float32]:
    """Lengths in another unit; nodata stays."""
    values = np.where(block == np.float32(NODATA), NODATA, block.astype(np.float64) / unit_m)
    return values.astype(np.float32)


def _write_plain(
    path: Path, pieces: Blocks, profile: dict[str, Any], named: tuple[str, str]
) -> list[tuple[Window, int]]:
    """Write pieces as they come; uncompressed, so that rewriting a tile leaves no waste.

    Gives the window of each piece and a checksum of it.
    """
    layout = {"tiled": True, "blockxsize": TILE_PX, "blockysize": TILE_PX, "sparse_ok": True}
    marks = []
    with rasterio.open(path, "w", bigtiff="if_safer", **layout, **profile) as out:
        out.set_band_description(1, named[0])
        if named[1]:
            out.set_band_unit(1, named[1])
        for row, col, block in pieces:
            rows, cols = block.shape
            window = Window(col, row, cols, rows)
            values = block.astype(profile["dtype"], copy=False)
            out.write(values, 1, window=window)
            marks.append((window, zlib.crc32(values.tobytes())))
    return marks


def _verify(cog: Path, marks: Iterable[tuple[Window, int]]) -> None:
    """Read everything back: GDAL keeps silent when a full disk cuts off what it still caches."""
    lost = RasterioError("what was written cannot be read back")
    with rasterio.open(cog) as source:
        levels = len(source.overviews(1))
        if any(zlib.crc32(source.read(1, window=w).tobytes()) != mark for w, mark in marks):
            raise lost
    for level in range(levels):
        finer = {} if level == 0 else {"overview_level": level - 1}
        with rasterio.open(cog, **finer) as fine, rasterio.open(cog, overview_level=level) as made:
            if not all(_averages(fine, made, window) for _, window in made.block_windows(1)):
                raise lost


def _averages(fine: Any, made: Any, window: Window) -> bool:
    """Whether each cell of an overview's part lies between the finer cells whose mean it is."""
    values = made.read(1, window=window)
    rows = _finer(window.row_off, window.height, fine.height / made.height, fine.height)
    cols = _finer(window.col_off, window.width, fine.width / made.width, fine.width)
    row, col = int(rows.min()), int(cols.min())
    within = Window(col, row, int(cols.max()) + 1 - col, int(rows.max()) + 1 - row)
    cells = fine.read(1, window=within)
    known = cells != made.nodata
    far = np.finfo(np.float32).max / 2
    low, high = np.where(known, cells, far), np.where(known, cells, -far)
    for axis, at in ((0, rows - row), (1, cols - col)):
        low, high = low.take(at, axis).min(axis), high.take(at, axis).max(axis)
        known = known.take(at, axis).all(axis)
    slack = 1e-5 * np.maximum(np.abs(low), np.abs(high))
    empty = values == made.nodata
    return bool(np.all(np.where(empty, ~known, (values >= low - slack) & (values <= high + slack))))


def _finer(start: int, count: int, ratio: float, size: int) -> NDArray[np.int64]:
    """Finer rows or columns that coarser ones may be made of, one to either side: (5, count)."""
    first = np.floor(np.arange(start, start + count) * ratio).astype(np.int64) - 1
    cells: NDArray[np.int64] = np.clip(first + np.arange(5)[:, None], 0, size - 1)
    return cells


def _add_overviews(path: Path, shape: tuple[int, int], by: Resampling) -> None:
    """Statistics, and overviews down to one tile: one always, where GDAL leaves some without."""
    factors = [2]
    while max(shape) // factors[-1] > TILE_PX:
        factors.append(2 * factors[-1])
    with rasterio.open(path, "r+") as raster:
        raster.update_stats()
        raster.build_overviews(factors, by)


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


def _stopped(path: Path, shape: tuple[int, int], error: Exception) -> StoppedError:
    """GDAL reports a full disk only in prose, so the free space is looked at."""
    needed = 2 * 4 * shape[0] * shape[1]
    if shutil.disk_usage(path.parent).free < needed:
        return StoppedError(f"{path}: disk full; free {needed // 10**6 + 1} MB and run again")
    return StoppedError(f"{path}: cannot be written: {' '.join(str(error).split())}")
