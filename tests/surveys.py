"""Small surveys for whole runs, and ways to look at what a run has written."""

import contextlib
import io
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import laspy
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
import yaml
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch import api
from spl_batch.cli import main
from spl_batch.formats.files.locks import lock

Columns = dict[str, NDArray[Any]]

CRS_NAME = "EPSG:32615"
START_S = 371_000_000.0
PRF_HZ = 1000.0
GATE_M = 60.0
HEIGHT_M = 600.0
SPEED_M_S = 60.0
ORIGIN_M = (272_000.0, 3_290_000.0)
PRODUCTS = ("dtm", "dtm_quality", "dsm", "chm", "density", "intensity")


def flightline(
    *,
    shots: int = 200,
    psid: int = 1,
    start_s: float = START_S,
    seed: int = 0,
    origin_m: tuple[float, float] = ORIGIN_M,
    noise: float = 0.3,
) -> Columns:
    """Returns of a straight pass over a gentle slope, with noise along the beams.

    A shot has 25 beamlets on a 5 x 5 grid, turned shot by shot. Three in four beamlets see
    the ground; ``noise`` of them see something else within the gate.
    """
    rng = np.random.default_rng(seed)
    time = start_s + np.arange(shots) / PRF_HZ
    centre = np.column_stack(
        [
            origin_m[0] + SPEED_M_S * (time - start_s),
            origin_m[1] + 8.0 * np.sin(np.arange(shots) / 9.0),
        ]
    )
    grid = np.stack(np.meshgrid(np.arange(5) - 2.0, np.arange(5) - 2.0), -1).reshape(25, 2) * 0.6
    foot = centre[:, None, :] + grid[None]
    shape = foot.shape[:2]
    ground = 20.0 + 0.05 * (foot[..., 0] - origin_m[0])
    sensor = np.stack([centre[:, 0], np.full(shots, origin_m[1])], -1)
    parts = []
    for kind, share in (("ground", 0.75), ("noise", noise)):
        seen = rng.random(shape) < share
        above = rng.normal(0, 0.03, shape) if kind == "ground" else rng.uniform(-25, 25, shape)
        height = (ground + above)[seen]
        away = ((height - ground[seen]) / (HEIGHT_M - ground[seen]))[:, None]
        hit = foot[seen] + away * (np.repeat(sensor[:, None], 25, 1)[seen] - foot[seen])
        parts.append(
            {
                "x": hit[:, 0],
                "y": hit[:, 1],
                "z": height,
                "gps_time": np.broadcast_to(time[:, None], shape)[seen],
                "channel": np.broadcast_to(np.arange(1, 26), shape)[seen].astype(np.uint8),
                "intensity": rng.integers(1, 500, len(height)).astype(np.uint16),
            }
        )
    columns = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
    order = np.lexsort((columns["z"], columns["channel"], columns["gps_time"]))
    columns = {k: v[order] for k, v in columns.items()}
    n = len(order)
    columns["return_number"] = np.ones(n, np.uint8)
    columns["number_of_returns"] = np.ones(n, np.uint8)
    columns["point_source_id"] = np.full(n, psid, np.uint16)
    columns["classification"] = np.ones(n, np.uint8)
    columns["user_data"] = rng.integers(0, 256, n).astype(np.uint8)
    return columns


def take(columns: Columns, rows: Any) -> Columns:
    """Rows of every column."""
    return {k: v[rows] for k, v in columns.items()}


def join(*parts: Columns) -> Columns:
    """Columns one below the other."""
    return {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}


