"""Point files for tests, made by laspy, which shares no code with what is tested."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

VERSIONS = [
    *(("1.2", f) for f in range(4)),
    *(("1.3", f) for f in range(6)),
    *(("1.4", f) for f in range(11)),
]
"""Every pair of version and point format that LAS allows."""

SCALES = (0.001, 0.01, 0.01)
OFFSETS = (500_000.0, -4_000_000.0, 0.0)


def random_records(header: laspy.LasHeader, n: int, seed: int) -> laspy.ScaleAwarePointRecord:
    """Records whose every dimension is filled, bit by bit, with something."""
    rng = np.random.default_rng(seed)
    points = laspy.ScaleAwarePointRecord.zeros(n, header=header)
    for dimension in header.point_format.dimensions:
        count = dimension.num_elements
        if dimension.kind == laspy.DimensionKind.FloatingPoint:
            values: NDArray[Any] = rng.normal(size=(n, count))
        else:
            bits = dimension.num_bits // count
            signed = dimension.kind == laspy.DimensionKind.SignedInteger
            high = min(2 ** (bits - signed) - 1, 10**6)
            values = rng.integers(-high if signed else 0, high, size=(n, count), endpoint=True)
        points[dimension.name] = values[:, 0] if count == 1 else values
    if "scan_angle_rank" in header.point_format.dimension_names:
        points["scan_angle_rank"] = rng.integers(-90, 91, size=n)
    return points


def write_las(
    path: Path,
    *,
    version: str = "1.4",
    point_format: int = 6,
    n: int = 1000,
    seed: int = 0,
    extra: Mapping[str, Any] | None = None,
    crs: CRS | None = None,
    scales: tuple[float, float, float] = SCALES,
    offsets: tuple[float, float, float] = OFFSETS,
    values: Mapping[str, Any] | None = None,
    evlrs: list[laspy.VLR] | None = None,
    vlrs: list[laspy.VLR] | None = None,
) -> Path:
    """Write random points, with these values put in; compressed where the name says .laz."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.array(scales), np.array(offsets)
    for name, dtype in (extra or {}).items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, dtype))
    if crs is not None:
        header.add_crs(crs)
    header.vlrs.extend(vlrs or [])
    points = random_records(header, n, seed)
    for name, given in (values or {}).items():
        points[name] = given
    with laspy.open(path, mode="w", header=header) as writer:
        if n:
            writer.write_points(points)
        if evlrs:
            writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(evlrs))
    return path


def geo_keys(*keys: tuple[int, int]) -> bytes:
    """Directory of GeoTIFF keys, each with its number and its code."""
    values = [1, 1, 0, len(keys), *(v for key, code in keys for v in (key, 0, 1, code))]
    return np.array(values, "<u2").tobytes()


def keys_record(*keys: tuple[int, int]) -> laspy.VLR:
    """Header record of GeoTIFF keys."""
    return laspy.VLR("LASF_Projection", 34735, "", geo_keys(*keys))


def wkt_record(crs: str, user: str = "LASF_Projection") -> laspy.VLR:
    """Header record of a CRS as WKT."""
    text = CRS.from_user_input(crs).to_wkt("WKT1_GDAL")
    return laspy.VLR(user, 2112, "", text.encode() + b"\0")


def with_record(content: bytes, user: bytes, number: int, data: bytes) -> bytes:
    """A file with one more record behind the others; offsets that the header tells move on."""
    record = struct.pack("<H16sHH32s", 0, user, number, len(data), b"") + data
    made, start = bytearray(content), struct.unpack_from("<I", content, 96)[0]
    struct.pack_into("<II", made, 96, start + len(record), content[100] + 1)
    if content[104] & 0x80:
        (table,) = struct.unpack_from("<q", content, start)
        struct.pack_into("<q", made, start, table + len(record))
    made[start:start] = record
    return bytes(made)


def patch(path: Path, offset: int, code: str, *values: Any) -> Path:
    """Overwrite bytes of a file."""
    content = bytearray(path.read_bytes())
    struct.pack_into(f"<{code}", content, offset, *values)
    path.write_bytes(content)
    return path
