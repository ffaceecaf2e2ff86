"""Owner of an output folder: a run writes only where no other survey's results can be lost.

An output belongs to the survey that the last run there worked on. Two runs work on the same survey
if they have an input in common: a file at the same path, or one of the same name and size.

``delivered.json`` lies beside the results and outlives the working store. It names that survey and
every file that its runs have delivered, with size, time of writing and checksum: nothing else is
deleted, and no other survey's results are replaced.
"""

import os
import socket
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import REPORT_FILES
from spl_batch.engine.store.output_lock import was_stopped
from spl_batch.engine.store.working_store import Store, read_json, read_receipts, write_json
from spl_batch.engine.tasks.step import delivering
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.errors import DamagedError, WorkflowError, named
from spl_batch.formats.files.atomic import is_as_written, size

RECORD: Final = "delivered.json"
"""Name of the record, below the output."""

LISTED: Final = 20
"""Files that a line names of those that are deleted [count]."""

_MARK: Final = "output.json"
"""Names the output that a store elsewhere belongs to."""


class Deliveries:
    """The files that the runs of an output folder have written, before a run that may work there.

    Where the run before was ``stopped`` receipts have what it delivered.
    """

    def __init__(self, prepared: Prepared[Any, Any], *, stopped: bool = False) -> None:
        self.prepared, self.output = prepared, prepared.context.output
        self._kinds = delivering(prepared.context.workflow.kind)
        #: ``name`` and ``inputs`` of the survey that the output belongs to, once one is recorded.
        self.survey: Mapping[str, Any] | None = None
        #: Size [byte], time of writing [ns since 1970] and checksum of each, by its name below it.
        self.files: dict[str, list[Any]] = {}
        self.spared: list[str] = []  #: Those that :meth:`withdraw` has left, as tasks failed.
        try:
            kept = read_json(self.output / RECORD)
            self.survey, self.files = kept["survey"], kept["files"]
        except DamagedError:  # none yet, or one that nobody can trust: receipts have the files
            stopped = True
        made = (read_receipts(prepared.context.store, kind) for kind in self._kinds if stopped)
        for receipt in chain.from_iterable(made):
            if not receipt.failed:
                self.wrote(receipt)

    @property
    def anything_there(self) -> bool:
        """Whether anything is left of earlier runs, finished tasks among it."""
        paths = (self.output / "store" / "receipts", *map(self.output.joinpath, self.files))
        return any(path.exists() for path in paths)

    def save(self) -> None:
        """Write the record."""
        write_json(self.output / RECORD, {"survey": self.survey, "files": self.files})

    def begin(self) -> None:
        """Record whose the output is, and a store elsewhere, before anything is written."""
        content = self.prepared.context.workflow.model_dump(mode="json")
        sections = (value for value in content.values() if isinstance(value, dict))
        name = next((str(s["name"]) for s in sections if "name" in s), "survey")
        inputs = [[str(path), size(path)] for path in input_paths(self.prepared)]
        self.survey = {"name": name, "inputs": inputs}
        self.save()
        store = self.prepared.context.store
        if store.url:  # two outputs would overwrite each other there
            there = {"output": str(self.output), "host": socket.gethostname()}
            write_json(store.path(_MARK), there)

    def gone_inputs(self) -> Iterator[Finding]:
        """Name the inputs of the run before that are not among this one's; their results go."""
        before = [Path(path).name for path, _ in (self.survey or {}).get("inputs", ())]
        # By their names alone, as a survey may have been moved.
        gone = sorted({*before} - {path.name for path in input_paths(self.prepared)})
        if 0 < len(gone) < len(before):
            yield Finding("E01", {"kind": "gone", "files": gone})

    def wrote(self, receipt: Receipt) -> None:
        """Take note of what a task has delivered, or is known to have."""
        for name, content in receipt.outputs.items() if receipt.kind in self._kinds else ():
            # A map for the report lies in the store.
            if name in receipt.written_ns and not name.removeprefix("./").startswith("store/"):
                self.files[name] = [receipt.sizes[name], receipt.written_ns[name], content]

    def withdraw(self, *, failed: bool) -> Iterator[str]:
        """Delete what earlier runs delivered and this one does not vouch for; a line that names it.

        A file of an input that is gone, or can no longer be read, would pass for a result. Only
        files that are as they were written are deleted, and none where tasks ``failed``: nobody
        knows what these would have made.
        """
        ledger = self.prepared.ledger
        finished = chain.from_iterable(ledger.of(kind).values() for kind in self._kinds)
        current = {name for receipt in finished for name in receipt.outputs}
        stale = sorted(self.files.keys() - current)
        gone = [one for one in stale if is_as_written(self.output / one, *self.files[one])]
        self.spared = gone if failed else []
        if gone and not failed:
            yield f"deleted, as earlier runs made it and this one does not: {named(gone, LISTED)}"
            for name in gone:
                (self.output / name).unlink(missing_ok=True)
                _remove_emptied(self.output, name)
        stays = current.union(self.spared)
        self.files = {name: stamp for name, stamp in self.files.items() if name in stays}
        self.save()


