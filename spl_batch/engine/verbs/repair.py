"""Damaged files of a store, and the tasks that make them again."""

from collections.abc import Iterable
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any, Final

from spl_batch.engine.store.working_store import Store, forget_receipt, read_receipts
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Need

TRIES: Final = 3
"""Times that a run makes a damaged file again: a disk that fails for good fails each time."""

METADATA: Final = "zarr.json"
"""File that describes arrays: a run makes it before the tasks that fill them."""


def makers(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> dict[str, Need | None]:
    """Damaged files, as receipts call them, with the task that makes each; None for metadata."""
    names = [*damaged]
    found: dict[str, Need | None] = {n: None for n in names if n.endswith(f"/{METADATA}")}
    # A chunk is part of an output that is a directory.
    parts = {part for name in names for part in (name, *map(str, PurePosixPath(name).parents))}
    for kind in kinds if parts else ():
        for receipt in read_receipts(store, kind):
            made = parts & receipt.outputs.keys()
            found.update(dict.fromkeys(made, (receipt.kind, receipt.name)))
    return dict(sorted(found.items()))


def forget_makers(
    store: Store, kinds: Iterable[str], damaged: Iterable[str], known: dict[str, int]
) -> list[str]:
    """Have damaged files made again by the next look at the tasks; those that can be.

    ``known``: how often this was done, by their names [count]; it is counted on.
    """
    found = makers(store, kinds, damaged)
    again = {name: need for name, need in found.items() if known.get(name, 0) < TRIES}
    for name, need in again.items():
        known[name] = known.get(name, 0) + 1
        if need is not None:
            forget_receipt(store, *need)
    return [*again]


def forget_finished(ledger: Ledger[Any, Any]) -> None:
    """Forget what is finished, and what was derived of it."""
    ledger.done.clear()
    for name, member in vars(type(ledger)).items():
        if isinstance(member, cached_property):
            ledger.__dict__.pop(name, None)
