"""Kinds of task of the water surface."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.engine.tasks.runner import Kind

_TASKS: Final = "spl_batch.geiger.water.tasks.surfaces"
_DELIVERY: Final = "spl_batch.geiger.water.tasks.delivery"

_SURFACE: Final = ("camera", "pixels", "mount", "surface", "path", "level")

KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "count_frames": Kind(
            "index", f"{_TASKS}:count_frames", ("camera.rows", "camera.cols", "camera.bins", "gate")
        ),
        "calibrate": Kind(
            "calibrate", f"{_TASKS}:calibrate", ("camera", "pixels", "calibration", "mount")
        ),
        "make_surfaces": Kind("surfaces", f"{_TASKS}:make_surfaces", _SURFACE),
        "deliver_points": Kind("deliver", f"{_DELIVERY}:deliver_points", _SURFACE),
        "deliver_rasters": Kind(
            "deliver",
            f"{_DELIVERY}:deliver_rasters",
            ("outputs.cell_m", "outputs.each_acquisition", "survey.origin_m"),
        ),
    }
)
"""What the tasks do."""
