"""A command that was given the wrong file says what it is and which command takes it."""

import struct
import subprocess
import sys
from pathlib import Path

import pytest

from tests import surveys

SCENE = "name: s\nextent_m: [50, 50]\nflights:\n  - {heading_deg: 0}\n"
WORKFLOW = "survey:\n  flightlines: lines/*.laz\noutput: results\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "workflow.yaml").write_text(WORKFLOW)
    (tmp_path / "lines").mkdir()
    (tmp_path / "lines" / "x.laz").write_bytes(b"LASF" + struct.pack("<40I", *range(40)))
    (tmp_path / "blob").write_bytes(bytes(range(256)))
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "report.json").write_text('{"survey": {"flightlines": 3}}')
    for raster in ("results/dtm.tif", "dem.tif"):
        (tmp_path / raster).write_bytes(b"II*\0....")
    (tmp_path / "more.zip").write_bytes(b"PK\x03\x04....")
    return tmp_path


@pytest.mark.parametrize(
    ("command", "name", "what", "remedy"),
    [
        ("run", "scene.yaml", "a scene, not a workflow", "`spl-batch simulate` takes it"),
        ("plan", "scene.yaml", "a scene, not a workflow", "`spl-batch simulate` takes it"),
        ("compare", "scene.yaml", "a scene, not a workflow", "`spl-batch simulate` takes it"),
        ("run", "lines/x.laz", "a point file", "name it in a workflow file"),
        ("plan", "lines/x.laz", "a point file", "name it in a workflow file"),
        ("simulate", "lines/x.laz", "a point file", "name it in a workflow file"),
        ("run", "blob", "a binary file", "name it in a workflow file"),
        ("run", "results/dtm.tif", "a TIFF raster of a run's results", "the folder that it lies"),
        ("run", "dem.tif", "a TIFF raster", "no command reads rasters"),
        ("plan", "more.zip", "a ZIP archive", "unpack it"),
        ("init", "lines/x.laz", "one file", "`spl-batch init {}/lines`"),
        ("run", "s3://bucket/w.yaml", "this is a URL", "of this machine"),
        ("init", "s3://bucket", "this is a URL", "of this machine"),
        ("status", "https://host/out", "this is a URL", "of this machine"),
        ("quickstart", "s3://bucket/q", "this is a URL", "of this machine"),
        ("run", "results/report.json", "of a run's results", "take the folder that it lies in"),
        ("run", ".", "a folder", "such as workflow.yaml"),
        ("run", "lines", "a folder of point files", "survey.flightlines"),
        ("plan", "results", "output folder of a run", "`spl-batch status`"),
        ("simulate", "workflow.yaml", "a workflow, not a scene", "`spl-batch run`"),
        ("status", "workflow.yaml", "a workflow", "here {}/results"),
        ("report", "workflow.yaml", "a workflow", "here {}/results"),
        ("status", "scene.yaml", "a scene", "takes the output folder"),
        ("status", "lines/x.laz", "a point file", "takes the output folder"),
        ("status", "results/report.json", "of a run's results", "here {}/results"),
        ("status", "lines", "no run has worked here", "takes the output folder"),
        ("report", "lines", "no run has worked here", "takes the output folder"),
        ("status", ".", "no run has worked here", "try {}/results"),
        ("report", "nowhere", "no such folder", "takes the output folder"),
    ],
)
def test_one_line_says_what_it_is(
    folder: Path, command: str, name: str, what: str, remedy: str
) -> None:
    options: list[object] = ["--methods", "aes,voxel"] if command == "compare" else []
    if command == "simulate":
        options = [folder / "made"]
    ended = surveys.command(command, name if "://" in name else folder / name, *options)
    assert ended.status == 2
    *slow, line = ended.err.splitlines()
    assert all(one.startswith(("info: ", "getting ready")) for one in slow), slow
    assert len(line.replace(str(folder), "")) < 300
    assert what in line
    assert remedy.format(folder) in line
    assert not (folder / "made").exists()