def write_cloud(
    path: Path,
    columns: Mapping[str, NDArray[Any]],
    *,
    version: str = "1.4",
    point_format: int = 6,
    crs: str | None = CRS_NAME,
    scale: float = 0.001,
    channel: bool = True,
) -> Path:
    """Write a cloud; dimensions that the point format lacks are left out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = np.full(3, scale)
    n = len(columns["x"])
    # The same for every file of a survey, so that raw coordinates can be compared.
    far_north = n > 0 and abs(columns["y"][0]) > 2e6
    header.offsets = np.array([0.0, 3_000_000.0 if far_north else 0.0, 0.0])
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    if channel:
        header.add_extra_dim(laspy.ExtraBytesParams("channel", np.uint8))
    if crs is not None:
        header.add_crs(CRS.from_user_input(crs))
    points = laspy.ScaleAwarePointRecord.zeros(n, header=header)
    known = set(header.point_format.dimension_names) | {"x", "y", "z"}
    for name, values in columns.items():
        if name in known:
            points[name] = values
    with laspy.open(path, mode="w", header=header) as writer:
        if n:
            writer.write_points(points)
    return path


def in_feet(path: Path, target: Path, crs: str, units_m: Sequence[float]) -> Path:
    """The same cloud in another CRS: raw coordinates stay, scale and offset are divided."""
    las = laspy.read(path)
    raw = {axis: np.array(las[axis]) for axis in "XYZ"}
    las.header.vlrs = [v for v in las.header.vlrs if v.user_id != "LASF_Projection"]
    las.header.scales = np.array(las.header.scales) / units_m
    las.header.offsets = np.array(las.header.offsets) / units_m
    las.header.add_crs(CRS.from_user_input(crs))
    las.points.scales, las.points.offsets = las.header.scales, las.header.offsets
    for axis, values in raw.items():
        las.points.array[axis] = values
    target.parent.mkdir(parents=True, exist_ok=True)
    las.write(target)
    return target


def write_shapes(path: Path, shapes: Iterable[Any], crs: Any = CRS_NAME, **fields: Any) -> Path:
    """Write shapes of one kind, and a value of each field for each of them."""
    drawn = np.array([*shapes], object)
    columns = [np.array([*values]) for values in fields.values()]
    pyogrio.raw.write(
        path, shapely.to_wkb(drawn),
        [column.astype(object) if column.dtype.kind == "U" else column for column in columns],
        [*fields], geometry_type=drawn[0].geom_type + " Z" * bool(drawn[0].has_z),
        crs=CRS.from_user_input(crs).to_wkt(),
    )  # fmt: skip
    return path


def write_trajectory(
    path: Path, *, start_s: float = START_S - 1, stop_s: float = START_S + 10, shift_m: float = 0.0
) -> Path:
    """Positions ten times a second along the passes of :func:`flightline`."""
    time = np.arange(start_s, stop_s, 0.1)
    x = ORIGIN_M[0] + SPEED_M_S * (time - START_S) + shift_m
    table = np.column_stack(
        [time, x, np.full(len(time), ORIGIN_M[1]), np.full(len(time), HEIGHT_M)]
    )
    np.savetxt(path, table, "%.4f", delimiter=",", header="gps_time,x,y,z", comments="")
    return path


def write_workflow(folder: Path, **sections: Any) -> Path:
    """Workflow of small clouds in ``lines/``; sections replace or, as None, remove."""
    survey = {"flightlines": "lines/*.la[sz]", "channel_dimension": "channel"}
    if (folder / "trajectory.csv").exists():
        survey["trajectory"] = "trajectory.csv"
    content: dict[str, Any] = {
        "survey": {**survey, **sections.pop("survey", {})},
        "output": "out",
        "acquisition": {"prf_hz": PRF_HZ, "gate_m": GATE_M},
        "ground": {"cell_m": 50, "buffer_m": 20},
        **sections,
    }
    content["survey"] = {k: v for k, v in content["survey"].items() if v is not None}
    path = folder / "workflow.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return path


def small_survey(folder: Path, **sections: Any) -> Path:
    """Two passes of about 3000 points each, and their workflow."""
    for k in (1, 2):
        line = flightline(
            shots=120, psid=k, start_s=START_S + 3 * (k - 1), seed=k, origin_m=ORIGIN_M
        )
        write_cloud(folder / "lines" / f"line_{k}.laz", line)
    return write_workflow(folder, **sections)


class Ended(NamedTuple):
    """How a command ended."""

    status: int
    out: str
    err: str

    @property
    def text(self) -> str:
        """Everything that it printed."""
        return self.out + self.err


def command(*arguments: object) -> Ended:
    """Run the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    status = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main([str(a) for a in arguments])
        except SystemExit as stop:
            status = int(stop.code or 0)
    ended = Ended(status, out.getvalue(), err.getvalue())
    assert "Traceback" not in ended.text
    return ended


