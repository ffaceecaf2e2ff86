"""Take away what earlier runs delivered and this one does not vouch for."""

from collections.abc import Iterable
from pathlib import Path

from spl_batch.errors import DamagedError
from spl_batch.io.store import Store, read_json, read_receipts, write_json
from spl_batch.plan.shelf import DELIVERING
from spl_batch.plan.survey import Survey


def withdraw_stale(survey: Survey, output: Path) -> list[str]:
    """Unlink files that an earlier run delivered and that no finished task of this one wrote.

    A file of an input that is gone, or can no longer be read, would pass for a result.

    Parameters
    ----------
    survey : Survey
        With the deliver stage behind it.
    output : Path
        Folder of the results.

    Returns
    -------
    list of str
        What was taken away, relative to ``output``.
    """
    manifest = output / "store" / "delivered.json"
    current = sorted(
        {
            path
            for kind in DELIVERING
            for receipt in survey.of(kind).values()
            for path in receipt.outputs
        }
    )
    stale = sorted(
        set(_read(manifest, Store(output, survey.workflow.outputs.store))) - set(current)
    )
    for path in stale:
        (output / path).unlink(missing_ok=True)
    write_json(manifest, {"delivered": current})
    return stale


def _read(manifest: Path, store: Store) -> Iterable[str]:
    """What earlier runs delivered: from the manifest, or from all receipts where it is no use."""
    try:
        delivered: list[str] = read_json(manifest)["delivered"]
    except (DamagedError, KeyError):
        return [
            path for kind in DELIVERING for r in read_receipts(store, kind) for path in r.outputs
        ]
    return delivered
