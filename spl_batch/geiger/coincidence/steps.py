"""Steps of the coincidence processing, in the order in which they are done."""

from typing import Any, Final

from spl_batch.engine.tasks.step import Step, Steps, table

_HOME: Final = "spl_batch.geiger.coincidence"


def _step(name: str, **options: Any) -> Step:
    """A step whose functions have its name."""
    return Step(name=name, run=f"{_HOME}.tasks:{name}", tasks=f"{_HOME}.receiver:{name}", **options)


STEPS: Final[Steps] = table(
    _step("index_frames", stage="index", after=(), settings=("array",), unit="file"),
    _step(
        "index_file",
        stage="index",
        after=("index_frames",),
        settings=("array.rows", "array.columns", "tiling.tile_m"),
        unit="file",
    ),
    _step(
        "coincide_tile",
        stage="coincidence",
        after=("index_frames", "index_file"),
        settings=("array", "coincidence", "tiling.tile_m"),
        unit="tile",
        remedy="take a smaller tiling.tile_m or coincidence.volume_voxels",
    ),
    _step(
        "deliver_tile",
        stage="deliver",
        after=("coincide_tile",),
        settings=("outputs.aggregate_bit",),
        delivers=True,
    ),
)
"""The whole chain, in order."""
