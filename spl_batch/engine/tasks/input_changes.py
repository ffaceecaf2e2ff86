"""Inputs that change while a survey is worked on: noticed before old and new content mix."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spl_batch.engine.store.working_store import read_receipt
from spl_batch.engine.tasks.context import RunContext
from spl_batch.errors import DamagedError, InputError, reason_of


@contextmanager
def unchanged(path: Path, then: Sequence[int]) -> Iterator[None]:
    """Read a file, or a folder of files, that is as it was, before and after.

    ``then``: its :func:`stamp`.

    Raises
    ------
    InputError
        If it has another.
    """
    _compare(path, then)
    yield
    _compare(path, then)


def as_indexed(step: str, args: Mapping[str, Any], context: RunContext[Any]) -> Sequence[int]:
    """Stamp of an input when a step read it; ``args`` name its ``source`` and ``path``."""
    receipt = read_receipt(context.store, step, args["source"])
    if receipt is None:
        path = context.store.receipt(step, args["source"])
        raise DamagedError(path, "no receipt of the index")
    return receipt.inputs[args["path"]]


def stamp(path: Path) -> tuple[int, int]:
    """Size [byte] and latest time of writing [ns since 1970] of a file, or of all in a folder."""
    if not path.is_dir():
        stat = path.stat()
        return stat.st_size, stat.st_mtime_ns
    found = [file.stat() for file in path.rglob("*")]
    return sum(s.st_size for s in found), max((s.st_mtime_ns for s in found), default=0)


def stamp_if_there(path: Path) -> list[int]:
    """The stamp of an input for the task that is to read it; zeros for one that is gone.

    That task reports it, and fails alone.
    """
    try:
        return list(stamp(path))
    except OSError:
        return [0, 0]


def _compare(path: Path, then: Sequence[int]) -> None:
    try:
        now = stamp(path)
    except OSError as error:
        raise InputError(
            str(path), f"is gone since the run began ({reason_of(error)}): put it back, run again"
        ) from error
    if list(now) != list(then):
        raise InputError(
            str(path),
            f"has changed since the run began, {then[0]} bytes then and {now[0]} now or "
            "written to since: run again when it is complete, it is then read anew",
        )
