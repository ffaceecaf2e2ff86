"""Arguments and options that several commands share, and the clock of the command that runs."""

from contextvars import ContextVar
from pathlib import Path
from typing import Any

import click

from spl_batch.cli.clock import CommandClock

CLOCK: ContextVar[CommandClock] = ContextVar("command clock", default=CommandClock())  # noqa: B039 - never changed

WORKFLOW = click.argument("workflow", type=click.Path(path_type=Path))
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