def run(workflow: Path, *overrides: str, **options: Any) -> api.RunResult:
    """Run a workflow in this process."""
    return api.run(workflow, workers=0, overrides=overrides, **options)


def delivered(output: Path) -> dict[str, Columns]:
    """Every dimension of every delivered cloud, raw coordinates included, by relative name."""
    found = {}
    for path in sorted((output / "laz").rglob("*.laz")):
        name = path.relative_to(output / "laz").as_posix()
        found[name] = cloud(path)
    return found


def cloud(path: Path) -> Columns:
    """Every dimension of a cloud by name; X, Y, Z raw."""
    las = laspy.read(path)
    return {name: np.array(las[name]) for name in las.point_format.dimension_names}


def labels(output: Path) -> dict[str, Columns]:
    """What the run decided about each point, by relative name."""
    names = ("classification", "noise_class", "noise_density", "p_value")
    return {
        name: {k: columns[k] for k in names if k in columns}
        for name, columns in delivered(output).items()
    }


def rasters(output: Path) -> dict[str, tuple[bytes, Any]]:
    """Cells and transform of each delivered raster."""
    found = {}
    for path in sorted(output.glob("*.tif")):
        with rasterio.open(path) as source:
            found[path.name] = (source.read(1).tobytes(), source.transform)
    return found


def report(output: Path) -> Any:
    """The report of a run, as programs read it."""
    return json.loads((output / "report.json").read_text(encoding="utf-8"))


def results(output: Path) -> dict[str, bytes]:
    """Bytes of every delivered cloud and raster."""
    files = [*output.glob("*.tif"), *(output / "laz").rglob("*.laz")]
    return {p.relative_to(output).as_posix(): p.read_bytes() for p in sorted(files)}


def assert_same_labels(a: Mapping[str, Columns], b: Mapping[str, Columns]) -> None:
    """Labels are bit-identical, NaN included."""
    assert a.keys() == b.keys()
    for name, columns in a.items():
        assert columns.keys() == b[name].keys()
        for key, values in columns.items():
            assert values.tobytes() == b[name][key].tobytes(), f"{name}: {key}"


def assert_mended(workflow: Path, expected: Path) -> None:
    """A run with nothing in its way ends as if nothing had ever been."""
    ended = run(workflow, until="deliver")
    assert ended.exit_status == 0
    assert results(ended.output) == results(expected)


def copy_of(survey: Path, folder: Path) -> Path:
    """A survey's inputs in another folder, nothing that a run has made; its workflow."""
    ignore = shutil.ignore_patterns("out", "truth")
    shutil.copytree(survey.parent, folder, ignore=ignore, dirs_exist_ok=True)
    return folder / survey.name


def point_rows(columns: Columns, names: Sequence[str]) -> NDArray[Any]:
    """Points as sorted records of these dimensions: a multiset that can be compared."""
    return np.sort(np.rec.fromarrays([columns[k] for k in names], names=",".join(names)))


def wait_for(stream: io.TextIOWrapper) -> None:
    """Hold a lock on a file, once no other process does."""
    while True:
        with contextlib.suppress(BlockingIOError):
            return lock(stream)
        time.sleep(0.02)


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder for all processes of pytest-xdist, into which nobody may write.

    Parameters
    ----------
    factory : pytest.TempPathFactory
        Knows the folder of this run of the tests.
    name : str
        Of the folder.
    make : callable
        Fills it. The first process that asks calls it, others wait meanwhile; where it fails, the
        next one that asks tries again.
    """
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    folder, done = base / name, base / f"{name}.done"
    with (base / f"{name}.lock").open("w") as held:
        wait_for(held)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def found(findings: Iterable[Any], code: str, kind: str | None = None) -> list[Any]:
    """Findings of a report or a plan with a code, and a kind if one is given."""
    return [
        one
        for one in findings
        if one.code == code and (kind is None or one.values.get("kind") == kind)
    ]
