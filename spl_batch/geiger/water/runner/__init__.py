"""What the tasks of the water surface do."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.geiger.water.runner.delivery import deliver_points, deliver_rasters
from spl_batch.geiger.water.runner.tasks import calibrate, count_frames, make_surfaces
from spl_batch.runner import Kind

_SURFACE: Final = ("camera", "pixels", "mount", "surface", "path", "level")

KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "count_frames": Kind(
            "index", count_frames, ("camera.rows", "camera.cols", "camera.bins", "gate")
        ),
        "calibrate": Kind("calibrate", calibrate, ("camera", "pixels", "calibration", "mount")),
        "make_surfaces": Kind("surfaces", make_surfaces, _SURFACE),
        "deliver_points": Kind("deliver", deliver_points, _SURFACE),
        "deliver_rasters": Kind(
            "deliver",
            deliver_rasters,
            ("outputs.cell_m", "outputs.each_acquisition", "survey.origin_m"),
        ),
    }
)
"""What the tasks do."""
