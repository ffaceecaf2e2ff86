"""The quickstart: simulate a small airborne survey and run the whole chain on it."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Final

from spl_batch.airborne.plan.task_memory import task_bytes
from spl_batch.airborne.precompile import compiling
from spl_batch.engine.plan.budget import Cost, refuse_too_large
from spl_batch.engine.verbs.planning import limit_bytes
from spl_batch.engine.verbs.running import RunResult, run
from spl_batch.engine.verbs.simulation import simulate
from spl_batch.engine.watch.events import Listener, ignore

_POINTS: Final = 1_789_819
"""Points of the survey [count]; they lie in one ground cell, the heaviest task."""

_COST: Final = Cost(
    points=_POINTS,
    tasks=52,
    disk_bytes=135 * 2**20,
    memory_bytes=task_bytes("ground", _POINTS),
    heaviest="a ground cell of the quickstart",
    remedy="",
    stages_s={},
    workers=1,
    measured=False,
)
"""What the survey takes of a worker that has little memory, as its plan estimates."""


def quickstart(
    output: Path | str = "spl-quickstart",
    *,
    workers: int = 2,
    memory: str | int | None = None,
    progress: Callable[[float], None] | None = None,
    listener: Listener = ignore,
) -> RunResult:
    """Simulate a small survey and run the whole chain on it.

    Parameters
    ----------
    output : Path or str
        Folder; the survey that an earlier quickstart made there is used again.
    memory : str or int, optional
        Memory limit of a worker [byte]; a share of the machine's by default.
    progress : callable, optional
        Told the share of the simulation that is done, 0..1.

    Raises
    ------
    WorkflowError
        If the folder holds anything that no simulation made.
    PlanError
        If a worker has less memory than the survey takes; nothing is simulated then.
    """
    limit = limit_bytes(memory, workers)
    refuse_too_large(_COST, limit)
    folder = Path(output)
    workflow = folder / "workflow.yaml"
    if workflow.exists():
        return run(workflow, workers=workers, memory=memory, listener=listener)
    preset = resources.files("spl_batch.airborne").joinpath("simulate/presets/quickstart.yaml")
    # The simulation takes one processor, and workers start for seconds.
    with compiling(max(workers, 1)).beside():
        with resources.as_file(preset) as scene:
            simulate(scene, folder, progress=progress)
        return run(workflow, workers=workers, memory=memory, listener=listener)
