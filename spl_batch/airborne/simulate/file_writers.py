"""Files of a simulated survey; each is whole or not there."""

import datetime as dt
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from laspy.header import GpsTimeType
from numpy.typing import NDArray
from pyproj import CRS, Proj, Transformer

from spl_batch.airborne.catalogue.catalogues import Layer, write_layers
from spl_batch.airborne.simulate.flight import Pass
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.constants import ADJUSTED_STANDARD_OFFSET_S, GPS_WEEK_S, QUANTUM_M
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.trajectory.records import SBET_RECORD

GPS_EPOCH = dt.date(1980, 1, 6)

TRUTH = pa.schema([("kind", pa.uint8()), ("parent", pa.uint8()), ("parent_row", pa.int64())])
"""Columns of the truth of a file."""

Columns = Mapping[str, NDArray[Any]]
"""LAS dimensions by name; x, y, z as coordinates [m]."""


def las_header(
    crs: str, origin_m: tuple[float, float, float], time_s: float, scale_m: float = QUANTUM_M
) -> laspy.LasHeader:
    """Header of LAS 1.4, format 6, adjusted standard time, which gives the creation date [s].

    ``origin_m``: near the points; offsets are whole metres at it.
    """
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, scale_m)
    header.offsets = np.floor(np.asarray(origin_m))
    header.offsets[2] = 0.0
    header.global_encoding.gps_time_type = GpsTimeType.STANDARD
    header.generating_software = "spl-batch simulate"
    header.system_identifier = "SIMULATION"
    header.creation_date = GPS_EPOCH + dt.timedelta(seconds=time_s + ADJUSTED_STANDARD_OFFSET_S)
    header.add_crs(CRS.from_user_input(crs))
    return header


def cloud_writer(path: Path, header: laspy.LasHeader) -> laspy.LasWriter:
    """A LAZ file, to be written piece by piece by :func:`add_points`."""
    return laspy.open(str(path), mode="w", header=header, do_compress=True)


def add_points(cloud: laspy.LasWriter, columns: Columns) -> None:
    """Add points to a file."""
    record = laspy.ScaleAwarePointRecord.zeros(len(columns["x"]), header=cloud.header)
    for name, values in columns.items():
        record[name] = values
    cloud.write_points(record)


def folder_of(scene: Scene) -> str:
    """Folder of the files, below that of the survey."""
    return "flightlines" if scene.delivery.tile_m is None else "tiles"


