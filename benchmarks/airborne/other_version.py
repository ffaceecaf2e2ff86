"""Runs by another version of this repository, on the files that this one has simulated."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import yaml

OUT: Final = "out_before"
"""Where its result lies, beside that of this version."""

_PROGRAM: Final = """
import json, sys
from spl_batch.engine.verbs.running import run
for workflow, overrides in json.load(sys.stdin):
    run(workflow, workers=0, overrides=overrides)
    print(workflow, flush=True)
"""


def run_by(checkout: Path, wanted: Sequence[tuple[Path, Sequence[str]]]) -> None:
    """Run workflows by another version, in one process of its own.

    Parameters
    ----------
    checkout : Path
        Folder with the other version; its kernels compile at the first run.
    wanted : sequence of (Path, sequence of str)
        Workflow files, and settings that replace theirs. Results lie in :data:`OUT` beside each.
    """
    asked = [(str(without_checkpoints(path.resolve())), [*given]) for path, given in wanted]
    subprocess.run(  # noqa: S603
        [sys.executable, "-c", _PROGRAM],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout.resolve())},
        input=json.dumps(asked),
        stdout=subprocess.DEVNULL,
        check=True,
        text=True,
    )


def without_checkpoints(path: Path) -> Path:
    """The same workflow with another output, and no check points: older versions know none."""
    content = yaml.safe_load(path.read_text()) | {"output": OUT}
    content.get("reference", {}).pop("checkpoints", None)
    other = path.with_name(f"{path.stem}_before.yaml")
    other.write_text(yaml.safe_dump(content))
    return other
