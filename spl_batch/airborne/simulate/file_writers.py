"""Files of a simulated survey; each is whole or not there."""

import datetime as dt
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import rasterio
import shapely
import yaml
from laspy.header import GpsTimeType
from numpy.typing import NDArray
from pyproj import CRS, Proj, Transformer
from rasterio.windows import Window

from spl_batch.airborne.simulate.flight import Pass
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.constants import ADJUSTED_STANDARD_OFFSET_S, GPS_WEEK_S, NODATA, QUANTUM_M
from spl_batch.formats.files.atomic import replacing, write_bytes

SCAN_ANGLE_DEG = 0.006
"""Unit of a LAS 1.4 scan angle [deg]."""

GPS_EPOCH = dt.date(1980, 1, 6)

Columns = dict[str, NDArray[Any]]


def las_header(
    crs: str, origin_m: tuple[float, float, float], time_s: float, scale_m: float = QUANTUM_M
) -> laspy.LasHeader:
    """Header of LAS 1.4, format 6, adjusted standard time.

    Parameters
    ----------
    origin_m : (3,) float
        Near the points; offsets are whole metres at it.
    time_s : float
        Adjusted standard time that gives the creation date [s].
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


class PointsWriter:
    """A LAZ file and the truth of its points, written piece by piece.

    Parameters
    ----------
    header : LasHeader
        As :func:`las_header` makes it, with the extra dimensions of the points.
    """

    def __init__(self, laz: Path, truth: Path, header: laspy.LasHeader) -> None:
        self._header = header
        self._las = laspy.open(str(laz), mode="w", header=header, do_compress=True)
        self._schema = pa.schema(
            [("kind", pa.uint8()), ("parent", pa.uint8()), ("parent_row", pa.int64())]
        )
        self._truth = pq.ParquetWriter(truth, self._schema, compression="zstd")
        self.count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._las.close()
        self._truth.close()

    def write(self, columns: Mapping[str, NDArray[Any]], truth: Mapping[str, NDArray[Any]]) -> None:
        """Add points.

        Parameters
        ----------
        columns : mapping
            LAS dimensions by name; x, y, z as coordinates [m].
        truth : mapping
            ``kind``, ``parent``, ``parent_row``; rows count within these points.
        """
        n = len(truth["kind"])
        record = laspy.ScaleAwarePointRecord.zeros(n, header=self._header)
        for name, values in columns.items():
            record[name] = values
        record["classification"] = np.ones(n, dtype=np.uint8)
        self._las.write_points(record)
        rows = np.where(truth["parent_row"] >= 0, truth["parent_row"] + self.count, -1)
        table = {"kind": truth["kind"], "parent": truth["parent"], "parent_row": rows}
        self._truth.write_table(pa.table(table, schema=self._schema))
        self.count += n


def folder_of(scene: Scene) -> str:
    """Folder of the files, below that of the survey."""
    return "flightlines" if scene.delivery.tile_m is None else "tiles"


class PointFiles:
    """Files of a survey's returns and their truth, each whole or not there."""

    def __init__(self, scene: Scene, out: Path, stack: ExitStack) -> None:
        self._scene, self._out, self._open = scene, out, stack
        self._writers: dict[str, PointsWriter] = {}

    def write(self, run: Pass, columns: Columns, truth: Columns) -> None:
        """Add returns of a flightline.

        ``columns``: LAS dimensions by name; x, y, z as coordinates [m].
        """
        columns = self._handed_over(run, columns)
        for name, rows in self._files(run, columns):
            # Rows count within a file; a parent in another one has none in this.
            place = np.full(len(truth["kind"]), -1)
            place[rows] = np.arange(len(rows))
            parent = truth["parent_row"][rows]
            mine = {key: values[rows] for key, values in truth.items()}
            mine["parent_row"] = np.where(parent >= 0, place[parent], -1)
            self._writer(name, run).write({k: v[rows] for k, v in columns.items()}, mine)

    def _handed_over(self, run: Pass, columns: Columns) -> Columns:
        """The same returns as the delivery tells them."""
        given = self._scene.delivery
        out = dict(columns)
        out[given.channel_dimension] = out.pop("channel")
        number = run.number if given.point_source_id else 0
        out["point_source_id"] = np.full(len(out["x"]), number, np.uint16)
        out["x"], out["y"] = self._moved(run, out["x"], out["y"])
        return out

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

    def _writer(self, name: str, run: Pass) -> PointsWriter:
        if name not in self._writers:
            scene = self._scene
            east, north, up = scene.origin_m
            origin_m = (*self._moved(run, east, north), up)
            crs = run.flight.crs or scene.crs
            header = las_header(crs, origin_m, run.middle_s, scene.delivery.scale_m)
            if scene.delivery.channel_dimension == "channel":
                header.add_extra_dim(laspy.ExtraBytesParams("channel", "uint8", "beamlet, from 1"))
            laz, truth = (
                self._open.enter_context(replacing(self._out / folder / f"{name}.{suffix}"))
                for folder, suffix in ((folder_of(scene), "laz"), ("truth", "parquet"))
            )
            self._writers[name] = self._open.enter_context(PointsWriter(laz, truth, header))
        return self._writers[name]


