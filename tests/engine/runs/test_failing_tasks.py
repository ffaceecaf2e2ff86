"""Thirteen kinds of exception in as many places of a run: each is the failure of its place alone.

But for the trajectory, on which all of a run rests: that ends it, in one line.
"""

import dataclasses
import errno
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numba.core.errors import TypingError

from spl_batch.airborne import steps
from spl_batch.engine.tasks.context import Produced
from tests import surveys
from tests.faulty_worker import place


class PanicException(BaseException):
    """What a panic in Rust raises."""


FAULTS: dict[str, BaseException] = {
    "trajectory_file": struct.error("unpack requires a buffer of 8 bytes"),
    "index_file": PanicException("range end index 9 out of range for slice of length 3"),
    "trajectory": pa.ArrowInvalid("a page is cut off"),
    "gather": OverflowError("Python int too large to convert to C long"),
    "fit_line": np.linalg.LinAlgError("Singular matrix"),
    "scatter": OSError(errno.EIO, "input/output error"),
    "build_tile": MemoryError(),
    "denoise": TypingError("no implementation"),
    "ground": FloatingPointError("overflow"),
    "surface": RecursionError("maximum recursion depth exceeded"),
    "deliver_file": UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    "deliver_tile": ValueError("negative dimensions are not allowed"),
    "mosaic": KeyError("dtm\x1b[31m" * 200),
}
"""What a task of each kind raises."""


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("failing")
    for k in (1, 2):
        line = surveys.flightline(shots=25, psid=k, start_s=surveys.START_S + 3 * k, seed=k)
        surveys.write_cloud(folder / "lines" / f"{k}.laz", line)
    surveys.write_trajectory(folder / "trajectory.csv")
    workflow = surveys.write_workflow(folder, outputs={"tiles": "laz"})
    assert surveys.command("run", workflow, "--workers", 0).status == 0
    return workflow


@pytest.mark.slow
def test_an_exception_is_the_failure_of_its_place(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in FAULTS:
        # Each run mends what failed in the one before.
        with monkeypatch.context() as patch:
            failing(survey, kind, patch)
    again = surveys.command("run", survey, "--workers", 0)
    assert again.status == 0, again.text


def failing(survey: Path, kind: str, patch: pytest.MonkeyPatch) -> None:
    """Run while one task of a kind fails."""
    function, met = steps.STEPS[kind].loaded(), []

    def raising(args: Mapping[str, Any], context: Any) -> Produced:
        name = place(args)
        if not met or met[0] == name:
            met[:] = [name]
            raise FAULTS[kind]
        return function(args, context)

    faulty = {**steps.STEPS, kind: dataclasses.replace(steps.STEPS[kind], run=raising)}
    patch.setattr(steps, "STEPS", faulty)
    # Whatever rests on tasks of this kind is done already, and waits for them all the same.
    for receipt in (survey.parent / "out/store/receipts" / kind).rglob("*.json"):
        receipt.unlink()
    ended = surveys.command("run", survey, "--workers", 0)
    assert met, f"{kind}: a task of this kind was done"
    assert max(map(len, ended.text.splitlines())) <= 300
    if kind in {"trajectory_file", "trajectory"}:  # there is one, and the run rests on it
        assert ended.status == 2
        said = f"spl-batch: survey.trajectory: {type(FAULTS[kind]).__name__}: "
        assert ended.err.splitlines()[-1].startswith(said)
        return
    assert ended.status == 1, ended.text
    report = json.loads((survey.parent / "out/report.json").read_text(encoding="utf-8"))
    reasons = [failure["reason"] for failure in report["failures"]]
    assert any(type(FAULTS[kind]).__name__ in reason for reason in reasons), reasons
    assert all(len(reason) < 300 and reason.isprintable() for reason in reasons)
    mended = {type(fault).__name__ for other, fault in FAULTS.items() if other != kind}
    assert not any(reason.split(":")[0] in mended for reason in reasons), reasons
