"""Steps of the water surface, in the order in which they are done."""

from typing import Final

from spl_batch.engine.tasks.step import Step, Steps, table

_TASKS: Final = "spl_batch.geiger.water.tasks"
_SURFACE: Final = ("camera", "pixels", "mount", "surface", "path", "level")

STEPS: Final[Steps] = table(
    Step(
        name="count_frames",
        stage="index",
        run=f"{_TASKS}.surfaces:count_frames",
        tasks="spl_batch.geiger.water.plan:count_frames",
        after=(),
        settings=("camera.rows", "camera.cols", "camera.bins", "gate"),
        unit="file",
    ),
    Step(
        name="calibrate",
        stage="calibrate",
        run=f"{_TASKS}.surfaces:calibrate",
        tasks="spl_batch.geiger.water.plan:calibrate",
        after=("count_frames",),
        settings=("camera", "pixels", "calibration", "mount"),
    ),
    Step(
        name="make_surfaces",
        stage="surfaces",
        run=f"{_TASKS}.surfaces:make_surfaces",
        tasks="spl_batch.geiger.water.plan:make_surfaces",
        after=("calibrate",),
        settings=_SURFACE,
        unit="acquisitions",
        remedy="store frames in smaller chunks",
    ),
    Step(
        name="deliver_points",
        stage="deliver",
        run=f"{_TASKS}.delivery:deliver_points",
        tasks="spl_batch.geiger.water.plan:deliver_points",
        after=("make_surfaces",),
        settings=_SURFACE,
        unit="file",
        delivers=True,
    ),
    Step(
        name="deliver_rasters",
        stage="deliver",
        run=f"{_TASKS}.delivery:deliver_rasters",
        tasks="spl_batch.geiger.water.plan:deliver_rasters",
        after=("make_surfaces",),
        settings=("outputs.cell_m", "outputs.each_acquisition", "survey.origin_m"),
        unit="file",
        delivers=True,
    ),
)
"""What is done, in the order in which it is done."""
