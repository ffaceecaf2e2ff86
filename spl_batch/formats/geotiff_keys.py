"""CRS of GeoTIFF keys, by which older LAS files name theirs."""

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

from spl_batch.formats.crs import NAMELESS, compound, horizontal, vertical
from spl_batch.formats.units import METRE, US_FOOT, Units, metres_in

GEO_KEYS: Final = (
    ("LASF_Projection", 34735),
    ("LASF_Projection", 34736),
    ("LASF_Projection", 34737),
)
"""GeoTIFF key directory, doubles and text; the record id is the TIFF tag."""

_VERTICAL_CRS_KEY: Final = 4096
_VERTICAL_UNIT_KEY: Final = 4099
_LINEAR_UNIT_KEY: Final = 3076
_METRE: Final = 9001
"""GeoTIFF keys of heights and of lengths, and the code of metres [OGC 19-008r4, B.4]."""

_SHORT: Final = {"foot": "ft", US_FOOT: "ftUS", METRE: "m"}
"""Units as names of EPSG's vertical CRS have them."""


def crs_from_geotiff(directory: bytes, doubles: bytes, text: bytes) -> CRS | None:
    """CRS of GeoTIFF keys, user-defined ones too; none where they define none.

    Only GDAL reads such keys completely. Records 34735 to 34737, of which the last two may be
    empty, are TIFF tags byte for byte, so they are put into a TIFF of one pixel.
    """
    tiff = _one_pixel_tiff(_with_heights_unit(directory), doubles, text)
    try:
        # Without the option, GDAL leaves the vertical part out of keys of version 1.0.
        env = rasterio.Env(GTIFF_REPORT_COMPD_CS=True)
        with env, MemoryFile(tiff) as memory, memory.open() as image:
            found = CRS.from_wkt(image.crs.to_wkt()) if image.crs else None
    except (RasterioError, RasterioIOError) as error:
        raise CRSError(str(error)) from None
    if found is not None and horizontal(found).is_engineering:
        found = _in_own_unit(found, _entries(directory))
    if found is not None and _above_ellipsoid(_entries(directory)):
        return horizontal(found).to_3d()
    heights = None if found is None else vertical(found)
    if found is None or (heights is not None and heights.name not in NAMELESS):
        return found
    named = _named_heights(_entries(directory))
    if named is not None:  # GDAL leaves it out beside a local CRS, and beside a unit
        return compound(found, named)
    # A unit of heights alone names no vertical CRS.
    return horizontal(found) if heights is not None and Units.of(found).are_metres else found


def _entries(directory: bytes) -> NDArray[np.uint16]:
    """Header and keys of a directory, (n, 4) uint16."""
    return np.frombuffer(directory[: len(directory) // 8 * 8], "<u2").reshape(-1, 4)


def _in_own_unit(local: CRS, entries: NDArray[np.uint16]) -> CRS:
    """A local CRS in the unit that its keys name, which GDAL takes for metres."""
    name, metres = _unit(entries, _LINEAR_UNIT_KEY)
    if metres == 1.0:
        return local
    return CRS.from_wkt(f'LOCAL_CS["{local.name}",UNIT["{name}",{metres!r}]]')


def _unit(entries: NDArray[np.uint16], key: int) -> tuple[str, float]:
    """Unit of lengths that a key names, and the metres in it; metres without one."""
    codes = {str(code) for code in entries[1:][entries[1:, 0] == key, 3]}
    units = get_units_map(auth_name="EPSG", category="linear").items()
    name = next((name for name, unit in units if unit.code in codes), METRE)
    return name, metres_in(name) or 1.0


def _above_ellipsoid(entries: NDArray[np.uint16]) -> bool:
    """Whether keys name heights above an ellipsoid by a code of GeoTIFF 1.0, 6.3.4.1."""
    codes = entries[1:][entries[1:, 0] == _VERTICAL_CRS_KEY, 3]
    return bool(((codes > 5000) & (codes < 5034)).any())


def _named_heights(entries: NDArray[np.uint16]) -> CRS | None:
    """Vertical CRS by its code, if keys have one, in the unit of heights that they state."""
    codes = entries[1:][entries[1:, 0] == _VERTICAL_CRS_KEY, 3].tolist()
    try:
        found = CRS.from_epsg(codes[0]) if codes else None
    except CRSError:
        return None
    if found is None or not found.is_vertical:
        return None
    name, metres = _unit(entries, _VERTICAL_UNIT_KEY)
    stated = bool((entries[1:, 0] == _VERTICAL_UNIT_KEY).any())
    if not stated or Units.of(found).vertical_m == metres:
        return found
    content = found.to_json_dict()
    del content["id"]
    content["name"] += f" ({_SHORT.get(name, name)})"
    unit = {"type": "LinearUnit", "name": name, "conversion_factor": metres}
    content["coordinate_system"]["axis"][0]["unit"] = unit
    return CRS.from_json_dict(content)


def _with_heights_unit(directory: bytes) -> bytes:
    """Keys without the vertical CRS where a unit other than metres is given, which GDAL ignores."""
    values = _entries(directory)
    units = values[1:][values[1:, 0] == _VERTICAL_UNIT_KEY, 3]
    if not np.any(units != _METRE):
        return directory
    kept = values[values[:, 0] != _VERTICAL_CRS_KEY]
    header = [*kept[0, :3], len(kept) - 1]
    return np.array([header, *kept[1:]], "<u2").tobytes()


def _one_pixel_tiff(directory: bytes, doubles: bytes, text: bytes) -> bytes:
    tags = ImageFileDirectory_v2()
    # A raster without a place makes rasterio warn.
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