def _remove_emptied(output: Path, name: str) -> None:
    """Remove the folders of a deleted file that hold nothing any more."""
    for folder in map(output.joinpath, Path(name).parents):
        if folder == output or not folder.is_dir() or any(folder.iterdir()):
            return
        folder.rmdir()


def usable(prepared: Prepared[Any, Any], *, stopped: bool | None = None) -> Deliveries:
    """What earlier runs have left in the output folder of a run that may work there.

    ``stopped``: whether the run before was stopped, where the lock that shows it is taken already.
    WorkflowError if nothing can be written there, or another survey's results are there, or files
    that no run has recorded; StoppedError if a store elsewhere cannot be reached.
    """
    output = prepared.context.output
    there = next(path for path in (output, *output.parents) if os.path.lexists(path))
    if not there.is_dir() or not os.access(there, os.W_OK):
        raise WorkflowError(
            f"output: {output} cannot be written: nothing can be made in {there}; name another "
            "output, or look at what is there and at its rights"
        )
    if there not in {output, output.parent} and not output.is_relative_to(prepared.context.base):
        raise WorkflowError(  # a slip, or a disk that is off
            f"output: {output}: there is no folder {output.parent}; check the path"
        )
    _refuse_claimed(prepared.context.store)
    stopped = was_stopped(output) if stopped is None else stopped
    deliveries = Deliveries(prepared, stopped=stopped)
    if deliveries.survey is None:
        _refuse_unknown(prepared, deliveries)
    elif deliveries.anything_there and not _in_common(deliveries.survey["inputs"], prepared):
        inputs = [Path(path).name for path, _ in deliveries.survey["inputs"]]
        raise WorkflowError(
            f"output: {output} holds the results of another survey, {deliveries.survey['name']!r}, "
            f"made of {named(inputs, 2)}, no input of this one; name another output, or delete "
            "that folder"
        )
    return deliveries


def _refuse_unknown(prepared: Prepared[Any, Any], deliveries: Deliveries) -> None:
    """Refuse an output with files where results go that no run has recorded."""
    output = prepared.context.output
    patterns = (*prepared.receiver.delivered, *REPORT_FILES)
    there = (path for pattern in patterns for path in sorted(output.glob(pattern)))
    names = [path.relative_to(output).as_posix() for path in there if path.is_file()]
    unknown = [name for name in names if name not in deliveries.files]
    if unknown:
        raise WorkflowError(
            f"output: {output} holds {named(unknown, 3)}, and no run has recorded there "
            f"({RECORD}) that it wrote them; name another output, or move them away"
        )


def _refuse_claimed(store: Store) -> None:
    """Refuse a store elsewhere that is another output's."""
    try:
        there = read_json(store.path(_MARK)) if store.url else {"output": str(store.output)}
    except DamagedError:  # none yet
        return
    if there["output"] != str(store.output):
        raise WorkflowError(
            f"outputs.store: {store.url} is the store of another output, {there['output']} "
            f"(host {there['host']}): name another one, or delete what is there"
        )


def input_paths(prepared: Prepared[Any, Any]) -> list[Path]:
    """Every input that the workflow names, those that cannot be used included."""
    inputs = prepared.ledger.inputs
    return sorted({*(s.path for s in inputs.sources), *(Path(bad.path) for bad in inputs.bad)})


def _in_common(earlier: list[list[Any]], prepared: Prepared[Any, Any]) -> bool:
    """Whether an input of an earlier run is one of this run's."""
    known = {key for path, count in earlier for key in (path, (Path(path).name, count))}
    return any(str(p) in known or (p.name, size(p)) in known for p in input_paths(prepared))
