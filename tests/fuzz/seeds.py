"""Sound files of every format that is read, small enough that most edits matter."""

import json
import struct
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rasterio
import shapely
from pyproj import CRS
from rasterio.transform import Affine

from spl_batch.airborne.simulate.file_writers import write_polygons
from spl_batch.altimetry.formats.mabel import write_mabel
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.trajectory.records import SBET_RECORD
from spl_batch.geiger.coincidence.files import write
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.geiger.water import formats as water
from spl_batch.lattice.tables import PointTable
from tests import surveys
from tests.altimetry.tracks import small_track, write_atl03, write_atl08, write_csv
from tests.fuzz.mutants import Seed
from tests.io_files import write_las

UTM: Final = CRS.from_epsg(32615)


@cache
def seed(name: str) -> Seed:
    """Seed of a format, by its name in :data:`SEEDS`."""
    with TemporaryDirectory() as folder:
        suffix, write, tender = SEEDS[name]
        path = write(Path(folder))
        content = path.read_bytes()
    return Seed(content, suffix, tuple(tender(content)))


# LAS


def _notes() -> list[laspy.VLR]:
    return [laspy.VLR("somebody", 7, "a note", b"text" * 4)]


def _las_old(folder: Path) -> Path:
    return write_las(
        folder / "a.las", version="1.2", point_format=3, n=60, extra={"channel": "u1"}, crs=UTM
    )


def _las(folder: Path) -> Path:
    path = folder / "a.las"
    extra = {"channel": "u1", "quality": "f4", "pair": "2u2"}
    return write_las(path, n=40, extra=extra, crs=UTM, evlrs=_notes(), vlrs=_notes())


def _laz(folder: Path) -> Path:
    extra = {"channel": "u1", "quality": "f4"}
    return write_las(
        folder / "a.laz", n=300, extra=extra, crs=UTM, evlrs=_notes(), scales=(0.001,) * 3
    )


def _laz_old(folder: Path) -> Path:
    return write_las(
        folder / "a.laz", version="1.2", point_format=1, n=300, extra={"channel": "u1"}
    )


def _copc(folder: Path) -> Path:
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, 60_000, (2, 9000))
    points = {"x": x, "y": y, "z": rng.integers(0, 9000, 9000).astype(np.int32)}
    points["channel"] = rng.integers(0, 25, 9000).astype(np.uint8)
    path = folder / "a.copc.laz"
    write_points(path, PointTable(points), crs=UTM, copc=True)
    return path


def las_parts(content: bytes) -> Iterator[tuple[int, int]]:
    """Header twice, each record's head and start, the first points, chunk table, what follows."""
    start = struct.unpack_from("<I", content, 96)[0]
    yield 4, 227
    yield 94, 131
    yield struct.unpack_from("<H", content, 94)[0], start
    yield start, min(start + 160, len(content))
    yield max(len(content) - 220, start), len(content)
    if content[104] & 0x80:
        table = struct.unpack_from("<q", content, start)[0]
        yield table, min(table + 24, len(content))
    if content[25] == 4:
        evlr = struct.unpack_from("<Q", content, 235)[0]
        yield from ([(evlr, min(evlr + 60, len(content)))] if evlr else [])


# Trajectories


def _trajectory() -> dict[str, np.ndarray]:
    time = np.arange(surveys.START_S - 1, surveys.START_S + 10, 0.25)
    x = surveys.ORIGIN_M[0] + 60.0 * (time - surveys.START_S)
    return {"gps_time": time, "x": x, "y": 0 * x + surveys.ORIGIN_M[1], "z": 0 * x + 600.0}


def _csv(folder: Path) -> Path:
    columns, path = _trajectory(), folder / "t.csv"
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.3f", ",", header=",".join(columns),
        comments="",
    )  # fmt: skip
    return path


def _parquet(folder: Path) -> Path:
    path = folder / "t.parquet"
    pq.write_table(pa.table(_trajectory()), path, row_group_size=20)
    return path


def _sbet(folder: Path) -> Path:
    columns = _trajectory()
    records = np.zeros(len(columns["x"]), SBET_RECORD)
    records["time"] = columns["gps_time"] % 604_800
    records["latitude"], records["longitude"] = np.radians([29.7, -95.3])
    records["altitude"] = 600.0
    (folder / "t.sbet").write_bytes(records.tobytes())
    return folder / "t.sbet"


def _whole(content: bytes) -> Iterator[tuple[int, int]]:
    yield 0, len(content)


