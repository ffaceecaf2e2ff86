"""A command that was given the wrong file names it and what is wrong in one line."""

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
    (tmp_path / "blob").write_bytes(bytes(range(256)))
    return tmp_path


@pytest.mark.parametrize(
    ("command", "name", "what"),
    [
        ("run", "scene.yaml", "`spl-batch simulate` takes scenes"),
        ("simulate", "blob", "a binary file"),
        ("init", "s3://bucket", "this is a URL"),
        ("plan", "s3://bucket/w.yaml", "this is a URL"),
        ("status", "https://host/out", "this is a URL"),
        ("quickstart", "s3://bucket/q", "this is a URL"),
        ("run", "lines", "s a directory"),
        ("simulate", "workflow.yaml", "a workflow, not a scene"),
        ("status", "workflow.yaml", "takes the output folder"),
        ("report", "nowhere", "takes the output folder"),
        ("run", "nowhere.yaml", "nowhere.yaml"),
    ],
)
def test_one_line_names_what_it_is(folder: Path, command: str, name: str, what: str) -> None:
    options = [folder / "made"] if command == "simulate" else []
    ended = surveys.command(command, name if "://" in name else folder / name, *options)
    assert ended.status == 2
    assert what in ended.err.splitlines()[-1]
    assert not (folder / "made").exists()


def test_inputs_that_are_urls_are_named_as_they_were_given(folder: Path) -> None:
    given = {"survey.flightlines": "s3://b/*.laz", "water": "https://host/lakes.gpkg"}
    options = [word for key, name in given.items() for word in ("--set", f"{key}={name}")]
    ended = surveys.command("plan", folder / "workflow.yaml", *options)
    assert ended.status == 2
    for key, name in given.items():
        assert f"{key}: {name}: this is a URL" in ended.err


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


@pytest.mark.parametrize("output", ["workflow.yaml", "workflow.yaml/deep"])
def test_a_plan_refuses_an_output_that_a_run_refuses(tmp_path: Path, output: str) -> None:
    surveys.write_cloud(tmp_path / "lines/1.laz", surveys.flightline(shots=20))
    workflow = surveys.write_workflow(tmp_path)
    for verb in ("plan", "run"):
        ended = surveys.command(verb, workflow, "--workers", 0, "--set", f"output={output}")
        assert ended.status == 2


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
