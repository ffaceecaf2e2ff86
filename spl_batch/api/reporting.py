"""Write a report again from what is on disk."""

from pathlib import Path

from spl_batch.io.store import Store, read_receipt
from spl_batch.plan.shelf import Shelf
from spl_batch.report.model import Failure, Report
from spl_batch.runner.context import Context
from spl_batch.runner.summary import RunFacts, StageCost, recall, summarise
from spl_batch.workflow import parse_workflow


def report(output: Path | str) -> Report:
    """Write ``report.json`` and ``report.html`` of an output folder again.

    Parameters
    ----------
    output : Path or str
        Folder of the results.

    Raises
    ------
    StoreError
        If no run has finished there.
    """
    done, context, facts = recalled(Path(output).resolve())
    return summarise(done, context, facts)


def recalled(folder: Path) -> tuple[dict[str, Shelf], Context, RunFacts]:
    """What the last run of an output folder did: finished tasks, settings, facts.

    Raises
    ------
    StoreError
        If no run has finished there.
    """
    kept = recall(folder)
    context = Context(
        parse_workflow(kept["workflow"], str(folder / "store" / "run.json")),
        Path(kept["base"]),
        folder,
        kept["crs_wkt"],
        kept["code"],
    )
    facts = RunFacts(
        kept["wall_s"],
        kept["workers"],
        {stage: StageCost(**cost) for stage, cost in kept["costs"].items()},
        [Failure(**failure) for failure in kept["failures"]],
        kept["notes"],
        kept["reference"],
        kept["not_read"],
    )
    return _receipts(context.store, kept["done"]), context, facts


def _receipts(store: Store, names: dict[str, list[str]]) -> dict[str, Shelf]:
    found = {kind: Shelf(kind) for kind in names}
    for kind, listed in names.items():
        for name in listed:
            receipt = read_receipt(store, kind, name)
            if receipt is not None:
                found[kind].put(receipt)
    return found