def write_points(
    path: Path, header: laspy.LasHeader, pieces: Iterable[Mapping[str, NDArray[Any]]]
) -> None:
    """Write a LAZ file piece by piece.

    Parameters
    ----------
    header : LasHeader
        As :func:`las_header` makes it.
    pieces : iterable of mapping
        LAS dimensions of some points by name; x, y, z as coordinates [m].
    """
    with (
        replacing(path) as part,
        laspy.open(str(part), mode="w", header=header, do_compress=True) as las,
    ):
        for columns in pieces:
            n = len(next(iter(columns.values())))
            record = laspy.ScaleAwarePointRecord.zeros(n, header=header)
            for name, values in columns.items():
                record[name] = values
            las.write_points(record)


def write_trajectory_csv(
    path: Path, time_s: NDArray[np.float64], xyz_m: NDArray[np.float64]
) -> None:
    """Trajectory as gps_time,x,y,z in the survey's CRS."""
    with replacing(path) as part:
        table = np.column_stack([time_s, xyz_m])
        np.savetxt(part, table, "%.6f,%.4f,%.4f,%.4f", header="gps_time,x,y,z", comments="")


def sbet_records(
    crs: str,
    time_s: NDArray[np.float64],
    xyz_m: NDArray[np.float64],
    attitude: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Trajectory as SBET: radians, ellipsoid of the CRS, seconds of the GPS week.

    Parameters
    ----------
    crs : str
        CRS of the positions; heights are taken as ellipsoidal.
    time_s : (m,) float64
        Adjusted standard time [s].
    xyz_m : (m, 3) float64
        Positions [m].
    attitude : three (m,) float64
        Grid heading, roll, pitch [rad].

    Returns
    -------
    (m, 17) float64
        time, latitude, longitude, altitude, three velocities, roll, pitch, platform heading
        (true), wander angle, three accelerations, three angular rates. Accelerations and
        rates, which nothing here uses, are zero.
    """
    survey = CRS.from_user_input(crs)
    to_geographic = Transformer.from_crs(survey.to_3d(), "EPSG:4979", always_xy=True)
    longitude, latitude, height = to_geographic.transform(xyz_m[:, 0], xyz_m[:, 1], xyz_m[:, 2])
    factors = Proj(survey).get_factors(longitude, latitude)
    out = np.zeros((len(time_s), 17))
    out[:, 0] = np.mod(time_s + ADJUSTED_STANDARD_OFFSET_S, GPS_WEEK_S)
    out[:, 1], out[:, 2] = np.radians(latitude), np.radians(longitude)
    out[:, 3] = height
    out[:, 4:7] = np.gradient(xyz_m, time_s, axis=0)
    out[:, 7], out[:, 8] = attitude[1], attitude[2]
    out[:, 9] = np.mod(attitude[0] + np.radians(factors.meridian_convergence), 2 * np.pi)
    return out


@contextmanager
def raster_rows(
    path: Path, shape: tuple[int, int], west_m: float, north_m: float, crs: str
) -> Iterator[Callable[[int, NDArray[np.float64]], None]]:
    """Write a raster of 1 m cells as GeoTIFF, some rows at a time.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.

    Yields
    ------
    callable
        Takes the number of a row, from the north, and the values of the rows from it on:
        (rows, columns) float64.
    """
    profile = {
        "driver": "GTiff",
        "dtype": "float32",
        "count": 1,
        "height": shape[0],
        "width": shape[1],
        "crs": CRS.from_user_input(crs).to_wkt(),
        "transform": rasterio.Affine(1.0, 0.0, west_m, 0.0, -1.0, north_m),
        "nodata": NODATA,
        "compress": "deflate",
        "predictor": 3,
    }
    with replacing(path) as part, rasterio.open(part, "w", **profile) as raster:

        def write(first: int, values: NDArray[np.float64]) -> None:
            window = Window(0, first, values.shape[1], values.shape[0])
            raster.write(values.astype(np.float32), 1, window=window)

        yield write


def write_polygons(path: Path, polygons: list[shapely.Polygon], crs: str) -> None:
    """Polygons as GeoPackage with one field, ``id``."""
    content = io.BytesIO()
    pyogrio.raw.write(
        content,
        geometry=shapely.to_wkb(np.array(polygons, dtype=object)),
        field_data=[np.arange(1, len(polygons) + 1, dtype=np.int32)],
        fields=np.array(["id"], dtype=object),
        geometry_type="Polygon",
        crs=CRS.from_user_input(crs).to_wkt(),
        driver="GPKG",
        layer=path.stem,
    )
    write_bytes(path, content.getvalue())


def write_text(path: Path, content: Mapping[str, Any]) -> None:
    """Mapping as YAML or JSON, by the suffix."""
    text = (
        json.dumps(content, indent=1) + "\n"
        if path.suffix == ".json"
        else yaml.safe_dump(dict(content), sort_keys=False)
    )
    write_bytes(path, text.encode())
