"""Frames of simulated surfaces with their truth; importing this package is cheap."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spl_batch.geiger.water.simulate.files import WaterSummary

__all__ = ["simulate_file"]


def simulate_file(
    scene: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> "WaterSummary":
    """Simulate a scene file; see :func:`spl_batch.geiger.water.simulate.files.simulate`."""
    from spl_batch.geiger.water.simulate import files  # noqa: PLC0415
    from spl_batch.geiger.water.simulate.scene import load_scene  # noqa: PLC0415

    return files.simulate(load_scene(scene), out, progress=progress)
