"""Files and folders that a command was given and cannot take."""

import re
from pathlib import Path
from typing import Final

from spl_batch.errors import WorkflowError

_URL: Final = re.compile(r"[A-Za-z][\w+.-]+:/")
"""How a URL begins, also where two slashes have become one as those of a path do."""

_OUTPUT_MARKS: Final = ("log.jsonl", "delivered.json", "report.json")


def url_fault(name: Path | str) -> str:
    """Why a path cannot be used that is a URL; empty where it is none."""
    if not _URL.match(str(name)) or Path(name).exists():
        return ""
    return "this is a URL: copy or mount it, and name a file or folder of this machine"


def refuse_urls(*names: Path | str | None) -> None:
    """Refuse paths that are not of this machine; a path made of one would be a folder `s3:`.

    Raises
    ------
    WorkflowError
        One line that names the first.
    """
    for name in names:
        if name is not None and (fault := url_fault(name)):
            raise WorkflowError(f"{name}: {fault}")


def refuse_no_output(path: Path, verb: str) -> None:
    """Refuse what is no output folder of a run, in one line that names it."""
    if any((path / name).exists() for name in _OUTPUT_MARKS):
        return
    fault = url_fault(path) or (
        f"no run has worked here; `spl-batch {verb}` takes the output folder of a run"
    )
    raise WorkflowError(f"{path}: {fault}")
