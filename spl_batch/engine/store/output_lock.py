"""One run at a time in an output folder; the system lets go of the lock when a run dies.

A lock of :mod:`filelock` would empty the file, by which tasks of a killed run know that another one
has begun (:func:`spl_batch.formats.files.atomic.owned_by`).
"""

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
from spl_batch.formats.files.atomic import stop_if_full
from spl_batch.formats.files.locks import lock

PATIENCE_S: Final = 1.0
"""How long a run waits for the lock [s]; a look at it by :func:`holder` takes no time."""


@contextmanager
def locked(output: Path) -> Iterator[str]:
    """Keep two runs out of one output; WorkflowError if one works there, or none can write there.

    Gives what the lock file holds while the body runs: who works here, and a token that no other
    run has.
    """
    path = lock_file(output)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("a+", encoding="utf-8")
    except OSError as error:
        stop_if_full(error, output)
        raise WorkflowError(
            f"output: {output} cannot be written ({reason_of(error)}): name another output, or "
            "look at what is there and at its rights"
        ) from None
    with stream:
        _take(stream, output)
        content = json.dumps(
            {
                "host": socket.gethostname(),
                "pid": os.getpid(),
                "started": datetime.now(UTC).isoformat(timespec="seconds"),
                "token": uuid.uuid4().hex,
            }
        )
        try:
            # Not by the stream, which would try again at its end what a full disk has refused.
            os.ftruncate(stream.fileno(), 0)
            os.write(stream.fileno(), content.encode())
            os.fsync(stream.fileno())
            yield content
            os.ftruncate(stream.fileno(), 0)  # what is left there is of a run that was stopped
        except OSError as error:
            stop_if_full(error, output)
            raise


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
        with path.open(encoding="utf-8") as stream:
            lock(stream, shared=True)
    except BlockingIOError:
        return _mark(path)
    except OSError:
        return None
    return None


def _take(stream: Any, output: Path) -> None:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            return lock(stream)
        except BlockingIOError:
            if time.monotonic() > until:
                who = _mark(lock_file(output))
                by = "".join(f", {name} {value}" for name, value in who.items() if name != "token")
                text = f"output: another run is working in {output}{by}; wait for it"
                raise WorkflowError(text) from None
        time.sleep(0.05)


def _mark(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content
