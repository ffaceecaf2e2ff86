"""Preloaded by workers of tests: the whole process group is killed at a given moment.

The moment is ``WHERE:RECEIPTS`` in an environment variable: as soon as so many receipts are there,
``receipt`` kills after a task has written its outputs, when it would leave its receipt, and
``output`` kills when an output is written, but not yet renamed into place.
"""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spl_batch.engine.tasks import runner
from spl_batch.formats.files import atomic

VARIABLE = "SPL_BATCH_TEST_KILL"
"""Environment variable that holds the moment; after it, the output folder."""


def receipt_files(output: Path) -> list[Path]:
    """Receipts of a run."""
    return list((output / "store/receipts").rglob("*.json"))


def dask_setup(_worker: object) -> None:
    """Lay the trap."""
    where, count, folder = os.environ[VARIABLE].split(":", maxsplit=2)
    output = Path(folder)

    def trapped(function: Callable[..., Any], applies: Callable[..., bool]) -> Callable[..., Any]:
        def perhaps(*args: Any, **options: Any) -> Any:
            if applies(*args) and len(receipt_files(output)) >= int(count):
                os.killpg(os.getpgrp(), signal.SIGKILL)
            return function(*args, **options)

        return perhaps

    if where == "receipt":
        runner.write_receipt = trapped(runner.write_receipt, lambda *_: True)  # type: ignore[attr-defined]
    else:
        own = output / "store/receipts"
        atomic._put_in_place = trapped(
            atomic._put_in_place,
            lambda _, path: output in path.parents and own not in path.parents,
        )
