"""Arguments and options that several commands share, and the clock of the command that runs."""

import os
import re
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import click

from spl_batch.cli.clock import CommandClock
from spl_batch.errors import WorkflowError, named

CLOCK: ContextVar[CommandClock] = ContextVar("command clock", default=CommandClock())  # noqa: B039 - never changed


def _there(_context: click.Context, _argument: click.Parameter, path: Path) -> Path:
    """Refuse a workflow that is not there before anything is loaded, which takes seconds."""
    if ":/" not in str(path) and not os.path.lexists(path):  # of a URL a later line tells
        raise WorkflowError(f"{path}: no such file{_near(path)}")
    return path


def _near(path: Path) -> str:
    """Workflows that lie where a file was looked for."""
    try:
        found = sorted(one.name for one in path.parent.iterdir() if _may_be_workflow(one))
    except OSError:
        return "; check the path"
    return f"; there is {named(found, 3)}" if found else "; check the path"


_YAML = {".yaml", ".yml"}
_HEAD_BYTES = 1 << 16
_SECTIONS = re.compile(rb"^(survey|track|output)\s*:", re.MULTILINE)


def _may_be_workflow(path: Path) -> bool:
    """Whether a YAML file is called a workflow, or has its sections; nothing is parsed."""
    if path.suffix not in _YAML or not path.is_file():
        return False
    if "workflow" in path.name:
        return True
    try:
        with path.open("rb") as stream:
            sections = set(_SECTIONS.findall(stream.read(_HEAD_BYTES)))
    except OSError:  # a file that cannot be read is no advice
        return False
    return b"survey" in sections or sections == {b"track", b"output"}


WORKFLOW = click.argument("workflow", type=click.Path(path_type=Path), callback=_there)
OUTPUT = click.argument("output", type=click.Path(path_type=Path))
SETTINGS = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY.PATH=VALUE",
    help="Set a key of the workflow; repeatable.",
)


def limits(command: Any) -> Any:
    """Options that say how much of the machine may be used."""
    command = click.option(
        "--memory",
        metavar="SIZE",
        show_default="four fifths of the machine's, shared by the workers, 16GiB at most; "
        "4GiB with a scheduler",
        help="Memory limit of a worker, such as 4GiB.",
    )(command)
    return click.option(
        "--workers", default=2, show_default=True, help="Worker processes; 0 works in this one."
    )(command)
