"""Everything that is settled before work starts: settings, inputs, limits."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import WorkflowError
from spl_batch.plan.inputs import gather_inputs
from spl_batch.plan.survey import Survey
from spl_batch.runner import code_version
from spl_batch.runner.context import Context
from spl_batch.tiling import quanta
from spl_batch.workflow import Workflow, load_workflow

DEFAULT_MEMORY = "4GiB"
"""Memory limit of a worker unless told otherwise."""

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
_BINARY = {"k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40}


@dataclass(frozen=True, slots=True)
class Prepared:
    """A run that could start."""

    survey: Survey
    context: Context


def prepare(
    path: Path, overrides: Sequence[str], *, memory: str | int = DEFAULT_MEMORY, workers: int = 2
) -> Prepared:
    """Read the workflow and the headers of its files.

    Parameters
    ----------
    path : Path
        Workflow file.
    overrides : sequence of str
        ``key.path=value``.
    memory : str or int
        Memory limit of a worker [byte].
    workers : int
        Worker processes [count].

    Raises
    ------
    WorkflowError
        If the workflow or a limit is wrong, or no input is usable.
    """
    limit = parse_bytes(memory)
    if workers < 0:
        raise WorkflowError(f"--workers {workers}: write 0 (in this process) or more")
    workflow = load_workflow(path, overrides)
    base = path.resolve().parent
    output = (base / workflow.output).resolve()
    _check_cells(workflow, path)
    inputs = gather_inputs(workflow, base, output)
    if not inputs.sources:
        raise WorkflowError("no input is usable: " + "; ".join(str(b) for b in inputs.bad))
    crs_wkt = inputs.crs.to_wkt() if inputs.crs is not None else ""
    context = Context(workflow, base, output, crs_wkt, code_version())
    context.store.root  # noqa: B018 - a store that cannot be used is a fault found here
    return Prepared(Survey(inputs, workflow, limit, max(workers, 1)), context)


def parse_bytes(text: str | int) -> int:
    """Size such as ``4GiB``, ``500 MB`` or ``2000000000`` [byte].

    Raises
    ------
    WorkflowError
        If it is no size, or less than 256 MiB.
    """
    pattern = r"\s*(\d+(?:\.\d+)?)\s*(?:([kmgt])(i?)b?|b?)\s*"
    match = re.fullmatch(pattern, str(text).lower())
    if match is None:
        raise WorkflowError(f"--memory {text}: write a size such as 4GiB")
    number, prefix, binary = match.groups()
    size = int(float(number) * (_BINARY if binary else _UNITS)[prefix or ""])
    if size < 2**28:
        raise WorkflowError(f"--memory {text}: a worker needs 256 MiB at least")
    return size


def _check_cells(workflow: Workflow, path: Path) -> None:
    """Edges are whole millimetres, and raster cells fill a ground cell."""
    edges = {
        "tiling.tile_m": workflow.tiling.tile_m,
        "ground.cell_m": workflow.ground.cell_m,
        "products.cell_m": workflow.products.cell_m,
        "noise.voxel_m": workflow.noise.voxel_m,
    }
    faults = [
        f"{key}: {edge:g} is not a whole number of millimetres"
        for key, edge in edges.items()
        if quanta(edge) < 1 or abs(edge * QUANTA_PER_M - quanta(edge)) > 1e-6
    ]
    if not faults and quanta(workflow.ground.cell_m) % quanta(workflow.products.cell_m):
        faults.append(
            f"ground.cell_m ({workflow.ground.cell_m:g}) must be a whole multiple of "
            f"products.cell_m ({workflow.products.cell_m:g})"
        )
    if faults:
        raise WorkflowError(f"{path}: {'; '.join(faults)}")
