"""One run at a time in an output folder."""

import fcntl
import json
import os
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from spl_batch.errors import WorkflowError, reason_of
from spl_batch.formats.files.atomic import of_a_file, scratch_name, stop_if_full

PATIENCE_S: Final = 1.0
"""How long a run waits for the lock [s]; a look at it by :func:`holder` takes no time."""


@contextmanager
def locked(output: Path) -> Iterator[str]:
    """Keep two runs out of one output; the system lets go of the lock when a run dies.

    Yields
    ------
    str
        What the lock file holds while the block runs: who works here, and a token that no
        other run has.

    Raises
    ------
    WorkflowError
        If another run works there, or nothing can be written there.
    """
    refuse_unwritable(output)
    path = lock_file(output)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Whatever it holds belongs to the run that has the lock.
        stream = path.open("a+", encoding="utf-8")
    except OSError as error:
        stop_if_full(error, output)
        raise _unwritable(output, path.parent, error) from None
    with stream:
        if not _take(stream):
            raise WorkflowError(
                f"output: another run is working in {output}{_who(path)}; wait for it"
            )
        mark = {
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "token": uuid.uuid4().hex,
        }
        content = json.dumps(mark)
        try:
            # Not by the stream, which would try again at its end what a full disk has refused.
            os.ftruncate(stream.fileno(), 0)
            os.write(stream.fileno(), content.encode())
            os.fsync(stream.fileno())
            yield content
            os.ftruncate(stream.fileno(), 0)  # what is left there tells of a run that was stopped
        except OSError as error:
            stop_if_full(error, output)
            raise


def refuse_unwritable(output: Path) -> None:
    """Refuse an output folder in which nothing can be written; leaves nothing behind.

    ``output``: folder of the results, which need not be there.

    Raises
    ------
    WorkflowError
        If it cannot be made, or nothing can be made in it.
    """
    store = lock_file(output).parent
    there = next(place for place in (store, *store.parents) if _is_there(place))
    probe = scratch_name(there / "probe")
    try:
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        stop_if_full(error, output)
        raise _unwritable(output, there, error) from None


def refuse_lost(folder: Path, name: str, base: Path) -> None:
    """Refuse a folder of which more than the last part is missing: a slip, or a disk that is off.

    Below ``base``, where the work is, folders in folders may be new.

    Raises
    ------
    WorkflowError
        If neither it nor the folder above it is there; ``name`` is what the user has written.
    """
    inside = folder.absolute().is_relative_to(base.absolute())
    if not inside and not os.path.lexists(folder) and not os.path.lexists(folder.parent):
        raise WorkflowError(
            f"{name}: there is no folder {folder.parent}; check the path, or make that folder first"
        )


def _is_there(path: Path) -> bool:
    """Whether there is a file or folder; a link that leads nowhere is in the way as well."""
    try:
        return path.exists() or path.is_symlink()
    except OSError:  # not even that can be asked, so that something above it is at fault
        return False


def _unwritable(output: Path, there: Path, error: OSError) -> WorkflowError:
    return WorkflowError(
        f"output: {output} cannot be written: nothing can be made in {there} ({reason_of(error)}); "
        "name another output, or look at what is there and at its rights"
    )


def was_stopped(output: Path) -> bool:
    """Whether the run before did not come to its end; asked before the lock is taken."""
    return bool(_mark(lock_file(output)))


def lock_file(output: Path) -> Path:
    """File that a run locks."""
    return output / "store" / "lock"


def holder(output: Path) -> dict[str, Any] | None:
    """Host, process and start of the run that works in an output folder; None without any."""
    path = lock_file(output)
    try:
        with open(path, encoding="utf-8", opener=of_a_file) as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _mark(path)
    except OSError:
        return None
    return None


def _take(stream: Any) -> bool:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until:
                return False
            time.sleep(0.05)
        else:
            return True


def _mark(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content


def _who(path: Path) -> str:
    mark = _mark(path)
    if not mark:
        return ""
    return f" (host {mark['host']}, process {mark['pid']}, since {mark['started']})"
