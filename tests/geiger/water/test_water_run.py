"""Water surfaces on the engine: run, resume, isolate, report, and users' mistakes."""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
import yaml
import zarr

from spl_batch import api
from spl_batch.engine.report.schema import schemas
from spl_batch.errors import PlanError, WorkflowError
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.water import formats, receiver
from tests import surveys
from tests.geiger.water.water_scene import TANK, write_tank

CRS = "survey.crs=EPSG:32616"


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of two files with three surfaces each, and frames of targets."""
    return write_tank(tmp_path_factory.mktemp("tank"))


@pytest.fixture(scope="module")
def done(tank: Path) -> api.RunResult:
    return api.run(tank, workers=0, overrides=[CRS])


def own(tank: Path, folder: Path) -> Path:
    """The workflow in a folder of the test's own."""
    shutil.copytree(tank.parent, folder / "own", ignore=shutil.ignore_patterns("out"))
    return folder / "own" / "workflow.yaml"


def test_a_run_delivers_surfaces_that_are_true(done: api.RunResult) -> None:
    assert done.exit_status == 0
    report = done.report
    assert report.surfaces.acquisitions == 6
    assert report.surfaces.pixel_normal_deg < 6
    assert report.surfaces.mse_m2 < 0.015**2
    assert report.floor.refracted_beam_m < 0.6 * report.floor.level_beam_m
    assert report.floor.level_beam_m < report.floor.straight_beam_m
    assert report.calibration.pulse_ns == pytest.approx(1.0, abs=0.15)
    each = report.each_surface
    assert [(e.file, e.acquisition) for e in each] == [
        (f"frames/tank_0{f}.h5", k) for f in range(2) for k in range(3)
    ]
    assert np.mean([e.mse_m2 for e in each]) == pytest.approx(report.surfaces.mse_m2)
    assert [f.acquisitions for f in report.files if f.role == "water"] == [3, 3]
    assert [f.role for f in report.files].count("target") == 4
    shown = dict(receiver.RECEIVER.screen(report))
    assert shown["calibration"].startswith("fitted")
    assert "accuracy" not in shown
    content = surveys.report(done.output)
    jsonschema.validate(content, json.loads(schemas()["water_surface_report.schema.json"]))
    assert (done.output / "report.html").read_text().count("data:image/png") == 4
    assert api.report(done.output).report.surfaces == report.surfaces


def test_points_and_rasters_lie_where_the_water_is(tank: Path, done: api.RunResult) -> None:
    table = pq.read_table(done.output / "points" / "tank_00.parquet")
    columns = {k: table[k].to_numpy() for k in table.column_names}
    assert set(columns["acquisition"]) == {0, 1, 2}
    assert columns["row"].max() == 16, "the last rows are not used"
    length = sum(columns[f"normal_{k}"].astype(float) ** 2 for k in ("north", "east", "down"))
    np.testing.assert_allclose(length, 1.0, atol=1e-5)
    way = sum((columns[f"floor_{k}_m"] - columns[f"{k}_m"]) ** 2 for k in ("north", "east", "down"))
    np.testing.assert_allclose(np.sqrt(way), 6.0, atol=1e-4)
    with h5py.File(tank.parent / "frames" / "tank_00.h5") as group:
        true = group["truth/down_m"][()][columns["acquisition"], columns["row"], columns["col"]]
    assert np.sqrt(np.mean((columns["down_m"] - true) ** 2)) < 0.015
    np.testing.assert_allclose(np.unique(columns["time_s"]), (np.arange(3) * 60 + 29.5) / 2000)
    with rasterio.open(done.output / "surfaces" / "tank_00.tif") as source:
        values, transform, crs = source.read(1), source.transform, source.crs
    assert abs(np.median(values[values > -9000]) + np.median(columns["down_m"])) < 0.01
    assert transform.a == pytest.approx(0.01)
    assert transform.c <= columns["east_m"].min() < transform.c + 0.011
    assert crs.to_epsg() == 32616


