"""Synthetic surveys, and the quickstart that runs the whole chain on one."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from spl_batch.api.events import Listener, ignore
from spl_batch.api.pipeline import RunResult, run
from spl_batch.api.preparing import DEFAULT_MEMORY

if TYPE_CHECKING:
    from spl_batch.simulate.survey import SimulationSummary


def simulate(
    scene: Path | str, output: Path | str, *, progress: Callable[[float], None] | None = None
) -> "SimulationSummary":
    """Fly a synthetic survey.

    Parameters
    ----------
    scene : Path or str
        Scene file.
    output : Path or str
        Folder to write to: flightlines, trajectory, reference, truth, workflow.
    progress : callable, optional
        Told the share that is done, 0..1.
    """
    # The simulator's kernels load slowly, and a run has no use for them.
    from spl_batch.simulate import load_scene  # noqa: PLC0415
    from spl_batch.simulate import simulate as fly  # noqa: PLC0415

    return fly(load_scene(Path(scene)), Path(output), progress=progress)


def quickstart(
    output: Path | str = "spl-quickstart",
    *,
    workers: int = 2,
    memory: str | int = DEFAULT_MEMORY,
    progress: Callable[[float], None] | None = None,
    listener: Listener = ignore,
) -> RunResult:
    """Simulate a small survey and run the whole chain on it.

    Parameters
    ----------
    output : Path or str
        Folder; a survey that is there already is used again.
    workers : int
        Worker processes [count].
    memory : str or int
        Memory limit of a worker [byte].
    progress : callable, optional
        Told the share of the simulation that is done, 0..1.
    listener : callable
        Told what happens in the run.
    """
    folder = Path(output)
    workflow = folder / "workflow.yaml"
    if not workflow.exists():
        preset = resources.files("spl_batch.simulate").joinpath("scenes/quickstart.yaml")
        with resources.as_file(preset) as scene:
            simulate(scene, folder, progress=progress)
    return run(workflow, workers=workers, memory=memory, listener=listener)
