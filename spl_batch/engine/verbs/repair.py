"""Make again what turned out to be damaged: forget who made it, and go through the run again."""

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Final

from spl_batch.engine.store.working_store import Store, forget_receipt, read_receipts
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.files.atomic import checksum, size
from spl_batch.formats.verified.zarr_chunks import METADATA

TRIES: Final = 3
"""Times that a run makes a damaged file again: a disk that fails for good fails each time."""

ARRAYS: Final = ".zarr"
"""How the name of a folder ends in which many tasks put their pieces of arrays."""

Maker = tuple[str, str]
"""Kind and name of the task that makes a file."""


def makers(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> dict[str, Maker]:
    """Outputs that are damaged, with kind and name of the task that makes each.

    Parameters
    ----------
    kinds : iterable of str
        Kinds of tasks whose outputs they may be.
    damaged : iterable of str
        Files, as receipts call them: outputs, or parts of one.
    """
    # A chunk is part of an output that is a directory.
    parts = {part for name in damaged for part in (name, *map(str, PurePosixPath(name).parents))}
    made = (receipt for kind in kinds if parts for receipt in read_receipts(store, kind))
    found = {name: (r.kind, r.name) for r in made for name in r.outputs if name in parts}
    return dict(sorted(found.items()))


def also_damaged(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> dict[str, Maker]:
    """Pieces of the same arrays that are not what was written either, with those who make them.

    Who joins the pieces meets one of them at a time. The arguments are those of :func:`makers`.
    """
    parents = {parent for name in damaged for parent in PurePosixPath(name).parents}
    arrays = tuple(f"{parent}/" for parent in parents if parent.suffix == ARRAYS)
    made = (receipt for kind in kinds if arrays for receipt in read_receipts(store, kind))
    return {
        name: (receipt.kind, receipt.name)
        for receipt in made
        for name, content in receipt.outputs.items()
        if name.startswith(arrays) and not _as_written(store.named(name), content)
    }


def _as_written(path: Path, content: str) -> bool:
    return size(path) >= 0 and checksum(path) == content


def forget_makers(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> bool:
    """Have damaged files made again by the next run; whether it will be.

    The arguments are those of :func:`makers`.
    """
    found = makers(store, kinds, damaged).values()
    for maker in found:
        forget_receipt(store, *maker)
    return bool(found)


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

    def may(self, receipt: Receipt) -> bool:
        """Whether a task failed over a damaged file that may still be made again."""
        damaged = receipt.facts.get("damaged")
        if damaged is None:
            return False
        name = PurePosixPath(self.store.name_of(damaged))
        return all(self.times[str(part)] < TRIES for part in (name, *name.parents))

    def wanted(
        self, failed: Iterable[Receipt], ledger: Ledger[Any, Any], found: Iterable[str] = ()
    ) -> dict[str, Maker | None]:
        """Damaged files that can be made again, with kind and name of the task that does it.

        None does what describes arrays: the run makes it before the tasks that fill them.

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
        names = [*map(self.store.name_of, paths)]
        described = [name for name in names if PurePosixPath(name).name == METADATA]
        again: dict[str, Maker | None] = dict.fromkeys(sorted(described))
        again |= makers(self.store, ledger.done, names)
        return {name: maker for name, maker in again.items() if self.times[name] < TRIES}

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
        also = also_damaged(self.store, ledger.done, again)
        again |= {name: maker for name, maker in also.items() if self.times[name] < TRIES}
        for name, maker in again.items():
            self.times[name] += 1
            if maker is not None:
                forget_receipt(self.store, *maker)
        if again:
            ledger.done.clear()
            for name, member in vars(type(ledger)).items():
                if isinstance(member, cached_property):
                    ledger.__dict__.pop(name, None)
        return list(again)