def file_ends(content: bytes) -> Iterator[tuple[int, int]]:
    """Where formats with a footer state what they hold."""
    yield max(len(content) - 900, 0), len(content)
    yield 0, min(200, len(content))


# Rasters and polygons


def _geotiff(folder: Path) -> Path:
    path = folder / "dem.tif"
    values = np.add.outer(np.arange(64.0), np.arange(80.0)).astype(np.float32)
    profile = {"driver": "GTiff", "height": 64, "width": 80, "count": 1, "dtype": "float32"}
    with rasterio.open(
        path, "w", crs="EPSG:4326", transform=Affine(5e-4, 0, -104.02, 0, -5e-4, 30.02),
        tiled=True, blockxsize=32, blockysize=32, compress="deflate", nodata=-9999, **profile,
    ) as raster:  # fmt: skip
        raster.write(values, 1)
    return path


def _gpkg(folder: Path) -> Path:
    east, north = surveys.ORIGIN_M
    path = folder / "area.gpkg"
    square = shapely.box(east - 20, north - 20, east + 20, north + 20)
    write_polygons(path, [square], "EPSG:32615")
    return path


def _geojson(folder: Path) -> Path:
    ring = [[-95.36, 29.72], [-95.35, 29.72], [-95.35, 29.73], [-95.36, 29.72]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"id": 1}, "geometry": shape}
    path = folder / "area.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path


# HDF5 and L1


def _atl03(folder: Path) -> Path:
    return write_atl03(folder / "a.h5", {"gt1r": small_track(1, length_m=120.0)})


def _atl08(folder: Path) -> Path:
    tracks = {"gt1r": small_track(1, length_m=120.0)}
    return write_atl08(folder / "b.h5", write_atl03(folder / "a.h5", tracks), tracks)


def _mabel(folder: Path) -> Path:
    rng = np.random.default_rng(2)
    time = np.sort(rng.uniform(100, 102, 200))
    photons = {"delta_time": time, "elev": rng.normal(5, 1, 200)}
    photons |= {"latitude": 30 + time / 500, "longitude": 0 * time - 104}
    write_mabel(folder / "m.h5", {"channel006": photons})
    return folder / "m.h5"


def _track_csv(folder: Path) -> Path:
    return write_csv(folder / "t.csv", small_track(1, length_m=60.0))


def _frames_h5(folder: Path) -> Path:
    rng = np.random.default_rng(3)
    frames = rng.integers(0, 900, (40, 4, 5)).astype(np.uint16)
    truth = water.FrameTruth(np.ones((4, 4, 5)), np.ones((4, 4, 5, 3)))
    water.write_frames(folder / "f.h5", frames, {"a": 1.0}, truth, 10)
    return folder / "f.h5"


def _l1_frames(folder: Path) -> Path:
    number = np.arange(60)
    path = folder / "p_frames.parquet"
    write(path, Frames(number, np.full((60, 3), 3000.0), np.zeros((60, 3))))
    return path


def _l1_detections(folder: Path) -> Path:
    frame, detector = np.divmod(np.arange(240), 4)
    path = folder / "p_detections.parquet"
    write(path, Detections(frame, detector.astype(np.int32), np.ones((240, 3), int)))
    return path


Parts = Callable[[bytes], Iterator[tuple[int, int]]]

SEEDS: Final[dict[str, tuple[str, Callable[[Path], Path], Parts]]] = {
    "las 1.2": (".las", _las_old, las_parts),
    "las 1.4": (".las", _las, las_parts),
    "laz 1.2": (".laz", _laz_old, las_parts),
    "laz 1.4": (".laz", _laz, las_parts),
    "copc": (".copc.laz", _copc, las_parts),
    "trajectory csv": (".csv", _csv, _whole),
    "trajectory parquet": (".parquet", _parquet, file_ends),
    "trajectory sbet": (".sbet", _sbet, _whole),
    "geotiff": (".tif", _geotiff, file_ends),
    "gpkg": (".gpkg", _gpkg, _whole),
    "geojson": (".geojson", _geojson, _whole),
    "atl03": (".h5", _atl03, _whole),
    "atl08": (".h5", _atl08, _whole),
    "mabel": (".h5", _mabel, _whole),
    "track csv": (".csv", _track_csv, _whole),
    "frames": (".h5", _frames_h5, _whole),
    "l1 frames": (".parquet", _l1_frames, file_ends),
    "l1 detections": (".parquet", _l1_detections, file_ends),
}
"""How a name ends, what writes it, where it is tender; by format."""
