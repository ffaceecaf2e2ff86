"""The same bytes, whatever a run is like.

``python -m benchmarks.engine.equivalence`` is the longer script.
"""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from spl_batch.airborne.plan import flightlines
from spl_batch.engine.verbs.graph import Worklist
from tests import surveys
from tests.killed_worker import receipt_files

Way = Callable[[Path, pytest.FixtureRequest], None]


def here(*overrides: str, **options: Any) -> Way:
    """Run in this process."""

    def way(workflow: Path, _: pytest.FixtureRequest) -> None:
        result = surveys.run(workflow, *overrides, until="deliver", **options)
        assert result.exit_status == 0

    return way


def stretches(points: int, *overrides: str) -> Way:
    """Run with stretches of so many points."""

    def way(workflow: Path, request: pytest.FixtureRequest) -> None:
        patch: pytest.MonkeyPatch = request.getfixturevalue("monkeypatch")
        patch.setattr(flightlines, "STRETCH_POINTS", points)
        here(*overrides)(workflow, request)
        observed = workflow.parent / "out/store/receipts/observe"
        assert len(list(observed.iterdir())) > 4

    return way


def shuffled(workflow: Path, request: pytest.FixtureRequest) -> None:
    """Do the tasks of each step, of blocks of a tile each, in another order."""
    in_order = Worklist.tasks

    def mixed(self: Worklist) -> Iterator[Any]:
        found = list(in_order(self))
        random.Random(3).shuffle(found)  # noqa: S311 - an order, no secret
        yield from found

    request.getfixturevalue("monkeypatch").setattr(Worklist, "tasks", mixed)
    here("tiling.tile_m=60", "tiling.block_tiles=1")(workflow, request)


def killed(after: int) -> Way:
    """End the process group of a run with SIGKILL once so much is finished; then continue."""

    def way(workflow: Path, request: pytest.FixtureRequest) -> None:
        output = workflow.parent / "out"
        command = [
            *(sys.executable, "-m", "spl_batch", "run", str(workflow)),
            *("--workers", "1", "--until", "deliver"),
        ]
        process = subprocess.Popen(  # noqa: S603
            command,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + 150
        while len(receipt_files(output)) < after and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        before = {path: path.read_bytes() for path in receipt_files(output)}
        assert len(before) >= after
        here()(workflow, request)
        kept = sum(path.exists() and path.read_bytes() == before[path] for path in before)
        assert kept >= after, "what was finished is not done again"

    return way


TILES = stretches(5000, "tiling.tile_m=33.3", "tiling.block_tiles=2")


def same_as(output: Path, expected: Path) -> None:
    surveys.assert_same_labels(surveys.labels(output), surveys.labels(expected))
    assert surveys.results(output) == surveys.results(expected)


@pytest.mark.parametrize(
    ("survey", "way"),
    [
        pytest.param("tiny", shuffled, id="tiles of 60 m, shuffled task order"),
        pytest.param("tiny", here("tiling.tile_m=250", "tiling.block_tiles=1"), id="large tiles"),
        pytest.param("tiny", TILES, id="tiles of 33.3 m, blocks of 2 x 2, stretches of 5000"),
        pytest.param("small", killed(5), id="killed after 5 tasks", marks=pytest.mark.slow),
    ],
)
def test_labels_and_rasters_are_the_same_bytes(
    survey: str, way: Way, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    inputs = {"tiny": "tiny_survey", "small": "small_lines"}[survey]
    workflow = surveys.copy_of(request.getfixturevalue(inputs), tmp_path)
    if survey == "tiny":
        workflow.write_text(workflow.read_text() + "outputs: {diagnostics: true}\n")
    way(workflow, request)
    same_as(tmp_path / "out", request.getfixturevalue(f"{survey}_output"))
