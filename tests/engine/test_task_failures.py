"""Whatever a task raises becomes its receipt; only a wish to stop and a full disk pass."""

import asyncio
import errno
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numba.core.errors import TypingError

from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.runner import run_task
from spl_batch.engine.tasks.step import Step, table
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.progress import failures
from spl_batch.errors import DamagedError, InputError, StoppedError, StoreError
from tests import surveys


class PanicException(BaseException):
    """What a panic in Rust raises."""


class ForeignError(BaseException):
    """What a library may derive from the class of wishes to stop."""


class SpeechlessError(Exception):
    """One that cannot name itself."""

    def __str__(self) -> str:
        """Fail."""
        raise ValueError


FAULTS: list[BaseException] = [
    ForeignError("a library's own"),
    asyncio.CancelledError(),
    SpeechlessError(),
    SystemExit(7),
    ValueError("negative dimensions are not allowed"),
    OverflowError("Python int too large to convert to C long"),
    np.exceptions.AxisError(3, 1),
    FloatingPointError("overflow"),
    TypingError("no implementation"),
    MemoryError(),
    RecursionError("maximum recursion depth exceeded"),
    pa.ArrowInvalid("a page is cut off"),
    PanicException("range end index 9 out of range for slice of length 3"),
    InputError("a.laz", "it is damaged"),
    DamagedError("store/a.parquet", "checksum"),
    StoreError("a receipt is gone"),
    OSError(errno.EIO, "input/output error"),
    KeyError("x" * 5000),
]


@pytest.fixture
def context(tmp_path: Path) -> RunContext[Any]:
    workflow = load_workflow(surveys.write_workflow(tmp_path))
    return RunContext(workflow, tmp_path, tmp_path / "out", "", "code")


def step(run: Any) -> Step:
    return Step(name="index_file", stage="index", run=run, tasks=lambda _: iter(()))


def ended(error: BaseException, context: RunContext[Any], monkeypatch: pytest.MonkeyPatch) -> Any:
    """A task whose function raises."""

    def raising(*_: object) -> None:
        raise error

    monkeypatch.setattr(runner, "steps", lambda _: table(step(raising)))
    return run_task(Task("index_file", "1", {}, ()), "key", context)


def test_freed_memory_is_given_back_before_a_task(
    context: RunContext[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    monkeypatch.setattr(runner, "give_back", lambda: done.append("given back"))
    work = step(lambda *_: done.append("task") or Produced())  # type: ignore[func-returns-value]
    monkeypatch.setattr(runner, "steps", lambda _: table(work))
    receipt = run_task(Task("index_file", "1", {}, ()), "key", context)
    assert not receipt.failed
    assert 0 <= receipt.wall_s < 60
    assert done == ["given back", "task"]


@pytest.mark.parametrize("error", FAULTS, ids=lambda error: type(error).__name__)
def test_a_fault_is_a_receipt(
    error: BaseException, context: RunContext[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    receipt = ended(error, context, monkeypatch)
    assert receipt.failed
    codes = {"InputError": "F01", "MemoryError": "F02", "DamagedError": "F03"}
    assert receipt.facts["code"] == codes.get(type(error).__name__, "F04")
    assert len(receipt.reason) < 300
    assert "\n" not in receipt.reason
    if not isinstance(error, InputError | StoreError):
        assert type(error).__name__ in receipt.reason
        assert "Traceback" in receipt.facts["traceback"]


def test_what_had_too_little_memory_names_what_makes_it_lighter() -> None:
    task = Task("ground", "0_0", {}, (("denoise", "0_1"),))
    receipt = Receipt("ground", "0_0", "", "", "OutOfMemory", {}, {"code": "F02"}, 0, 0.0, 0.0)
    inputs = SimpleNamespace(bad=(InputError("a.laz", "is cut off"),), sources=())
    prepared: Any = SimpleNamespace(ledger=SimpleNamespace(inputs=inputs), steps=STEPS)
    unreadable, heavy = failures(prepared, [(task, receipt)])
    assert (unreadable.code, unreadable.place, unreadable.stage) == ("F01", "a.laz", "index")
    assert (heavy.code, heavy.task, heavy.inputs) == ("F02", "ground 0_0", ("cell 0_1",))
    assert "ground.cell_m" in str(heavy.remedy)


def test_a_wish_to_stop_is_none(context: RunContext[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(KeyboardInterrupt):
        ended(KeyboardInterrupt(), context, monkeypatch)


def test_a_full_disk_concerns_everything(
    context: RunContext[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(StoppedError):
        ended(OSError(errno.ENOSPC, "no space left on device"), context, monkeypatch)


def test_a_failure_after_a_wish_to_stop_is_that_wish(
    context: RunContext[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = threading.Event()
    asked.set()
    monkeypatch.setattr(runner, "INTERRUPTED", asked)
    with pytest.raises(KeyboardInterrupt):
        ended(RuntimeError("no compiled object yet"), context, monkeypatch)