def test_a_missing_workflow_is_told_before_anything_is_loaded(folder: Path) -> None:
    code = "import sys; from spl_batch.cli import main\ntry: main(sys.argv[1:])\nfinally: "
    code += "print('loaded' if {'pyarrow', 'numba', 'yaml'} & set(sys.modules) else 'at once')"
    said = subprocess.run(  # noqa: S603 - what stands here
        [sys.executable, "-c", code, "run", folder / "workflw.yaml"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert said.stdout == "at once\n"
    assert said.returncode == 2
    near = "there is workflow.yaml"
    assert said.stderr == f"spl-batch: {folder / 'workflw.yaml'}: no such file; {near}\n"
    ended = surveys.command("plan", folder / "lines" / "no.yaml")
    assert ended.err.endswith("no such file; check the path\n")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("mkdocs.yml", "site_name: s\nnav: []\n", "check the path"),
        ("scene.yaml", SCENE, "check the path"),
        ("county.yml", "name: c\n" + WORKFLOW, "there is county.yml"),
        ("track.yaml", "track: {photons: a.h5}\noutput: out\n", "there is track.yaml"),
        ("my_workflow.yaml", "survey: [", "there is my_workflow.yaml"),
    ],
)
def test_only_workflows_are_proposed(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    (tmp_path / "folder.yaml").mkdir()
    ended = surveys.command("plan", tmp_path / "no.yaml")
    assert ended.err == f"spl-batch: {tmp_path / 'no.yaml'}: no such file; {said}\n"


def test_a_folder_of_other_yaml_names_none(tmp_path: Path) -> None:
    (tmp_path / "mkdocs.yml").write_text("site_name: s\n")
    ended = surveys.command("plan", tmp_path)
    assert ended.err.endswith("this is a folder; `spl-batch run` takes a workflow file\n")
    (tmp_path / "scene.yaml").write_text(SCENE)
    ended = surveys.command("simulate", tmp_path, tmp_path / "made")
    assert ended.err.endswith("such as scene.yaml\n")


def test_inputs_that_are_urls_are_named_as_they_were_given(folder: Path) -> None:
    given = {"survey.flightlines": "s3://b/*.laz", "survey.trajectory": "s3://b/t.csv",
             "water": "https://host/lakes.gpkg",
             "reference.checkpoints": "s3://b/points.csv"}  # fmt: skip
    options = [word for key, name in given.items() for word in ("--set", f"{key}={name}")]
    ended = surveys.command("plan", folder / "workflow.yaml", *options)
    assert ended.status == 2
    for key, name in given.items():
        assert f"{key}: {name}: this is a URL" in ended.err


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("4", "that is 4 bytes, a worker needs 256 MiB at least; write 4GiB"),
        ("512", "that is 512 bytes, a worker needs 256 MiB at least; write 512MiB"),
        ("4k", "that is 4 000 bytes, a worker needs 256 MiB at least"),
    ],
)
def test_memory_without_a_unit_is_bytes(folder: Path, given: str, words: str) -> None:
    for verb in ("plan", "run"):
        ended = surveys.command(verb, folder / "workflow.yaml", "--memory", given)
        assert ended.status == 2
        assert ended.err == f"spl-batch: --memory {given}: {words}\n"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--memory", "4"], "that is 4 bytes"),
        (["--memory", "300MiB"], "a ground cell of the quickstart needs 767 MiB"),
        (["--workers", "-1"], "--workers -1: write 0"),
    ],
)
def test_a_quickstart_that_cannot_run_simulates_nothing(
    tmp_path: Path, options: list[str], words: str
) -> None:
    ended = surveys.command("quickstart", tmp_path / "new", *options)
    assert ended.status == 2
    assert words in ended.err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("output", ["/proc/x/out", "workflow.yaml", "workflow.yaml/deep"])
def test_a_plan_refuses_an_output_that_a_run_refuses(tmp_path: Path, output: str) -> None:
    surveys.write_cloud(tmp_path / "lines/1.laz", surveys.flightline(shots=20))
    workflow = surveys.write_workflow(tmp_path)
    said = [
        surveys.command(verb, workflow, "--workers", 0, "--set", f"output={output}")
        for verb in ("plan", "run")
    ]
    assert [ended.status for ended in said] == [2, 2]
    # A slow machine says first what it is at.
    plain, started = (ended.err.partition("spl-batch: ")[2] for ended in said)
    assert plain == started
    assert "cannot be written" in said[0].err


def test_a_fault_of_several_references_is_listed_once(tmp_path: Path) -> None:
    surveys.write_cloud(tmp_path / "lines/1.laz", surveys.flightline(shots=20))
    for k in range(3):
        surveys.write_cloud(
            tmp_path / f"reference/{k}.laz", surveys.flightline(shots=20), crs="EPSG:25833"
        )
    workflow = surveys.write_workflow(tmp_path, reference={"points": "reference/*.laz"})
    ended = surveys.command("plan", workflow)
    assert ended.status == 2
    assert ended.err.count("is not the survey's") == 1
    assert "3 files: " in ended.err
