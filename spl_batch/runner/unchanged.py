"""Inputs that change while a survey is worked on: noticed before what they say is mixed up."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spl_batch.errors import DamagedError, InputError
from spl_batch.io.store import read_receipt
from spl_batch.runner.context import Context


@contextmanager
def unchanged(path: Path, stamp: Sequence[int]) -> Iterator[None]:
    """Read a file that is as it was, before and after.

    Parameters
    ----------
    path : Path
        The file.
    stamp : (int, int)
        Size [byte] and time of writing [ns since 1970] that it had.

    Raises
    ------
    InputError
        If it has others.
    """
    _compare(path, stamp)
    yield
    _compare(path, stamp)


def as_indexed(args: Mapping[str, Any], context: Context) -> Sequence[int]:
    """Stamp of an input when it was indexed; ``args`` name its ``source`` and ``path``."""
    receipt = read_receipt(context.store, "index_file", args["source"])
    if receipt is None:
        path = context.store.receipt("index_file", args["source"])
        raise DamagedError(path, "no receipt of the index")
    return receipt.inputs[args["path"]]


def _compare(path: Path, stamp: Sequence[int]) -> None:
    try:
        stat = path.stat()
    except OSError as error:
        raise InputError(
            str(path), f"is gone since the run began ({error.strerror}): put it back, run again"
        ) from error
    if [stat.st_size, stat.st_mtime_ns] != list(stamp):
        raise InputError(
            str(path),
            f"has changed since the run began, {stamp[0]} bytes then and {stat.st_size} now or "
            "written to since: run again when it is complete, it is then read anew",
        )
