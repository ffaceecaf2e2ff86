"""Surveys that many tests share; nobody may write into them."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from spl_batch.airborne.report import summarise
from spl_batch.airborne.report.pictures import PICTURES
from spl_batch.airborne.simulate import preset_scene, simulate
from spl_batch.engine.report import style
from spl_batch.engine.report.picture import Picture
from tests import surveys
from tests.report_data import drawn_png, empty_pictures

# A machine that does other work as well is slow to draw examples, whatever the code.
settings.register_profile("busy", suppress_health_check=[HealthCheck.too_slow], deadline=None)
settings.load_profile("busy")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put one file that runs whole surveys first, and others after those that run none.

    What the first compiles, in one process, the others then load; the second process would
    compile the same at the same time.
    """
    weights: dict[Path, int] = {}
    for item in items:
        slow = item.get_closest_marker("slow") is not None
        weights[item.path] = weights.get(item.path, 0) + (20 if slow else 1)

    def turn(item: pytest.Item) -> tuple[int, int, str]:
        flies = isinstance(item, pytest.Function) and hasattr(item.module, "surveys")
        first = item.path.name == "test_run.py"
        return (0 if first else 1 + flies, -weights[item.path], str(item.path))

    items.sort(key=turn)


@pytest.fixture(scope="session", autouse=True)
def _no_waiting_for_the_disk() -> Iterator[None]:
    """No test cuts the power, and a busy disk takes its time over each file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _pictures_not_drawn() -> Iterator[None]:
    """Deliver empty pictures of the right size: drawing takes a third of a small run."""
    with empty_pictures():
        yield


@pytest.fixture(autouse=True)
def _pictures_where_they_are_looked_at(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draw pictures in tests that are marked so, and not even prepare maps in the others."""
    if request.node.get_closest_marker("pictures") is not None:
        monkeypatch.setattr(style, "to_png", drawn_png)
    else:
        none = {name: Picture(name, "Not drawn in this test.") for name in PICTURES}
        monkeypatch.setattr(summarise, "make_pictures", lambda *_: none)


@pytest.fixture(scope="session")
def tiny_survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of the packaged scene that has one of everything: 86 000 points on 60 m."""
    scene = preset_scene("tiny")
    return (
        surveys.made_once(tmp_path_factory, "tiny", lambda at: simulate(scene, at))
        / "workflow.yaml"
    )


@pytest.fixture(scope="session")
def tiny_output(tiny_survey: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a complete run of the tiny survey, with diagnostics."""

    def make(folder: Path) -> None:
        workflow = surveys.copy_of(tiny_survey, folder)
        result = surveys.run(workflow, "outputs.diagnostics=true")
        assert (result.exit_status, result.output) == (0, folder / "out")

    return surveys.made_once(tmp_path_factory, "tiny_run", make) / "out"


@pytest.fixture(scope="session")
def small_lines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of two short passes without a trajectory: 6 000 points."""
    return surveys.made_once(tmp_path_factory, "small", surveys.small_survey) / "workflow.yaml"


@pytest.fixture(scope="session")
def small_output(small_lines: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a complete run of the small survey."""

    def make(folder: Path) -> None:
        result = surveys.run(surveys.copy_of(small_lines, folder))
        assert (result.exit_status, result.output) == (0, folder / "out")

    return surveys.made_once(tmp_path_factory, "small_run", make) / "out"


@pytest.fixture
def small(small_lines: Path, tmp_path: Path) -> Path:
    """The small survey, in a folder of the test's own."""
    return surveys.copy_of(small_lines, tmp_path)
