"""The files and commands that people are shown are those that the program takes."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

from spl_batch import api
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.simulate.scene import scene_file
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.engine.settings.workflow_file import parse_any
from spl_batch.engine.tasks.step import stages
from spl_batch.errors import WorkflowError
from spl_batch.geiger.coincidence.simulate import SceneSettings
from spl_batch.geiger.water.simulate import WaterScene
from tests.workflow_files import blocks, differing, unshown

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "workflows").glob("*.yaml"))
WORKFLOWS = [path for path in FILES if not path.name.endswith("scene.yaml")]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]

MAIN_JOB = "pip install . && spl-batch quickstart"
TESTS = "pip install '.[test]' && python -m pytest"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflow_files_are_accepted(path: Path) -> None:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    workflow = parse_any(content, path.name)
    assert set(content) <= set(type(workflow).model_fields)
    assert workflow.output


def test_the_scene_file_names_every_key_and_what_is_commented_out_is_accepted_too() -> None:
    text = (ROOT / "workflows" / "scene.yaml").read_text(encoding="utf-8")
    parts = [
        part
        for part in vars(scene_file).values()
        if isinstance(part, type) and issubclass(part, BaseModel)
    ]
    own = [part for part in parts if part.__module__ == scene_file.__name__]
    keys = {key for part in own for key in part.model_fields}
    assert [key for key in keys - {"items"} if not re.search(rf"\b{key}\b", text)] == []
    whole = re.sub(r"^( *)# ([a-z_]+: )", r"\1\2", text, flags=re.MULTILINE)
    scene = parse_scene(yaml.safe_load(whole), "scene.yaml")
    assert (scene.sky.haze[0].times_noise, scene.sky.fog[0].scale_m) == (20.0, 1.5)


LINES = ("survey.flightlines", "survey.trajectory", "survey.channel_dimension", "reference.points")
TRACK = {"kind": "altimetry", "track": {"photons": "photons/*.h5"}, "reference": {}}
FRAMES = ("survey.frames", "survey.detections")
COMPLETE = {
    "spl100.yaml": (
        {"survey": {"flightlines": "x"}, "reference": {"points": "x"}},
        {"survey.name", *LINES},
    ),
    "altimetry.yaml": (TRACK, set()),
    "coincidence.yaml": (
        {"kind": "coincidence", "survey": {"frames": "f", "detections": "d"}},
        {"survey.name", "survey.crs", *FRAMES},
    ),
    "water_surface.yaml": (
        {"kind": "water_surface", "survey": {"frames": "x"}},
        {"survey.name", "survey.frames", "calibration.frames"},
    ),
}
"""What a workflow cannot do without, and what the complete file shows an example of."""


@pytest.mark.parametrize("name", COMPLETE)
def test_a_complete_workflow_names_every_key_with_its_default(name: str) -> None:
    needed, examples = COMPLETE[name]
    text = (ROOT / "workflows" / name).read_text(encoding="utf-8")
    bare = parse_any({"output": "out", **needed}, "bare")
    assert unshown(text, type(bare)) == []
    assert set(differing(yaml.safe_load(text), bare.model_dump(mode="json"))) == examples


def test_the_scene_file_of_coincidence_shows_every_key_with_its_default() -> None:
    text = (ROOT / "workflows" / "coincidence_scene.yaml").read_text(encoding="utf-8")
    assert unshown(text, SceneSettings) == []
    assert differing(yaml.safe_load(text), SceneSettings().model_dump(mode="json")) == []


def test_the_scene_file_of_water_is_accepted() -> None:
    text = (ROOT / "workflows" / "water_scene.yaml").read_text(encoding="utf-8")
    assert len(WaterScene.model_validate(yaml.safe_load(text)).target.waves) == 2


@pytest.mark.parametrize(
    ("scene", "missing"),
    [
        ({"kind": "altimetry", "track": {"lenght_m": 5}}, "length_m"),
        ({"kind": "water_surface", "target": {"waves": []}}, r"target\.down_m"),
    ],
)
def test_a_scene_with_a_key_too_many_or_too_few_is_refused(
    tmp_path: Path, scene: dict[str, Any], missing: str
) -> None:
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    with pytest.raises(WorkflowError, match=missing):
        api.simulate(tmp_path / "scene.yaml", tmp_path / "out")


def test_the_readme_opens_with_the_two_commands() -> None:
    commands = blocks(ROOT / "README.md", "sh")
    assert [block.strip() for block in commands[:2]] == [MAIN_JOB, TESTS]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_workflows_on_pages_are_accepted(page: Path) -> None:
    """A block that starts a survey is a whole file; any other is put into one."""
    for block in blocks(page, "yaml"):
        content = yaml.safe_load(block)
        if "kind" in content:
            parse_any(content, page.name)
            continue
        whole = {"survey": {"flightlines": "x"}, "output": "out"} | content
        whole["survey"] = {"flightlines": "x"} | whole["survey"]
        parse_workflow(whole, page.name)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    targets = [t for t in re.findall(r"\]\(([^)#]+)", text) if not t.startswith("http")]
    assert [t for t in targets if not (page.parent / t).exists()] == []


def test_every_stage_is_explained() -> None:
    using = (ROOT / "docs" / "using.md").read_text(encoding="utf-8")
    assert [stage for stage in stages("imaging") if f"| `{stage}` |" not in using] == []


def test_people_and_ci_use_the_same_commands() -> None:
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    make = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in (
        "ruff format --check .",
        "ruff check .",
        "mypy",
        "python -m spl_batch.engine.report.schema --check",
        "python -m pytest",
        "spl-batch quickstart",
    ):
        line = rf"(^|\s|&& )\(?{re.escape(command)}($|\s|\))"
        for name, text in {".ci/run": ci, "CONTRIBUTING.md": guide, "Makefile": make}.items():
            assert re.search(line, text, re.MULTILINE), f"{command!r} is not in {name}"
