"""CRS of GeoTIFF keys, by which older LAS files name theirs."""

from functools import lru_cache
from io import BytesIO
from typing import Final

import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image, TiffTags
from PIL.TiffImagePlugin import ImageFileDirectory_v2
from pyproj import CRS
from pyproj.database import get_units_map
from pyproj.exceptions import CRSError
from rasterio.errors import RasterioError, RasterioIOError
from rasterio.io import MemoryFile

from spl_batch.formats.crs import (
    above_ellipsoid,
    compound,
    crs_from_wkt,
    crs_name,
    horizontal,
    in_unit,
    is_nameless,
    vertical,
)
from spl_batch.formats.heights import SOME_HEIGHTS
from spl_batch.formats.units import Units, in_words, metres_in

GEO_KEYS: Final = (
    ("LASF_Projection", 34735),
    ("LASF_Projection", 34736),
    ("LASF_Projection", 34737),
)
"""GeoTIFF key directory, doubles and text; the record id is the TIFF tag."""

_VERTICAL_CRS_KEY: Final = 4096
_VERTICAL_UNIT_KEY: Final = 4099
_LINEAR_UNIT_KEY: Final = 3076
"""GeoTIFF keys of heights and of lengths [OGC 19-008r4, B.4]."""


@lru_cache(maxsize=64)
def crs_from_geotiff(directory: bytes, doubles: bytes, text: bytes) -> CRS | None:
    """CRS of GeoTIFF keys, of which a survey has few, user-defined ones too; none without any.

    Only GDAL reads such keys completely, but for units: it takes local CRS for metres, and ignores
    the vertical CRS beside a unit of heights. Records 34735 to 34737, of which the last two may be
    empty, are TIFF tags byte for byte, so they are put into a TIFF of one pixel.
    """
    entries, keys = _entries(directory)
    found = _by_gdal(entries[entries[:, 0] != _VERTICAL_UNIT_KEY], doubles, text)
    if found is None:
        return None
    flat, code = horizontal(found), keys.get(_VERTICAL_CRS_KEY, 0)
    unit = keys.get(_VERTICAL_UNIT_KEY)
    if flat.is_engineering:
        flat = _in_unit(flat, keys.get(_LINEAR_UNIT_KEY))
    if 5000 < code < 5034:  # heights above an ellipsoid, by a code of GeoTIFF 1.0, 6.3.4.1
        return _in_unit(flat.to_3d(), unit)
    heights = vertical(found) or _vertical_crs(code) or (SOME_HEIGHTS if unit else None)
    if heights is None:
        return flat
    whole = compound(flat, _in_unit(heights, unit))
    # A unit of heights alone names no vertical CRS.
    return flat if is_nameless(heights.name) and Units.of(whole).are_metres else whole


@lru_cache(maxsize=64)
def contradicted_unit(directory: bytes) -> str:
    """Sentence on heights of GeoTIFF keys in another unit than their vertical CRS; else empty.

    The unit counts, as it does beside a CRS that has none of its own: a code is often copied.
    """
    _, keys = _entries(directory)
    heights = _vertical_crs(keys.get(_VERTICAL_CRS_KEY, 0))
    if heights is None:
        return ""
    own, stated = (
        Units.of(crs) for crs in (heights, _in_unit(heights, keys.get(_VERTICAL_UNIT_KEY)))
    )
    if own.vertical_m == stated.vertical_m:
        return ""
    return (
        f"its GeoTIFF keys name {crs_name(heights)}, which is in {in_words(own.vertical)}, and "
        f"state heights in {in_words(stated.vertical)}: these are taken; correct the file if that "
        "is wrong"
    )


def _entries(directory: bytes) -> tuple[NDArray[np.uint16], dict[int, int]]:
    """Header and keys of a directory, (n, 4), and their values by number."""
    entries = np.frombuffer(directory[: len(directory) // 8 * 8], "<u2").reshape(-1, 4)
    entries = entries[: 1 + int(entries[:1, 3].sum())]  # some writers pad
    return entries, dict(entries[1:, [0, 3]].tolist())


def _vertical_crs(code: int) -> CRS | None:
    """Vertical CRS of a code, which GDAL leaves out beside a local CRS."""
    try:
        found = CRS.from_epsg(code)
    except CRSError:
        return None
    return found if found.is_vertical else None


def _in_unit(crs: CRS, code: int | None) -> CRS:
    """A local or vertical CRS, or heights of a 3D one, in a unit by its code; as it is by none."""
    units = get_units_map(auth_name="EPSG", category="linear").items()
    name = next((name for name, unit in units if unit.code == str(code)), None)
    own, deep = Units.of(crs), len(crs.axis_info) > 2
    own_m = own.vertical_m if deep or crs.is_vertical else own.horizontal_m
    if name is None or metres_in(name) == own_m:
        return crs
    return above_ellipsoid(crs, name) if deep else in_unit(crs, name)


def _by_gdal(entries: NDArray[np.uint16], doubles: bytes, text: bytes) -> CRS | None:
    """CRS of a directory, (n, 4): its header and keys."""
    header = [*entries[0, :3], len(entries) - 1] if len(entries) else []
    tiff = _one_pixel_tiff(np.array([header, *entries[1:]], "<u2").tobytes(), doubles, text)
    try:
        # Without the option, GDAL leaves the vertical part out of keys of version 1.0.
        env = rasterio.Env(GTIFF_REPORT_COMPD_CS=True)
        with env, MemoryFile(tiff) as memory, memory.open() as image:
            return crs_from_wkt(image.crs.to_wkt().encode()) if image.crs else None
    except (RasterioError, RasterioIOError) as error:
        raise CRSError(str(error)) from None


def _one_pixel_tiff(directory: bytes, doubles: bytes, text: bytes) -> bytes:
    tags = ImageFileDirectory_v2()
    # A raster without a geotransform makes rasterio warn.
    tags[33550], tags[33922] = (1.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    tags.tagtype[GEO_KEYS[2][1]] = TiffTags.ASCII
    shorts = np.frombuffer(directory[: len(directory) // 2 * 2], "<u2")
    numbers = np.frombuffer(doubles[: len(doubles) // 8 * 8], "<f8")
    for (_, tag), content in zip(GEO_KEYS, (shorts.tolist(), numbers.tolist(), text), strict=True):
        if content:
            tags[tag] = content
    tiff = BytesIO()
    Image.new("L", (1, 1)).save(tiff, "TIFF", tiffinfo=tags)
    return tiff.getvalue()
