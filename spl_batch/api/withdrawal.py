"""Take away what earlier runs delivered and this one does not vouch for."""

from collections.abc import Iterable
from typing import Any

from spl_batch.errors import DamagedError
from spl_batch.io.store import read_json, read_receipts, write_json
from spl_batch.plan.ledger import Ledger
from spl_batch.plan.shelf import delivers
from spl_batch.runner import kinds
from spl_batch.runner.context import RunContext


def withdraw_stale(ledger: Ledger[Any, Any], context: RunContext[Any]) -> list[str]:
    """Unlink files that an earlier run delivered and that no finished task of this one wrote.

    A file of an input that is gone, or can no longer be read, would pass for a result.

    Parameters
    ----------
    ledger : Ledger
        With the deliver stage behind it.
    context : RunContext
        The run.

    Returns
    -------
    list of str
        What was taken away, relative to the output folder.
    """
    delivering = [kind for kind in kinds(context.workflow.kind) if delivers(kind)]
    current = sorted(
        {
            path
            for kind in delivering
            for receipt in ledger.of(kind).values()
            for path in receipt.outputs
        }
    )
    stale = sorted(set(_delivered(context, delivering)) - set(current))
    for path in stale:
        (context.output / path).unlink(missing_ok=True)
    write_json(context.store.local / "delivered.json", {"delivered": current})
    return stale


def _delivered(context: RunContext[Any], delivering: Iterable[str]) -> Iterable[str]:
    """What earlier runs delivered: from the manifest, or from all receipts where it is no use."""
    try:
        delivered: list[str] = read_json(context.store.local / "delivered.json")["delivered"]
    except (DamagedError, KeyError):
        return [
            path
            for kind in delivering
            for receipt in read_receipts(context.store, kind)
            for path in receipt.outputs
        ]
    return delivered
