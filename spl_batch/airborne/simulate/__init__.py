"""Synthetic surveys with point-level truth [W17 ch. 2]."""

from collections.abc import Callable
from pathlib import Path

from spl_batch.airborne.simulate.scene.scene_file import load_scene, preset_scene
from spl_batch.airborne.simulate.survey import simulate
from spl_batch.engine.verbs.simulation import Simulated

__all__ = ["load_scene", "preset_scene", "simulate", "simulate_file"]


def simulate_file(
    scene: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Simulate the survey of a scene file; see :func:`simulate`."""
    return simulate(load_scene(scene), out, progress=progress)
