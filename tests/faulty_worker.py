"""Preloaded by workers of tests: tasks misbehave as a plan file states.

The plan is a list of faults, each with the kind of task, the name of its cell (or none for
any), what happens (raise, kill, eat, wait) and how often. Each worker notes what it was
given to do in a file beside the plan.
"""

import dataclasses
import json
import os
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spl_batch.airborne import steps
from spl_batch.airborne.context import Context
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.step import Step

VARIABLE = "SPL_BATCH_TEST_FAULTS"
"""Environment variable that names the plan file."""

EAT_BYTES = 4 << 30
PIECE_BYTES = 32 << 20


def dask_setup(_worker: object) -> None:
    """Put the faults around every kind of task."""
    plan = Path(os.environ[VARIABLE])
    steps.STEPS = {  # type: ignore[misc]
        name: dataclasses.replace(step, run=_faulty(step, plan))
        for name, step in steps.STEPS.items()
    }


def name_of(args: Mapping[str, Any]) -> str:
    """Name of the task, as its arguments have it."""
    keys = ("block", "cell", "tile", "stretch", "source", "name", "line")
    return next((str(args[key]) for key in keys if key in args), "")


def _faulty(step: Step, plan: Path) -> Callable[[Mapping[str, Any], Context], Produced]:
    def perhaps(args: Mapping[str, Any], context: Context) -> Produced:
        name = name_of(args)
        with (plan.parent / "tries.jsonl").open("a") as stream:
            stream.write(json.dumps({"kind": step.name, "name": name, "pid": os.getpid()}) + "\n")
        for number, fault in enumerate(json.loads(plan.read_text())):
            if fault["kind"] == step.name and fault["name"] in {None, name}:
                _misbehave(fault, plan.parent / f"fault_{number}")
        return step.loaded()(args, context)

    perhaps.__module__ = step.modules[0]  # by which the code of tasks is known
    return perhaps


def _misbehave(fault: Mapping[str, Any], tally: Path) -> None:
    """Do what the fault asks, unless it has been done often enough."""
    with tally.open("ab+") as stream:
        stream.write(b".")
        stream.flush()
        if fault["times"] is not None and stream.tell() > fault["times"]:
            return
    if fault["what"] == "raise":
        raise RuntimeError("broken\non purpose")
    if fault["what"] == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if fault["what"] == "wait":
        time.sleep(60)
    if fault["what"] == "eat":
        eaten = []
        for _ in range(EAT_BYTES // PIECE_BYTES):
            eaten.append(np.ones(PIECE_BYTES, np.uint8))
            time.sleep(0.01)
        raise AssertionError("nobody has minded")
