"""A store elsewhere belongs to one output: two would overwrite each other's files."""

import socket
import uuid
from typing import Final

from spl_batch.errors import DamagedError, WorkflowError
from spl_batch.io.store import IDENTITY, Store, read_json, write_json

_MARK: Final = "output.json"


def claim(store: Store) -> None:
    """Leave a mark in a store that says whose it is, unless it lies in the output itself.

    Parameters
    ----------
    store : Store
        Of an output whose lock is held.

    Raises
    ------
    WorkflowError
        If the mark of another output is there.
    StoppedError
        If the store cannot be reached.
    """
    if store.url is None:
        return
    mine = _identity(store)
    mark = store.path(_MARK)
    try:
        there = read_json(mark)
    except DamagedError:  # none yet
        content = {"id": mine, "output": str(store.output), "host": socket.gethostname()}
        write_json(mark, content)
        return
    if there["id"] != mine:
        raise WorkflowError(
            f"outputs.store: {store.url} is the store of another output, {there['output']} "
            f"(host {there['host']}): name another one, or delete what is there"
        )


def _identity(store: Store) -> str:
    """What tells this output from others, wherever it is moved to."""
    path = store.local / IDENTITY
    try:
        return str(read_json(path)["id"])
    except DamagedError:
        mine = uuid.uuid4().hex
        write_json(path, {"id": mine})
        return mine