def test_pieces_change_nothing(
    tank: Path, tmp_path: Path, done: api.RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(receiver, "PIECE_ACQUISITIONS", 2)
    monkeypatch.setattr(formats, "PIECE_VALUES", 37 * 20 * 18)
    path = own(tank, tmp_path)
    with h5py.File(path.parent / "frames" / "tank_00.h5", "r+") as file:
        frames = file["frames"][()]
        del file["frames"]
        file.create_dataset("frames", data=frames, chunks=(11, 5, 18))
    api.run(path, workers=0, until="deliver", overrides=[CRS])
    for name in ("surfaces/tank_00.tif", "surfaces/tank_01.tif"):
        assert (path.parent / "out" / name).read_bytes() == (done.output / name).read_bytes()
    name = "points/tank_00.parquet"
    one, other = (pq.read_table(folder / name) for folder in (path.parent / "out", done.output))
    for column in one.column_names:
        np.testing.assert_array_equal(one[column].to_numpy(), other[column].to_numpy())


def test_a_bad_file_is_named_and_the_rest_goes_on(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    (path.parent / "frames" / "text.h5").write_text("no frames")
    with h5py.File(path.parent / "frames" / "tank_01.h5", "r+") as group:
        group["frames"][70, 3, 3] = 60_000
    with h5py.File(path.parent / "frames" / "tank_02.h5", "w") as group:
        group.create_dataset("frames", (180, 20, 18), "u2", chunks=(60, 20, 18))[:60, 9, 9] = 400
    result = api.run(path, workers=0)
    assert result.exit_status == 1
    reasons = {Path(f.place).name: f.reason for f in result.report.failures}
    assert {"text.h5", "tank_01.h5"} <= set(reasons)
    assert "60000" in reasons["tank_01.h5"]
    (missing,) = surveys.found(result.report.findings, "W01", "chunks")
    assert missing.subjects == ("frames/tank_02.h5",)
    assert (result.output / "surfaces" / "tank_00.tif").exists()
    assert not (result.output / "surfaces" / "tank_01.tif").exists()


def test_zarr_without_targets_against_a_level_surface(tmp_path: Path) -> None:
    still = {**TANK["instrument"], "delay_ns": 0, "pattern_ns": 0}
    changes = {"target": {"down_m": 0.1}, "instrument": still, "calibration": None}
    path = write_tank(tmp_path, format="zarr", files=1, in_water_m=0.0, **changes)
    shutil.rmtree(path.parent / "frames" / "tank_00.zarr" / "truth")
    bare = api.run(path, workers=0)
    assert bare.report.surfaces is None
    assert not bare.report.calibration.fitted
    shown = dict(receiver.RECEIVER.screen(bare.report))
    assert shown["calibration"].startswith("as given")
    assert shown["accuracy"].startswith("no truth")
    # Bins hold times from their number up, the source's numbers count from it.
    level = ["level.down_m=0.1", "calibration.offset_ns=82.2275"]
    api.run(path, workers=0, until="deliver", overrides=level)
    (errors,) = (bare.output / "store" / "errors").rglob("*.npz")
    found = read_arrays(errors)
    assert found["errors"].shape == (3, 6)
    assert found["errors"][:, 2].max() < 0.01**2, "mean squared error"
    assert np.isnan(found["floor"]).all()


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"camra": {}}, "'camera'"),
        ({"camera": {"rows": 16, "cols": 18}}, "camera.rows"),
        ({"survey": {"frames": "frames/*.hdf"}}, "matches no file"),
        ({"survey": {"frames": "frames/*.h5", "crs": "EPSG:4326"}}, "geographic"),
        ({"pixels": {"dead": [[40, 1]]}}, "[40, 1]"),
        ({"gate": {"width_bins": 9000}}, "gate.width_bins"),
        ({"surface": {"frames_per_acquisition": 500}}, "surface.frames_per_acquisition"),
        (
            {"calibration": {"frames": [{"frames": "frames/tank_00.h5", "distance_m": 3}]}},
            "two different distances",
        ),
        ({"surface": {"adaptive": {"half_windows": [3, 2]}}}, "half_windows"),
        ({"surface": {"method": "windowed", "windowed": {"patch": 40}}}, "windowed.patch"),
    ],
)
def test_mistakes_are_named_in_a_line(
    tank: Path, tmp_path: Path, changes: dict[str, Any], key: str
) -> None:
    content = yaml.safe_load(tank.read_text())
    path = tank.parent / f"{tmp_path.name}.yaml"
    path.write_text(yaml.safe_dump({**content, **changes}))
    with pytest.raises(WorkflowError) as caught:
        api.plan(path)
    assert key in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_all_targets_nothing_is_made(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    target = path.parent / "calibration" / "3.5m_0.3.h5"
    whole = bytearray(target.read_bytes())
    middle = len(whole) // 2
    target.write_bytes(whole[:middle] + bytes(200) + whole[middle + 200 :])
    with pytest.raises(WorkflowError, match="calibration"):
        api.run(path, workers=0)
    target.write_bytes(whole)
    dim = ["calibration.range_walk=exponential", "calibration.dim_max=0.00501"]
    with pytest.raises(WorkflowError, match="0 of their distances"):
        api.run(path, workers=0, overrides=dim)
    (path.parent / "calibration" / "2.5m_0.3.h5").unlink()
    target.write_text("?")
    with pytest.raises(WorkflowError, match=r"calibration.frames\[0\].*3\.5m_0\.3\.h5"):
        api.plan(path)


def test_a_gate_that_is_given_is_the_water_s_alone(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    api.run(path, workers=0, until="index", overrides=["gate.centre_bin=420"])
    counted = {
        facts["name"]: facts["gate"]
        for file in (path.parent / "out" / "store" / "receipts" / "count_frames").iterdir()
        if (facts := json.loads(file.read_bytes())["facts"])
    }
    assert counted["frames/tank_00.h5"] == [397, 444]
    near, far = counted["calibration/2.5m_2.h5"], counted["calibration/3.5m_2.h5"]
    assert far[0] - near[0] == pytest.approx(27, abs=4), "a metre more, in bins"


def test_a_chunk_that_memory_has_no_room_for_is_refused(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    group = zarr.open_group(path.parent / "frames" / "tank_02.zarr", mode="w")
    # Nothing but its declaration is there: that is what is looked at.
    group.create_array("frames", shape=(500_000, 20, 18), dtype="u2", chunks=(500_000, 20, 18))
    with pytest.raises(PlanError, match=r"500 000 frames in frames/tank_02\.zarr .*5 688 frames"):
        api.plan(path, memory="1GiB", overrides=["survey.frames=frames/*"])
