"""Every receiver on the same engine: a killed run goes on where it was, a bad file costs itself.

Another receiver joins by an entry in :data:`SURVEYS`: its kind, a function that writes a small
survey into a folder and gives back the workflow (its output is ``out`` beside it), the inputs that
are lost together when the first of them cannot be read, and when runs of it are killed: while a
task writes its output or its receipt.

The survey wants ten tasks or more, a second or less of work, and other inputs of the same sort
beside those.
"""

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from spl_batch.receivers import HOMES, IMAGING
from tests import killed_worker, surveys
from tests.altimetry.tracks import small_track, write_atl03, write_atl08
from tests.altimetry.tracks import write_workflow as write_track_workflow
from tests.geiger.coincidence.coincidence_scene import SMALL
from tests.geiger.water.water_scene import write_tank
from tests.killed_worker import receipt_files

ROOT = Path(__file__).parents[3]


def altimetry(folder: Path) -> Path:
    """Two granules with three beams, cut into segments, beside labels of one of them."""
    tracks = {"gt1r": small_track(1, canopy=0.3), "gt2l": small_track(2)}
    atl03 = write_atl03(folder / "granule_1.h5", tracks)
    write_atl08(folder / "atl08.h5", atl03, tracks)
    write_atl03(folder / "granule_2.h5", {"gt3l": small_track(3)})
    return write_track_workflow(
        folder,
        "granule_*.h5",
        reference={"labels": "atl08.h5"},
        work={"segment_photons": 2000},
    )


def coincidence(folder: Path) -> Path:
    """Two passes over the spokes, in tiles that cut them."""
    scene = yaml.safe_load((ROOT / "workflows/coincidence_scene.yaml").read_text())
    (folder / "scene.yaml").write_text(yaml.safe_dump({**scene, **SMALL.model_dump(mode="json")}))
    assert surveys.command("simulate", folder / "scene.yaml", folder).status == 0
    workflow = folder / "workflow.yaml"
    content = yaml.safe_load(workflow.read_text())
    workflow.write_text(yaml.safe_dump({**content, "tiling": {"tile_m": 2.0}}))
    return workflow


@dataclass(frozen=True)
class Survey:
    """A survey whose run nothing disturbed; the module's text names the parts."""

    workflow: Path
    lost: tuple[str, ...]
    killed_at: tuple[str, ...]

    @property
    def output(self) -> Path:
        """Where its results are."""
        return self.workflow.parent / "out"

    def copied(self, folder: Path) -> Path:
        """Workflow of the same inputs in another folder, where no run has been."""
        return surveys.copy_of(self.workflow, folder)


L1_FILES = ("l1/pass_2_detections.parquet", "l1/pass_2_frames.parquet")
SURVEYS = {
    "altimetry": (altimetry, ("granule_2.h5",), ("output",)),
    "coincidence": (coincidence, L1_FILES, ("output",)),
    "water_surface": (write_tank, ("frames/tank_01.h5",), ("receipt",)),
}


@pytest.fixture(scope="module", params=sorted(set(HOMES) - {IMAGING}))
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Survey:
    write, *parts = SURVEYS[request.param]
    workflow = write(tmp_path_factory.mktemp(request.param))
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 0, ended.text
    return Survey(workflow, *parts)


def delivered(output: Path) -> dict[str, bytes]:
    """Content of everything that a user gets, but for what depends on times and folders."""
    report = {"report.html", "report.json", "log.jsonl", "delivered.json"}
    files = (p for p in output.rglob("*") if p.is_file() and p.name not in report)
    named = {p.relative_to(output).as_posix(): p for p in files}
    return {k: p.read_bytes() for k, p in sorted(named.items()) if not k.startswith("store/")}


def run_and_kill(workflow: Path, moment: str) -> None:
    """Run on a worker process until the whole process group is killed."""
    environment = {
        **os.environ,
        killed_worker.VARIABLE: f"{moment}:{workflow.parent / 'out'}",
        "DASK_DISTRIBUTED__WORKER__PRELOAD": json.dumps([killed_worker.__file__]),
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, "-m", "spl_batch", "run", str(workflow), "--workers", "1"]
    ended = subprocess.run(  # noqa: S603
        command, env=environment, start_new_session=True, capture_output=True, check=False
    )
    assert ended.returncode == -signal.SIGKILL, ended.stderr.decode()


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on_to_the_same_bytes(finished: Survey, tmp_path: Path) -> None:
    workflow = finished.copied(tmp_path / "killed")
    output = workflow.parent / "out"
    tasks = len(receipt_files(finished.output))
    assert tasks >= 10
    for where in finished.killed_at:
        count = tasks // 3 if where == "output" else 2 * tasks // 3
        run_and_kill(workflow, f"{where}:{count}")
        done = {path: path.read_bytes() for path in receipt_files(output)}
        assert len(done) >= count
        assert any(output.rglob("*.spl-part")) == (where == "output")
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 0, ended.text
    assert delivered(output) == delivered(finished.output)
    for path, content in done.items():
        assert path.read_bytes() == content, f"{path} was finished and is done again"
    performance = surveys.report(output)["performance"]
    assert sum(s["skipped"] for s in performance["stages"].values()) == len(done)
    assert sum(s["tasks"] for s in performance["stages"].values()) == tasks - len(done)
    assert not any(output.rglob("*.spl-part"))


def test_a_file_that_cannot_be_read_costs_itself_alone(finished: Survey, tmp_path: Path) -> None:
    workflow = finished.copied(tmp_path / "damaged")
    output = workflow.parent / "out"
    without = finished.copied(tmp_path / "without")
    for name in finished.lost:
        (without.parent / name).unlink()
    assert surveys.command("run", without, "--workers", 0).status == 0
    damaged = workflow.parent / finished.lost[0]
    content = damaged.read_bytes()
    damaged.write_bytes(content[: len(content) // 2])
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 1
    failures = surveys.report(output)["failures"]
    assert [Path(f["place"]).name for f in failures] == [damaged.name]
    assert failures[0]["reason"]
    assert damaged.name in ended.text
    assert delivered(output) == delivered(without.parent / "out")
    damaged.write_bytes(content)
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 0, ended.text
    assert delivered(output) == delivered(finished.output)
