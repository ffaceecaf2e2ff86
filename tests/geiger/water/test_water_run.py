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
from spl_batch.engine.tasks.input_changes import stamp
from spl_batch.engine.watch.events import Note, PhaseStarted
from spl_batch.errors import PlanError, WorkflowError
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.water import formats
from spl_batch.geiger.water import plan as planning
from spl_batch.geiger.water.settings import WaterSurvey, WaterWorkflow
from spl_batch.geiger.water.simulate import simulate_file
from spl_batch.geiger.water.simulate.scene import load_scene
from tests.geiger.water.water_scene import TANK, write_tank
from tests.workflow_files import differing, unshown

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of two files with three surfaces each, and frames of targets."""
    return write_tank(tmp_path_factory.mktemp("tank"))


@pytest.fixture(scope="module")
def done(tank: Path) -> api.RunResult:
    return api.run(tank, workers=0, overrides=["survey.crs=EPSG:32616"])


def own(tank: Path, folder: Path, **changes: Any) -> Path:
    """The workflow in a folder of the test's own, with other sections."""
    shutil.copytree(tank.parent, folder / "own", ignore=shutil.ignore_patterns("out"))
    path = folder / "own" / "workflow.yaml"
    content = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**content, **changes}))
    return path


def tasks_of(path: Path, *overrides: str) -> int:
    """Tasks that a run up to the delivery does."""
    events: list[Any] = []
    api.run(path, workers=0, until="deliver", overrides=overrides, listener=events.append)
    return sum(e.tasks for e in events if isinstance(e, PhaseStarted))


def test_a_run_delivers_surfaces_that_are_true(done: api.RunResult) -> None:
    assert done.exit_status == 0
    report = done.report
    assert report.surfaces.acquisitions == 6
    assert report.surfaces.pixel_normal_deg < 6
    assert report.surfaces.mse_m2 < 0.015**2
    assert report.floor.refracted_beam_m < 0.6 * report.floor.level_beam_m
    assert report.floor.level_beam_m < report.floor.straight_beam_m
    assert report.calibration.fitted
    assert report.calibration.pulse_ns == pytest.approx(1.0, abs=0.15)
    assert np.array(report.pixels.bias_m, dtype=float).shape == (20, 18)
    each = report.each_surface
    assert [(e.file, e.acquisition) for e in each] == [
        (f"frames/tank_0{f}.h5", k) for f in range(2) for k in range(3)
    ]
    assert np.mean([e.mse_m2 for e in each]) == pytest.approx(report.surfaces.mse_m2)
    assert [f.role for f in report.files].count("target") == 4


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
    known = values[values > -9000]
    assert abs(np.median(known) + np.median(columns["down_m"])) < 0.01
    assert transform.a == pytest.approx(0.01)
    assert transform.c <= columns["east_m"].min() < transform.c + 0.011
    assert crs.to_epsg() == 32616


def test_the_report_fits_its_schema_and_shows_itself(done: api.RunResult) -> None:
    content = json.loads((done.output / "report.json").read_text())
    jsonschema.validate(content, json.loads(schemas()["water_surface_report.schema.json"]))
    page = (done.output / "report.html").read_text()
    for word in ("Water surface from a Geiger-mode array", "surface found", "first photon"):
        assert word in page
    assert page.count("data:image/png") == 5
    assert dict(done.screen)["failures"] == "none"
    again = api.report(done.output)
    assert again.report.surfaces == done.report.surfaces


