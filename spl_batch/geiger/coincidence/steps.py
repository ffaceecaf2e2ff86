"""Steps of the coincidence processing, in the order in which they are done."""

from typing import Final

from spl_batch.engine.tasks.step import Step, Steps, table

_TASKS: Final = "spl_batch.geiger.coincidence.tasks"

STEPS: Final[Steps] = table(
    Step(
        name="frames",
        stage="index",
        run=f"{_TASKS}:index_frames",
        tasks="spl_batch.geiger.coincidence.plan:frames",
        after=(),
        settings=("array",),
        unit="file",
    ),
    Step(
        name="index_file",
        stage="index",
        run=f"{_TASKS}:index_file",
        tasks="spl_batch.geiger.coincidence.plan:index_file",
        after=("frames",),
        settings=("array.rows", "array.columns", "tiling.tile_m"),
        unit="file",
    ),
    Step(
        name="coincide",
        stage="coincidence",
        run=f"{_TASKS}:coincide_tile",
        tasks="spl_batch.geiger.coincidence.plan:coincide",
        after=("frames", "index_file"),
        settings=("array", "coincidence", "tiling.tile_m"),
        unit="tile",
        remedy="take a smaller tiling.tile_m or coincidence.volume_voxels",
    ),
    Step(
        name="deliver_tile",
        stage="deliver",
        run=f"{_TASKS}:deliver_tile",
        tasks="spl_batch.geiger.coincidence.plan:deliver_tile",
        after=("coincide",),
        settings=("outputs.aggregate_bit",),
        delivers=True,
    ),
)
"""The whole chain, in order."""
