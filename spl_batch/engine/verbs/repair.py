"""Make again what turned out to be damaged: forget who made it, and go through the run again."""

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any

from spl_batch.engine.store.working_store import Store, forget_receipt, read_receipts
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Receipt

TRIES = 3
"""Times that a run makes a damaged file again: a disk that fails for good fails each time."""


class Repairs:
    """Damaged files that a run has made again, and how often.

    Parameters
    ----------
    store : Store
        Holds the receipts.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        self.times: Counter[str] = Counter()

    def wanted(
        self, failed: Iterable[Receipt], ledger: Ledger[Any, Any], found: Iterable[str] = ()
    ) -> dict[str, tuple[str, str]]:
        """Damaged files that can be made again, with kind and name of the task that does it.

        Parameters
        ----------
        failed : iterable of Receipt
            Of tasks that did not do their work.
        ledger : Ledger
            Knows who made what.
        found : iterable of str
            Paths of more damaged files, which no task has met.
        """
        paths = [*found, *(r.facts["damaged"] for r in failed if "damaged" in r.facts)]
        damaged = {self.store.name_of(path) for path in paths}
        if not damaged:
            return {}
        makers = {
            output: (kind, receipt.name)
            for kind in ledger.done
            for receipt in read_receipts(self.store, kind)
            for output in receipt.outputs
        }
        again = {}
        for name in sorted(damaged):
            # A chunk is part of an output that is a directory.
            for part in (name, *map(str, PurePosixPath(name).parents)):
                if part in makers and self.times[part] < TRIES:
                    again[part] = makers[part]
        return again

    def begin(
        self, failed: Iterable[Receipt], ledger: Ledger[Any, Any], found: Iterable[str] = ()
    ) -> list[str]:
        """Forget the tasks that made damaged files, and what the ledger knows of finished ones.

        Parameters
        ----------
        failed, ledger, found
            As :meth:`wanted` takes them.

        Returns
        -------
        list of str
            The files, as receipts call them; none if there is nothing to be done again.
        """
        again = self.wanted(failed, ledger, found)
        for name, maker in again.items():
            self.times[name] += 1
            forget_receipt(self.store, *maker)
        if again:
            ledger.done.clear()
            for name, member in vars(type(ledger)).items():
                if isinstance(member, cached_property):
                    ledger.__dict__.pop(name, None)
        return list(again)