def test_a_second_run_does_only_what_a_change_asks_for(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    out = path.parent / "out"
    assert tasks_of(path) == 6 + 1 + 2 + 4
    assert tasks_of(path) == 0
    assert tasks_of(path, "outputs.cell_m=0.02") == 2
    assert tasks_of(path, "outputs.cell_m=0.02", "surface.method=windowed") == 6
    assert tasks_of(path, "outputs.each_acquisition=true", "path.in_water_m=0") == 6
    assert len(list((out / "surfaces" / "tank_01").glob("*.tif"))) == 3
    assert tasks_of(path) == 6
    assert not list((out / "surfaces" / "tank_01").glob("*.tif")), "stale ones go"


def test_pieces_change_nothing(
    tank: Path, tmp_path: Path, done: api.RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, "PIECE_ACQUISITIONS", 2)
    monkeypatch.setattr(formats, "PIECE_VALUES", 37 * 20 * 18)
    path = own(tank, tmp_path)
    with h5py.File(path.parent / "frames" / "tank_00.h5", "r+") as file:
        frames = file["frames"][()]
        del file["frames"]
        file.create_dataset("frames", data=frames, chunks=(11, 5, 18))
    api.run(path, workers=0, until="deliver", overrides=["survey.crs=EPSG:32616"])
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
    result = api.run(path, workers=0)
    assert result.exit_status == 1
    reasons = " ".join(f"{f.place} {f.reason}" for f in result.report.failures)
    assert "text.h5" in reasons
    assert "hold the time bin 60000, the camera has 1 to 8000" in reasons
    assert result.report.surfaces.acquisitions == 3
    assert (result.output / "surfaces" / "tank_00.tif").exists()
    assert not (result.output / "surfaces" / "tank_01.tif").exists()


def test_zarr_without_targets_against_a_level_surface(tmp_path: Path) -> None:
    path = write_tank(
        tmp_path,
        format="zarr",
        files=1,
        calibration=None,
        in_water_m=0.0,
        target={"down_m": 0.1},
        instrument={**TANK["instrument"], "delay_ns": 0, "pattern_ns": 0},
    )
    shutil.rmtree(path.parent / "frames" / "tank_00.zarr" / "truth")
    bare = api.run(path, workers=0)
    assert bare.report.surfaces is None
    assert not bare.report.calibration.fitted
    assert "no truth" in dict(bare.screen)["accuracy"]
    # Bins hold times from their number up, the source's numbers count from it.
    level = ["level.down_m=0.1", "calibration.offset_ns=82.2275"]
    api.run(path, workers=0, until="deliver", overrides=level)
    (errors,) = (bare.output / "store" / "errors").rglob("*.npz")
    found = read_arrays(errors)
    assert found["errors"].shape == (3, 6)
    assert found["errors"][:, 2].max() < 0.01**2, "mean squared error"
    assert np.isnan(found["floor"]).all()


def test_a_missing_chunk_is_told(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    with h5py.File(path.parent / "frames" / "tank_00.h5") as file:
        frames = file["frames"][()]
    other = path.parent / "frames" / "tank_02.zarr"
    group = zarr.open_group(other, mode="w")
    group.create_array("frames", data=frames, chunks=(60, 20, 18))
    before = stamp(other)
    (other / "frames" / "c" / "1" / "0" / "0").unlink()
    assert stamp(other) != before, "a folder is known by what lies in it"
    told: list[Any] = []
    api.run(
        path,
        workers=0,
        until="index",
        overrides=["survey.frames=frames/*.zarr"],
        listener=told.append,
    )
    notes = [e.text for e in told if isinstance(e, Note)]
    assert any("frames/tank_02.zarr: 60 of 180 frames have no hit" in n for n in notes)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"camra": {}}, "the nearest known key is 'camera'"),
        ({"camera": {"rows": 16, "cols": 18}}, "the camera (n, 16, 18); correct camera.rows"),
        ({"survey": {"frames": "frames/*.hdf"}}, "matches no file"),
        ({"survey": {"frames": "frames/*.h5", "crs": "EPSG:4326"}}, "is geographic (degrees)"),
        (
            {"survey": {"frames": "frames/*.h5", "crs": "moon"}},
            "'moon' is not a known CRS; write e.g.",
        ),
        ({"pixels": {"dead": [[40, 1]]}}, "[40, 1] is no pixel of 20 x 18"),
        ({"gate": {"width_bins": 9000}}, "gate.width_bins: more than camera.bins"),
        ({"surface": {"frames_per_acquisition": 500}}, "holds 180 frames, fewer than"),
        (
            {"calibration": {"frames": [{"frames": "frames/tank_00.h5", "distance_m": 3}]}},
            "at least two different distances",
        ),
        (
            {"surface": {"adaptive": {"half_windows": [3, 2]}}},
            "half_windows: must rise",
        ),
        ({"surface": {"method": "windowed", "windowed": {"patch": 40}}}, "wider than the array"),
    ],
)
def test_mistakes_are_told_in_a_line(
    tank: Path, tmp_path: Path, changes: dict[str, Any], says: str
) -> None:
    content = yaml.safe_load(tank.read_text())
    path = tank.parent / f"{tmp_path.name}.yaml"
    path.write_text(yaml.safe_dump({**content, **changes}))
    with pytest.raises(WorkflowError) as caught:
        api.plan(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_target_stops_before_work(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    (path.parent / "calibration" / "2.5m_0.3.h5").unlink()
    (path.parent / "calibration" / "3.5m_2.h5").write_text("?")
    with pytest.raises(WorkflowError) as caught:
        api.run(path, workers=0)
    assert "calibration.frames[0]" in str(caught.value)
    assert "3.5m_2.h5: is no HDF5 file" in str(caught.value), "all faults at once"


def test_a_target_with_a_hole_is_refused_by_plan_and_run_alike(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    target = path.parent / "calibration" / "3.5m_0.3.h5"
    whole = bytearray(target.read_bytes())
    middle = len(whole) // 2
    whole[middle : middle + 200] = bytes(200)
    target.write_bytes(whole)
    said = []
    for verb in (api.plan, lambda p: api.run(p, workers=0)):
        with pytest.raises(WorkflowError) as caught:
            verb(path)
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert "3.5m_0.3.h5: damaged HDF5" in said[0]
    assert not (path.parent / "out").exists(), "nothing has been started"


@pytest.mark.usefixtures("done")
def test_targets_that_a_run_has_counted_are_not_read_again(
    tank: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*_args: object, **_more: object) -> None:
        pytest.fail("read once more")

    monkeypatch.setattr("spl_batch.geiger.water.calibration_targets.read_through", read)
    api.plan(tank, overrides=["survey.crs=EPSG:32616"])
    with pytest.raises(pytest.fail.Exception, match="read once more"):
        api.plan(tank, overrides=["survey.crs=EPSG:32616", "calibration.range_walk=exponential"])


def test_targets_too_dim_to_fit_are_told(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    dim = ["calibration.range_walk=exponential", "calibration.dim_max=0.00501"]
    for verb in (api.plan, lambda p, **said: api.run(p, workers=0, **said)):
        with pytest.raises(WorkflowError, match="0 of their distances have pixels with an inten"):
            verb(path, overrides=dim)


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


def test_a_plan_tells_what_will_be_made(tank: Path) -> None:
    made = api.plan(tank)
    assert made.files == 2
    assert dict(made.rows)["surfaces"] == "6 of 60 frames each"
    assert dict(made.rows)["calibration"] == "from 4 files"
    assert made.cost.tasks == 2 * 3 + 4 + 2 + 1


def test_what_a_scene_gets_wrong_is_told(tmp_path: Path) -> None:
    for content, says in (
        ({"kind": "water_surface", "acquisition": 3}, "the nearest known key is 'acquisitions'"),
        ({"kind": "water_surface", "target": {"waves": []}}, "target.down_m"),
        ({"kind": "water_surface", "format": "tiff"}, "format"),
    ):
        scene = tmp_path / "scene.yaml"
        scene.write_text(yaml.safe_dump(content))
        with pytest.raises(WorkflowError, match=says):
            simulate_file(scene, tmp_path / "out")


def test_the_complete_workflow_shows_every_key_and_runs(tmp_path: Path) -> None:
    text = (ROOT / "workflows" / "water_surface.yaml").read_text()
    assert unshown(text, WaterWorkflow) == []
    content = yaml.safe_load(text)
    bare = WaterWorkflow(survey=WaterSurvey(frames="x"), output="out").model_dump(mode="json")
    examples = {"survey.name", "survey.frames", "calibration.frames"}
    assert set(differing(content, bare)) == examples
    scene = {
        "kind": "water_surface",
        "name": "tank",
        "acquisitions": 1,
        "calibration": {"frames": 100, "distances_m": [2, 4], "lights": [1]},
    }
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    simulate_file(tmp_path / "scene.yaml", tmp_path)
    path = tmp_path / "complete.yaml"
    path.write_text(text)
    assert api.run(path, workers=0, until="deliver").exit_status == 0
    assert (tmp_path / "out" / "surfaces" / "tank_00.tif").exists()


def test_the_scene_file_is_accepted() -> None:
    scene = load_scene(ROOT / "workflows" / "water_scene.yaml")
    assert len(scene.target.waves) == 2


def test_a_chunk_that_memory_has_no_room_for_is_refused(tank: Path, tmp_path: Path) -> None:
    path = own(tank, tmp_path)
    group = zarr.open_group(path.parent / "frames" / "tank_02.zarr", mode="w")
    # Nothing but its declaration is there: that is what is looked at.
    group.create_array("frames", shape=(500_000, 20, 18), dtype="u2", chunks=(500_000, 20, 18))
    with pytest.raises(PlanError) as caught:
        api.plan(path, memory="1GiB", overrides=["survey.frames=frames/*"])
    text = str(caught.value)
    assert text.startswith("a chunk of 500 000 frames in frames/tank_02.zarr needs ")
    assert text.endswith("raise it to 1815MiB or store it again in chunks of 5 688 frames or fewer")