class PointFiles:
    """Files of a survey's returns and their truth, each whole or not there."""

    def __init__(self, scene: Scene, out: Path, stack: ExitStack) -> None:
        self._scene, self._out, self._open = scene, out, stack
        self._writers: dict[str, tuple[laspy.LasWriter, pq.ParquetWriter]] = {}
        self._count: Counter[str] = Counter()  # points by file

    def write(self, run: Pass, columns: Columns, points: NDArray[np.void]) -> None:
        """Add returns of a flightline as the delivery has them, and the truth of these points."""
        given = self._scene.delivery
        out = {name: values for name, values in columns.items() if name != "channel"}
        out[given.channel_dimension] = columns["channel"]
        number = run.number if given.point_source_id else 0
        out["point_source_id"] = np.full(len(points), number, np.uint16)
        out["classification"] = np.ones(len(points), np.uint8)
        out["x"], out["y"] = self._moved(run, out["x"], out["y"])
        for name, chosen in self._files(run, out):
            cloud, truth = self._writers_of(name, run)
            add_points(cloud, {key: values[chosen] for key, values in out.items()})
            truth.write_table(_truth(points, chosen, self._count[name]))
            self._count[name] += len(chosen)

    def _moved(self, run: Pass, x: Any, y: Any) -> tuple[Any, Any]:
        """Places in the CRS of a flightline's file."""
        if run.flight.crs is None:
            return x, y
        to_file = Transformer.from_crs(self._scene.crs, run.flight.crs, always_xy=True)
        moved: tuple[Any, Any] = to_file.transform(x, y)
        return moved

    def _files(self, run: Pass, columns: Columns) -> Iterator[tuple[str, NDArray[np.intp]]]:
        """Names of the files that the returns go to, and which do."""
        tile_m = self._scene.delivery.tile_m
        if tile_m is None:
            yield f"line_{run.number:02d}", np.arange(len(columns["x"]))
            return
        east, north = (np.floor(columns[axis] / tile_m).astype(np.int64) for axis in "xy")
        tiles, of_point = np.unique(np.stack([east, north]), axis=1, return_inverse=True)
        for k, (i, j) in enumerate(tiles.T.tolist()):
            yield f"tile_{i}_{j}", np.flatnonzero(of_point.reshape(-1) == k)

    def _writers_of(self, name: str, run: Pass) -> tuple[laspy.LasWriter, pq.ParquetWriter]:
        if name not in self._writers:
            scene = self._scene
            east, north, up = scene.origin_m
            origin_m = (*self._moved(run, east, north), up)
            crs = run.flight.crs or scene.crs
            header = las_header(crs, origin_m, run.middle_s, scene.delivery.scale_m)
            if scene.delivery.channel_dimension == "channel":
                header.add_extra_dim(laspy.ExtraBytesParams("channel", "uint8", "beamlet, from 1"))
            laz, parquet = (
                self._open.enter_context(replacing(self._out / folder / f"{name}.{suffix}"))
                for folder, suffix in ((folder_of(scene), "laz"), ("truth", "parquet"))
            )
            self._writers[name] = (
                self._open.enter_context(cloud_writer(laz, header)),
                self._open.enter_context(pq.ParquetWriter(parquet, TRUTH, compression="zstd")),
            )
        return self._writers[name]


def _truth(points: NDArray[np.void], chosen: NDArray[np.intp], before: int) -> pa.Table:
    """Truth of the chosen ones of points, behind others in a file, within which parents count."""
    place = np.full(len(points), -1)
    place[chosen] = np.arange(len(chosen))
    parent = points["parent_row"][chosen]
    there = np.where(parent >= 0, place[parent], -1)
    rows = np.where(there >= 0, there + before, -1)
    columns = [*(points[name][chosen] for name in ("kind", "parent")), rows]
    return pa.table(columns, schema=TRUTH)


def sbet_records(
    crs: str,
    time_s: NDArray[np.float64],
    xyz_m: NDArray[np.float64],
    attitude: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.void]:
    """Trajectory as SBET: radians, ellipsoid of the CRS, seconds of the GPS week.

    ``xyz_m`` (m, 3) are positions in the CRS, whose heights are taken as ellipsoidal; ``attitude``
    is grid heading, roll, pitch [rad]. Accelerations and rates, which nothing here uses, are zero.
    """
    survey = CRS.from_user_input(crs)
    to_geographic = Transformer.from_crs(survey.to_3d(), "EPSG:4979", always_xy=True)
    longitude, latitude, height = to_geographic.transform(xyz_m[:, 0], xyz_m[:, 1], xyz_m[:, 2])
    factors = Proj(survey).get_factors(longitude, latitude)
    heading, roll, pitch = attitude
    out = np.zeros(len(time_s), SBET_RECORD)
    out["time"] = np.mod(time_s + ADJUSTED_STANDARD_OFFSET_S, GPS_WEEK_S)
    out["latitude"], out["longitude"] = np.radians(latitude), np.radians(longitude)
    out["altitude"] = height
    for axis, speed in zip("xyz", np.gradient(xyz_m, time_s, axis=0).T, strict=True):
        out[f"{axis}_velocity"] = speed
    out["roll"], out["pitch"] = roll, pitch
    turned = heading + np.radians(factors.meridian_convergence)
    out["platform_heading"] = np.mod(turned, 2 * np.pi)
    return out


def write_polygons(path: Path, polygons: list[shapely.Polygon], crs: str) -> None:
    """Polygons as GeoPackage with one field, ``id``."""
    layer = Layer(path.stem, polygons, {"id": range(1, len(polygons) + 1)})
    write_layers(path, [layer], CRS.from_user_input(crs).to_wkt())
