"""Several methods on the same inputs: the verb, and how it ends.

What methods there are, and what is said of them, is each receiver's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.engine.watch.events import Listener, ignore
from spl_batch.errors import WorkflowError
from spl_batch.receivers import HOMES, comparison


@dataclass(frozen=True, slots=True)
class ComparisonResult:
    """How a comparison ended.

    Parameters
    ----------
    exit_status : int
        0 all done, 1 some files or tasks failed.
    output : Path
        Folder that holds ``compare.html`` and ``compare.json``.
    report : pydantic.BaseModel
        What they say; ``methods`` in the order asked for.
    titles : tuple of str
        Heads of the columns that the console shows.
    rows : tuple of tuple of str
        A row of them for each method, its name first.
    """

    exit_status: int
    output: Path
    report: Any
    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def compare(
    workflow: Path | str,
    methods: str | Sequence[str],
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> ComparisonResult:
    """Run several methods on the same inputs.

    Parameters
    ----------
    workflow : Path or str
        Workflow file.
    methods : str or sequence of str
        At least two, separated by commas, e.g. ``"vsaes:tail,voxel,published"`` of an airborne
        survey, ``"bayes,dbscan"`` of photon profiles; the first is what the others are compared
        with.
    workers : int
        Worker processes; 0 works in this process.
    memory : str or int, optional
        Memory limit of a worker [byte]; a share of the machine's unless told.
    overrides : sequence of str
        ``key.path=value``, applied to the workflow before the method is.
    listener : callable
        Told what happens.

    Returns
    -------
    ComparisonResult

    Raises
    ------
    WorkflowError, PlanError
        If nothing can be started.
    StoppedError
        If a run had to stop as a whole; the same call continues.
    """
    path = Path(workflow)
    kind = load_any(path, overrides).kind
    several = comparison(kind)
    if several is None:
        known = ", ".join(name for name, home in HOMES.items() if home.compare)
        raise WorkflowError(f"{path}: kind: {kind} has one method; compare is for {known}")
    found: ComparisonResult = several(
        path, methods, workers=workers, memory=memory, overrides=overrides, listener=listener
    )
    return found
