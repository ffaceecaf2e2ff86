"""Synthetic data of any receiver."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import yaml
from pydantic import BaseModel

from spl_batch.engine.settings.mistaken_file import refuse_urls
from spl_batch.engine.settings.workflow_file import known_kind, read_mapping, validated
from spl_batch.errors import WorkflowError, grouped, named
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.receivers import IMAGING, simulator

SIMULATED: Final = ".simulated"
"""Mark of a folder that a simulation may write into again."""


class Simulated(NamedTuple):
    """What was made."""

    workflow: Path  #: Ready to run.
    rows: list[tuple[str, str]]  #: Label and value of each number that the console shows.


M = TypeVar("M", bound=BaseModel)


def scene_of(model: type[M], path: Path) -> M:
    """The scene of a file, checked."""
    content = read_mapping(path, "a scene is a mapping with kind: and what there is")
    return validated(model, content, str(path))


def finished(out: Path, workflow: Mapping[str, Any], counts: Mapping[str, int]) -> Simulated:
    """Write the workflow of what was made, and count what there is of each kind [count]."""
    path = out / "workflow.yaml"
    write_bytes(path, yaml.safe_dump(dict(workflow), sort_keys=False).encode())
    return Simulated(path, [(name, grouped(count)) for name, count in counts.items()])


def simulate(
    scene: Path | str, output: Path | str, *, progress: Callable[[float], None] | None = None
) -> Any:
    """Make synthetic data with truth: fly a survey, for instance.

    Parameters
    ----------
    scene : Path or str
        Scene file; its ``kind`` names the receiver, an airborne survey where it has none.
    output : Path or str
        Folder to write to; a workflow is among what is written.
    progress : callable, optional
        Called with the share that is done, 0..1.

    Returns
    -------
    object
        What was made, as the receiver's simulator gives it; its ``rows`` are for a console.

    Raises
    ------
    WorkflowError
        If the scene has a fault, or is a workflow; if the folder holds anything that no
        simulation made.
    """
    content = read_mapping(Path(scene), "a scene is a mapping with extent_m: and flights:")
    if "output" in content:
        raise WorkflowError(f"{scene}: this is a workflow, not a scene; `spl-batch run` is for it")
    kind = known_kind(content, str(scene)) if "kind" in content else IMAGING
    refuse_urls(output)
    folder, own = Path(output), Path(scene).resolve()
    if folder.exists() and not folder.is_dir():
        raise WorkflowError(f"{folder} is a file; name a folder")
    there = [path.name for path in sorted(folder.glob("*")) if path.resolve() != own]
    if there and not (folder / SIMULATED).exists():
        raise WorkflowError(f"{folder} holds {named(there, 3)}; name another folder, or empty it")
    write_bytes(folder / SIMULATED, b"")
    if progress is not None:
        progress(0.0)
    return simulator(kind)(Path(scene), folder, progress=progress)
