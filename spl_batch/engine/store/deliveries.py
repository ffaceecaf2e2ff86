"""Record of the files that runs have delivered: the owner file of an output folder.

``delivered.json`` lies beside the results and outlives the working store. It names the survey that
the output belongs to and every file that its runs have delivered, with size, time of writing and
checksum: nothing else is deleted, and no other survey's results are replaced.
"""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, Final

from spl_batch.engine.store.working_store import read_json, read_receipts, write_json
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import delivering
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import DamagedError, named
from spl_batch.formats.files.atomic import is_as_written

RECORD: Final = "delivered.json"
"""Name of the record, below the output."""

LISTED: Final = 20
"""Files that a line names of those that are deleted [count]."""


class Deliveries:
    """The files that the runs of an output folder have written.

    Where the run before was ``stopped`` receipts have what it delivered.
    """

    def __init__(self, context: RunContext[Any], *, stopped: bool = False) -> None:
        self.output = context.output
        self._kinds = delivering(context.workflow.kind)
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
        made = (read_receipts(context.store, kind) for kind in self._kinds if stopped)
        for receipt in chain.from_iterable(made):
            if not receipt.failed:
                self.wrote(receipt)

    @property
    def anything_there(self) -> bool:
        """Whether anything is left of earlier runs, finished tasks among it."""
        places = (self.output / "store" / "receipts", *map(self.output.joinpath, self.files))
        return any(place.exists() for place in places)

    def save(self) -> None:
        """Write the record."""
        write_json(self.output / RECORD, {"survey": self.survey, "files": self.files})

    def begin(self, survey: Mapping[str, Any]) -> None:
        """Record whose the output is, before anything is written."""
        self.survey = survey
        self.save()

    def wrote(self, receipt: Receipt) -> None:
        """Take note of what a task has delivered, or is known to have."""
        for name, content in receipt.outputs.items() if receipt.kind in self._kinds else ():
            # A map for the report lies in the store.
            if name in receipt.written_ns and not name.removeprefix("./").startswith("store/"):
                self.files[name] = [receipt.sizes[name], receipt.written_ns[name], content]

    def withdraw(self, ledger: Ledger[Any, Any], *, failed: bool) -> Iterator[str]:
        """Delete what earlier runs delivered and this one does not vouch for; a line that names it.

        A file of an input that is gone, or can no longer be read, would pass for a result. Only
        files that are as they were written are deleted, and none where tasks ``failed``: nobody
        knows what these would have made.
        """
        finished = chain.from_iterable(ledger.of(kind).values() for kind in self._kinds)
        current = {name for receipt in finished for name in receipt.outputs}
        stale = sorted(self.files.keys() - current)
        gone = [one for one in stale if is_as_written(self.output / one, *self.files[one])]
        self.spared = gone if failed else []
        if gone and not failed:
            yield f"deleted, as earlier runs made it and this one does not: {named(gone, LISTED)}"
            for name in gone:
                (self.output / name).unlink(missing_ok=True)
        stays = current.union(self.spared)
        self.files = {name: stamp for name, stamp in self.files.items() if name in stays}
        self.save()
