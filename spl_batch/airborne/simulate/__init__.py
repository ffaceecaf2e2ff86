"""Synthetic surveys with point-level truth [W17 ch. 2].

Importing this package is cheap: numba, laspy and rasterio are loaded with the first scene.
"""

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spl_batch.airborne.simulate.scene.scene_file import Scene
    from spl_batch.airborne.simulate.survey import SimulationSummary

__all__ = ["load_scene", "preset_scene", "preset_scenes", "simulate", "simulate_file"]


def load_scene(path: Path) -> "Scene":
    """Read a scene file; see :func:`spl_batch.airborne.simulate.scene.scene_file.load_scene`."""
    from spl_batch.airborne.simulate.scene import scene_file  # noqa: PLC0415 - keeps the import cheap

    return scene_file.load_scene(path)


def preset_scenes() -> list[str]:
    """Names of the scenes that ship with the project, sorted."""
    folder = resources.files("spl_batch.airborne.simulate") / "presets"
    return sorted(
        p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")
    )


def preset_scene(name: str) -> "Scene":
    """Scene by preset name.

    ``name``: one of :func:`preset_scenes`.

    Raises
    ------
    WorkflowError
        If there is no such preset.
    """
    from spl_batch.errors import WorkflowError  # noqa: PLC0415 - keeps the import cheap

    known = preset_scenes()
    if name not in known:
        raise WorkflowError(f"no scene {name!r}; known are {', '.join(known)}")
    with resources.as_file(
        resources.files("spl_batch.airborne.simulate") / "presets" / f"{name}.yaml"
    ) as p:
        return load_scene(p)


def simulate_file(
    scene: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> "SimulationSummary":
    """Simulate the survey of a scene file; see :func:`simulate`."""
    return simulate(load_scene(scene), out, progress=progress)


def simulate(
    scene: "Scene", out: Path, *, progress: Callable[[float], None] | None = None
) -> "SimulationSummary":
    """Simulate a survey; see :func:`spl_batch.airborne.simulate.survey.simulate`."""
    from spl_batch.airborne.simulate import survey  # noqa: PLC0415 - keeps the import cheap

    return survey.simulate(scene, out, progress=progress)
