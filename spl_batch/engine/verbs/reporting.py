"""Write a report again from what is on disk."""

from pathlib import Path
from typing import Any

from spl_batch.engine.report.run_record import FACTS, RUN, RunFacts, recall
from spl_batch.engine.settings.mistaken_file import refuse_no_output
from spl_batch.engine.settings.workflow_file import parse_any
from spl_batch.engine.store.working_store import Store, read_receipt
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import StepReceipts
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.verbs.progress import forget_makers
from spl_batch.engine.verbs.receiver import Receiver
from spl_batch.engine.verbs.running import RunResult, result_of
from spl_batch.errors import DamagedError, SplBatchError, StoreError, refuse_without
from spl_batch.formats.files.atomic import real_path
from spl_batch.receivers import receiver, steps, summariser


def report(output: Path | str) -> RunResult:
    """Write ``report.json`` and ``report.html`` of an output folder again.

    Parameters
    ----------
    output : Path or str
        Folder of the results.

    Raises
    ------
    WorkflowError
        If it is no output folder.
    StoreError
        If no run has finished there, or one of a version whose records this one cannot read.
    DamagedError
        If something that it reads is damaged. The report that is there stays as it is.
    """
    refuse_no_output(Path(output), "report")
    refuse_without("matplotlib", "reports", "report")
    done, context, facts = recalled(real_path(output))
    kind = context.workflow.kind
    try:
        written = summariser(kind)(done, context, facts)
    except DamagedError as error:
        # A run that finds all finished would not look at it.
        forget_makers(context.store, steps(kind), [context.store.name_of(error.path)], {})
        raise
    except Exception as error:
        # What tasks record changes with the code: another version's may lack what is looked for.
        if isinstance(error, SplBatchError) or context.code == code_version(kind):
            raise
        raise _of_another_version(context.output, context.code) from error
    return result_of(receiver(kind), context.output, written)


def recalled(folder: Path) -> tuple[dict[str, StepReceipts], Any, RunFacts]:
    """What the last run of an output folder did: finished tasks, context, facts.

    Raises
    ------
    StoreError
        If no run has finished there.
    DamagedError
        If what it has left is damaged.
    """
    kept = recall(folder)
    workflow = parse_any(kept["workflow"], str(Store(folder).local / RUN))
    found: Receiver[Any, Any] = receiver(workflow.kind)
    given = workflow, Path(kept["base"]), folder, kept["crs_wkt"], kept["code"]
    context: RunContext[Any] = found.context(*given)
    if "facts" not in kept:
        raise _of_another_version(folder, kept["code"])
    facts = FACTS.validate_python(kept["facts"])
    store, declared = context.store, steps(workflow.kind)
    done = {step: StepReceipts(declared[step]) for step in kept["done"]}
    for kind, name in ((kind, name) for kind, names in kept["done"].items() for name in names):
        receipt = read_receipt(store, kind, name)
        if receipt is None:
            raise DamagedError(store.receipt(kind, name), "it is not what was written")
        done[kind].put(receipt)
    return done, context, facts


def _of_another_version(output: Path, code: str) -> StoreError:
    return StoreError(
        f"{output}: made by spl-batch {code}, whose records this version cannot read; run the "
        "workflow again, which does anew only what has changed"
    )
