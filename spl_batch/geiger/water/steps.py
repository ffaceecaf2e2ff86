"""Steps of the water surface, in the order in which they are done."""

from typing import Any, Final

from spl_batch.engine.tasks.step import Step, Steps, table

_HOME: Final = "spl_batch.geiger.water"
_SURFACE: Final = ("camera", "pixels", "mount", "surface", "path", "level")


def _step(name: str, **options: Any) -> Step:
    """A step whose functions have its name."""
    return Step(name=name, run=f"{_HOME}.tasks:{name}", tasks=f"{_HOME}.receiver:{name}", **options)


STEPS: Final[Steps] = table(
    _step(
        "count_frames",
        stage="index",
        after=(),
        settings=("camera.rows", "camera.cols", "camera.bins", "gate"),
        unit="file",
    ),
    _step(
        "calibrate",
        stage="calibrate",
        after=("count_frames",),
        settings=("camera", "pixels", "calibration", "mount"),
    ),
    _step(
        "make_surfaces",
        stage="surfaces",
        after=("calibrate",),
        settings=_SURFACE,
        unit="acquisitions",
        remedy="store frames in smaller chunks",
    ),
    _step(
        "deliver_file",
        stage="deliver",
        after=("make_surfaces",),
        settings=(*_SURFACE, "outputs.cell_m", "outputs.each_acquisition", "survey.origin_m"),
        unit="file",
        delivers=True,
    ),
)
"""What is done, in the order in which it is done."""
