"""Nothing that is not ours is deleted or replaced: outputs, stores, simulated folders."""

import json
import os
import shutil
from pathlib import Path

import fsspec
import pytest
from spl_batch.engine.store.output_owner import _head

from spl_batch import api
from spl_batch.airborne import quickstart
from spl_batch.airborne.tasks import time_domain
from spl_batch.engine.store.working_store import write_json
from spl_batch.engine.verbs import simulation
from spl_batch.errors import InputError, WorkflowError
from tests import surveys


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return make(tmp_path, 1, 2)


def make(folder: Path, *psids: int, prefix: str = "", output: str = "out") -> Path:
    for psid in psids:
        line = surveys.flightline(shots=40, psid=psid, seed=psid)
        surveys.write_cloud(folder / "lines" / f"{prefix}{psid}.laz", line)
    return surveys.write_workflow(folder, output=output)


def tree(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def command(verb: str, workflow: Path, *options: object) -> surveys.Ended:
    return surveys.command(verb, workflow, "--workers", 0, *options)


def refused(ended: surveys.Ended) -> str:
    assert ended.status == 2, ended.text
    # What takes long is told meanwhile.
    (line,) = [line for line in ended.err.splitlines() if not line.startswith("info: ")]
    return line


def test_another_survey_in_the_same_output_is_refused(survey: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    surveys.run(survey)
    # The same name, copied with the workflow, does not make it the same survey.
    other = make(tmp_path / "other", 3, output=str(out))
    before = tree(out)
    said = {refused(command(verb, other)) for verb in ("plan", "run")}
    said.add(refused(command("run", other, "--fresh")))
    said.add(refused(command("compare", other, "--methods", "aes,voxel")))
    said.add(refused(command("run", other, "--only", "index_file x")))
    (line,) = said
    for word in (str(out), "another survey", "1.laz", "name another output, or delete"):
        assert word in line
    assert tree(out) == before
    shutil.rmtree(out / "store")
    before = tree(out)
    assert refused(command("run", other, "--fresh")) == line
    (out / "delivered.json").unlink()
    # checkpoints may serve several surveys, even where they look like a flightline of this one
    report = json.loads((out / "report.json").read_bytes())
    size = (tmp_path / "other" / "lines" / "3.laz").stat().st_size
    report["provenance"]["inputs"].append({"path": "3.laz", "role": "checkpoints", "size": size})
    (out / "report.json").write_text(json.dumps(report))
    before = tree(out)
    assert "another survey" in refused(command("plan", other))
    (out / "report.json").unlink()
    assert "which no run" not in refused(command("plan", other))
    assert "no run has recorded" in refused(command("run", other))
    assert tree(out) == {k: v for k, v in before.items() if k in tree(out)}
    shutil.rmtree(out)
    assert command("plan", other).status == 0


def test_another_survey_that_has_delivered_nothing_yet_loses_nothing(
    survey: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert command("run", survey, "--until", "shuffle").status == 0
    before = tree(out / "store")
    other = make(tmp_path / "other", 3, output=str(out))
    said = {refused(command(verb, other)) for verb in ("plan", "run")}
    said.add(refused(command("run", other, "--fresh")))
    (line,) = said
    assert "holds the results of another survey" in line
    assert tree(out / "store") == before
    assert command("run", survey).status == 0, "the survey itself goes on"


def test_a_survey_that_was_moved_or_renamed_is_the_same(survey: Path, tmp_path: Path) -> None:
    surveys.run(survey)
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("lines", "out", survey.name):
        (tmp_path / name).rename(moved / name)
    again = surveys.run(moved / survey.name, "survey.name=renamed")
    assert again.exit_status == 0


def test_what_a_flightline_left_behind_is_listed_and_deleted(survey: Path, tmp_path: Path) -> None:
    laz = tmp_path / "out" / "laz" / "lines"
    surveys.run(survey)
    (laz / "mine.laz").write_text("mine")
    shutil.copy(laz / "2.laz", tmp_path / "2.laz")
    (tmp_path / "lines" / "2.laz").unlink()
    (note,) = surveys.found(api.plan(survey).findings, "E01", "gone")
    assert note.values["files"] == ["2.laz"]
    ended = command("run", survey)
    assert ended.status == 0
    flat = " ".join(ended.text.split())
    assert "no longer an input of this survey: 2.laz" in flat
    assert "deleted, as an earlier run made them and this one does not: laz/lines/2.laz" in flat
    assert "laz/lines/2.laz" in (tmp_path / "out" / "log.jsonl").read_text()
    assert sorted(path.name for path in laz.iterdir()) == ["1.laz", "mine.laz"]


def test_what_an_earlier_run_delivered_stays_where_tasks_fail(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, said = tmp_path / "out", "polygons that were damaged since the plan"
    surveys.run(survey)
    before = tree(out)
    rasters = {name for name in before if name.endswith(".tif") and "/" not in name}
    assert "dtm.tif" in rasters

    def broken(*_: object) -> None:
        raise InputError("area.gpkg", said)

    with monkeypatch.context() as patch:
        patch.setattr(time_domain, "_mark_places", broken)
        ended = command("run", survey, "--set", "tiling.tile_m=50")
    flat = " ".join(ended.text.split())
    assert ended.status == 1, flat
    assert said in flat
    assert "of an earlier run, kept as tasks of this one failed: " in flat
    assert "deleted" not in flat
    assert {name: (out / name).read_bytes() for name in rasters} == {
        name: before[name] for name in rasters
    }
    found = json.loads((out / "report.json").read_text(encoding="utf-8"))["findings"]
    assert "E02" in {one["code"] for one in found}
    record = json.loads((out / "delivered.json").read_text(encoding="utf-8"))
    assert rasters <= record["files"].keys(), "the next run may replace them"


def test_what_a_flightline_renames_is_told_in_one_line(tmp_path: Path) -> None:
    base = tmp_path / "work"
    base.mkdir()
    for folder, name in (("a", "1"), ("a", "2"), ("b", "3")):
        line = surveys.flightline(shots=30, psid=int(name), seed=int(name))
        surveys.write_cloud(tmp_path / folder / f"{name}.laz", line)
    survey = surveys.write_workflow(base, survey={"flightlines": ["../a/*.laz", "../b/*.laz"]})
    surveys.run(survey)
    ended = command("run", survey, "--set", "survey.flightlines=../a/*.laz")
    assert ended.status == 0, ended.text
    said = " ".join(ended.err.split())
    assert "laz/1.laz was laz/a/1.laz, laz/2.laz was laz/a/2.laz" in said
    assert (
        said.count("deleted, as an earlier run made them and this one does not: laz/b/3.laz") == 1
    )
    clouds = (base / "out/laz").rglob("*.laz")
    assert sorted(path.relative_to(base / "out").as_posix() for path in clouds) == [
        "laz/1.laz",
        "laz/2.laz",
    ]


def test_a_changed_result_is_never_lost(survey: Path, tmp_path: Path) -> None:
    laz = tmp_path / "out" / "laz" / "lines"
    surveys.run(survey)
    made = (laz / "1.laz").read_bytes()
    (laz / "1.laz").write_text("edited by hand")
    (laz / "2.laz").write_text("also edited")
    (tmp_path / "lines" / "2.laz").unlink()
    ended = command("run", survey)
    assert ended.status == 0
    assert (laz / "1.laz.kept").read_text() == "edited by hand"
    assert (laz / "2.laz").read_text() == "also edited"
    flat = " ".join(ended.text.split())
    assert "kept as laz/lines/1.laz.kept" in flat
    assert "laz/lines/2.laz; this run makes no such file" in flat
    assert (laz / "1.laz").stat().st_size > len(made) / 2
    # What lies where a new flightline's cloud goes is kept as well.
    shutil.copy(tmp_path / "lines" / "1.laz", tmp_path / "lines" / "3.laz")
    (laz / "3.laz").write_text("somebody's")
    command("run", survey)
    assert (laz / "3.laz.kept").read_text() == "somebody's"


def test_a_store_that_was_deleted_takes_no_knowledge_with_it(survey: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    surveys.run(survey)
    shutil.rmtree(out / "store")
    (tmp_path / "lines" / "2.laz").unlink()
    assert surveys.run(survey).exit_status == 0
    assert sorted(path.name for path in (out / "laz" / "lines").iterdir()) == ["1.laz"]
    assert not list(out.rglob("*.kept"))


def test_a_killed_run_finds_its_own_files_again(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from spl_batch.engine.tasks import runner  # noqa: PLC0415
    from spl_batch.engine.tasks.task import Receipt  # noqa: PLC0415

    real = runner.write_receipt

    def killed(store: object, receipt: Receipt) -> None:
        if receipt.kind == "mosaic":
            raise KeyboardInterrupt
        real(store, receipt)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(runner, "write_receipt", killed)
        with pytest.raises(KeyboardInterrupt):
            surveys.run(survey)
    out = tmp_path / "out"
    assert list(out.glob("*.tif")), "a raster is there, and no receipt"
    shutil.rmtree(out / "store")
    assert surveys.run(survey).exit_status == 0
    assert not list(out.rglob("*.kept"))


@pytest.mark.parametrize("name", ["laz/lines/1.laz", "dtm.tif", "report.html", "store/notes.txt"])
def test_files_of_somebody_else_are_refused(survey: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    said = {refused(command(verb, survey)) for verb in ("plan", "run")}
    said.add(refused(command("run", survey, "--fresh")))
    (line,) = said
    assert "move them away" in line
    assert tree(tmp_path / "out") == {name: b"mine"}


def test_a_folder_with_other_files_may_be_an_output(survey: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert command("run", survey, "--until", "index", "--fresh").status == 0
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_a_place_that_holds_other_objects_is_no_store(survey: Path) -> None:
    system = fsspec.filesystem("memory")
    system.pipe_file("/bucket/photos/a.jpg", b"mine")
    options = ("--set", "outputs.store=memory://bucket")
    try:
        said = {refused(command(verb, survey, *options)) for verb in ("plan", "run")}
        said.add(refused(command("run", survey, "--fresh", *options)))
        (line,) = said
        assert "holds photos, which is no working store" in line
        assert system.cat_file("/bucket/photos/a.jpg") == b"mine"
    finally:
        system.rm("/bucket", recursive=True)


def test_altimetry_refuses_a_folder_with_other_photons(tmp_path: Path) -> None:
    (tmp_path / "track.csv").write_text(
        "along_track,height\n" + "".join(f"{k},{k % 7}\n" for k in range(400))
    )
    workflow = tmp_path / "workflow.yaml"
    workflow.write_text("kind: altimetry\ntrack: {photons: track.csv}\noutput: out\n")
    path = tmp_path / "out" / "profiles" / "track" / "beam.csv"
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    said = {refused(command(verb, workflow)) for verb in ("plan", "run")}
    assert "profiles/track/beam.csv" in said.pop()
    assert not said


SCENE = """kind: altimetry
name: short
track: {length_m: 200}
channels: {channel006: {}}
"""


def test_a_simulation_replaces_only_what_one_has_made(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    out = tmp_path / "sim"
    assert surveys.command("simulate", scene, out).status == 0
    assert surveys.command("simulate", scene, out).status == 0
    other = tmp_path / "other"
    other.mkdir()
    (other / "workflow.yaml").write_text("mine")
    line = refused(surveys.command("simulate", scene, other))
    assert "workflow.yaml" in line
    assert tree(other) == {"workflow.yaml": b"mine"}


def test_quickstart_refuses_a_folder_with_anything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[Path] = []

    def run(workflow: Path, **_: object) -> None:
        ran.append(workflow)

    def fly(_: object, folder: Path, **__: object) -> None:
        (folder / "workflow.yaml").write_text("survey: {name: quickstart}\n")

    monkeypatch.setattr(quickstart, "run", run)
    monkeypatch.setattr(simulation, "simulator", lambda _: fly)
    theirs = tmp_path / "theirs"
    (theirs / "flightlines").mkdir(parents=True)
    (theirs / "flightlines" / "line_01.laz").write_text("mine")
    with pytest.raises(WorkflowError, match="flightlines"):
        api.quickstart(theirs)
    (theirs / "workflow.yaml").write_text("survey: {flightlines: flightlines/*.laz}\noutput: out\n")
    with pytest.raises(WorkflowError, match=r"workflow\.yaml"):
        api.quickstart(theirs)
    assert not ran
    own = tmp_path / "own"
    api.quickstart(own)
    write_json(own / "out" / "delivered.json", {})
    (own / "out" / "dtm.tif").touch()
    api.quickstart(own)
    assert ran == [own / "workflow.yaml"] * 2
    assert json.loads((own / "simulated.json").read_bytes())["quickstart"]


@pytest.mark.timeout(20)
def test_a_pipe_among_the_inputs_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.laz")
    assert _head(tmp_path / "pipe.laz") == _head(tmp_path / "missing.laz") == (-1, "")
    (tmp_path / "file.laz").write_bytes(b"LASF")
    assert _head(tmp_path / "file.laz")[0] == 4
