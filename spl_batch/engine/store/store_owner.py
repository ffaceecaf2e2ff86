"""A store elsewhere belongs to one output: two would overwrite each other's files."""

import socket
import uuid
from typing import Final

from spl_batch.engine.store.working_store import IDENTITY, Store, read_json, write_json
from spl_batch.errors import DamagedError, WorkflowError, named
from spl_batch.formats.files.remote import files_below

_MARK: Final = "output.json"


def refuse_claimed(store: Store) -> bool:
    """Refuse a store elsewhere that is not this output's; whether it bears its mark.

    Raises
    ------
    WorkflowError
        If the mark of another output is there, or something that is no store.
    StoppedError
        If the store cannot be reached.
    """
    if store.url is None:
        return True
    try:
        there = read_json(store.path(_MARK))
    except DamagedError:  # none yet
        _refuse_others_files(store)
        return False
    if there["id"] != _identity(store):
        raise WorkflowError(
            f"outputs.store: {store.url} is the store of another output, {there['output']} "
            f"(host {there['host']}): name another one, or delete what is there"
        )
    return True


def claim(store: Store) -> None:
    """Leave a mark in a store that says whose it is, unless it lies in the output itself.

    ``store``: of an output whose lock is held.

    Raises
    ------
    WorkflowError, StoppedError
        As :func:`refuse_claimed` does.
    """
    if refuse_claimed(store):
        return
    mine = _identity(store)
    if not mine:
        mine = uuid.uuid4().hex
        write_json(store.local / IDENTITY, {"id": mine})
    content = {"id": mine, "output": str(store.output), "host": socket.gethostname()}
    write_json(store.path(_MARK), content)


def _refuse_others_files(store: Store) -> None:
    """Refuse a place that holds anything but what a run has left: ``--fresh`` empties a store."""
    try:
        there = sorted({name.split("/")[0] for name in files_below(store.root)} - {""})
    except FileNotFoundError:
        return
    if there and "receipts" not in there:
        raise WorkflowError(
            f"outputs.store: {store.url} holds {named(there, 3)}, which is no working store: name "
            "a place where nothing is"
        )


def _identity(store: Store) -> str:
    """What tells this output from others, wherever it is moved to; empty if nothing does yet."""
    try:
        return str(read_json(store.local / IDENTITY)["id"])
    except DamagedError:
        return ""
