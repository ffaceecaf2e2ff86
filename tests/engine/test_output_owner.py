"""Nothing that is not ours is deleted or replaced: outputs, stores, simulated folders."""

import os
from pathlib import Path

import pytest

from spl_batch import api
from spl_batch.engine.store.working_store import write_json, write_receipt
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs import simulation
from spl_batch.engine.verbs.output_owner import Deliveries, usable
from spl_batch.engine.verbs.planning import prepare
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import checksum, size
from tests import surveys


def make(folder: Path, *psids: int, output: str = "out") -> Path:
    for psid in psids:
        line = surveys.flightline(shots=10 + psid, psid=psid, seed=psid)
        surveys.write_cloud(folder / "lines" / f"{psid}.laz", line)
    return surveys.write_workflow(folder, output=output)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return make(tmp_path, 1, 2)


def prepared(workflow: Path) -> Prepared:
    return prepare(workflow, ())


def begun(workflow: Path) -> tuple[Prepared, Deliveries]:
    """A survey whose first run has delivered a cloud and a raster, and was then killed."""
    run = prepared(workflow)
    deliveries = usable(run)
    deliveries.begin()
    for kind, name in (("deliver_file", "laz/1.laz"), ("mosaic", "dtm.tif")):
        path = run.context.output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
        stamp = {name: path.stat().st_mtime_ns}
        receipt = Receipt(
            kind, Path(name).stem, "", "", "", {name: checksum(path)}, {}, 1, 0.0, 0.0,
            {name: size(path)}, stamp,
        )  # fmt: skip
        write_receipt(run.context.store, receipt)
        run.ledger.of(kind).put(receipt)
        deliveries.wrote(receipt)
    deliveries.save()
    return run, deliveries


def test_another_survey_in_the_same_output_is_refused(survey: Path, tmp_path: Path) -> None:
    begun(survey)
    other = make(tmp_path / "other", 3, output=str(tmp_path / "out"))
    for verb in (api.plan, api.run):
        with pytest.raises(WorkflowError, match="another survey"):
            verb(other, workers=0)
    assert (tmp_path / "out/dtm.tif").exists()
    usable(prepared(survey))


def test_a_survey_that_was_moved_is_the_same(survey: Path, tmp_path: Path) -> None:
    begun(survey)
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("lines", "out", survey.name):
        (tmp_path / name).rename(moved / name)
    usable(prepared(moved / survey.name))


def test_what_a_run_does_not_make_is_deleted_if_it_is_as_written(
    survey: Path, tmp_path: Path
) -> None:
    run, deliveries = begun(survey)
    out, mine = tmp_path / "out", tmp_path / "out/laz/mine.laz"
    mine.write_bytes(b"mine")
    run.ledger.done.pop("mosaic")
    assert list(deliveries.withdraw(failed=True)) == []
    assert deliveries.spared == ["dtm.tif"]
    (out / "dtm.tif").write_bytes(b"changed")
    assert list(deliveries.withdraw(failed=False)) == []
    run, deliveries = begun(survey)
    run.ledger.done.pop("mosaic")
    os.utime(out / "dtm.tif", (0, 0))  # another time, but the same bytes
    (text,) = deliveries.withdraw(failed=False)
    assert "dtm.tif" in text
    assert not (out / "dtm.tif").exists()
    assert (out / "laz/1.laz").exists()
    assert mine.exists()


def test_folders_that_hold_nothing_any_more_are_removed(survey: Path, tmp_path: Path) -> None:
    run, deliveries = begun(survey)
    run.ledger.done.pop("deliver_file")
    assert list(deliveries.withdraw(failed=False))
    assert not (tmp_path / "out/laz").exists()
    assert (tmp_path / "out/dtm.tif").exists()


def test_a_record_that_is_gone_is_made_of_receipts(survey: Path, tmp_path: Path) -> None:
    run, deliveries = begun(survey)
    (tmp_path / "out/delivered.json").write_text("{}")
    assert Deliveries(run).files == deliveries.files


def test_inputs_that_are_gone_are_named(survey: Path, tmp_path: Path) -> None:
    begun(survey)
    assert not [*usable(prepared(survey)).gone_inputs()]
    (tmp_path / "lines/2.laz").unlink()
    (found,) = usable(prepared(survey)).gone_inputs()
    assert found.values == {"kind": "gone", "files": ["2.laz"]}


@pytest.mark.parametrize("name", ["laz/lines/1.laz", "dtm.tif", "report.html"])
def test_files_of_somebody_else_are_refused(survey: Path, tmp_path: Path, name: str) -> None:
    file = tmp_path / "out" / name
    file.parent.mkdir(parents=True)
    file.write_bytes(b"somebody's")
    (tmp_path / "out/notes.txt").write_bytes(b"no result's name")
    with pytest.raises(WorkflowError, match=name):
        api.run(survey, workers=0)
    file.unlink()
    usable(prepared(survey))


def test_a_simulation_replaces_only_what_one_has_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Path] = []
    monkeypatch.setattr(simulation, "simulator", lambda _: lambda _, out, **__: made.append(out))
    scene, folder = tmp_path / "scene.yaml", tmp_path / "made"
    scene.write_text("{extent_m: [1, 1], flights: []}")
    for _ in range(2):
        simulation.simulate(scene, folder)
        (folder / "workflow.yaml").write_text("{}")
    (tmp_path / "other").mkdir()
    write_json(tmp_path / "other" / "mine.json", {})
    with pytest.raises(WorkflowError, match=r"mine\.json"):
        simulation.simulate(scene, tmp_path / "other")
    assert made == [folder, folder]
