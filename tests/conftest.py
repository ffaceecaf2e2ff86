"""Surveys that many tests share; nobody may write into them."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from spl_batch.simulate import preset_scene, simulate
from tests import surveys


@pytest.fixture(scope="session", autouse=True)
def _no_waiting_for_the_disk() -> Iterator[None]:
    """No test cuts the power, and a busy disk takes its time over each file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def tiny_survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of the packaged scene that has one of everything: 86 000 points on 60 m."""
    return simulate(preset_scene("tiny"), tmp_path_factory.mktemp("tiny")).workflow


@pytest.fixture(scope="session")
def tiny_output(tiny_survey: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a complete run of the tiny survey, with diagnostics."""
    folder = tmp_path_factory.mktemp("tiny_run")
    workflow = surveys.copy_of(tiny_survey, folder)
    result = surveys.run(workflow, "outputs.diagnostics=true")
    assert result.exit_status == 0
    return result.output


@pytest.fixture(scope="session")
def small_lines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of two short passes without a trajectory: 6 000 points."""
    return surveys.small_survey(tmp_path_factory.mktemp("small"))
