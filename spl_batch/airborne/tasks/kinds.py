"""Stages and kinds of task of an airborne survey.

:data:`KINDS` says for each kind of task which function does it, to which stage of the
command line it belongs, and on which parts of the workflow its result depends.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.airborne.settings import AfterpulseSettings, NoiseSettings
from spl_batch.engine.tasks.runner import Kind

STAGES: Final = (
    "index",
    "shots",
    "shuffle",
    "denoise",
    "ground",
    "surfaces",
    "deliver",
    "report",
)
"""Stages of an airborne survey's run, in order."""


_INDEXED: Final = ("survey.channel_dimension", "survey.gap_s")


_OBSERVED: Final = (
    *(f"noise.{key}" for key in NoiseSettings.model_fields if key != "haze"),
    *("acquisition", "survey.sensor"),
)
"""Haze is looked for in the space domain."""


_TIME: Final = (
    *_OBSERVED,
    *(f"afterpulse.{key}" for key in AfterpulseSettings.model_fields if key != "vegetation_loss"),
)
"""How many returns may go with the afterpulses is decided later, in the space domain."""


KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "trajectory_file": Kind(
            "index", "spl_batch.airborne.tasks.index:look_through", ("survey.trajectory_crs",)
        ),
        "index_part": Kind("index", "spl_batch.airborne.tasks.index:index_part", _INDEXED),
        "index_file": Kind("index", "spl_batch.airborne.tasks.index:index_file", _INDEXED),
        "trajectory": Kind(
            "index",
            "spl_batch.airborne.tasks.index:gather_trajectory",
            ("survey.trajectory_crs",),
        ),
        "heading": Kind("shots", "spl_batch.airborne.tasks.index:find_heading", ()),
        "gather": Kind("shots", "spl_batch.airborne.tasks.time_domain:gather", _OBSERVED),
        "gather_range": Kind(
            "shots",
            "spl_batch.airborne.tasks.time_domain:gather_range",
            ("survey.channel_dimension",),
        ),
        "sensor_path": Kind("shots", "spl_batch.airborne.tasks.lines_of_sight:find_path", ()),
        "observe": Kind("shots", "spl_batch.airborne.tasks.lines_of_sight:observe", _OBSERVED),
        "fit_line": Kind("shots", "spl_batch.airborne.tasks.time_domain:fit_line", _TIME),
        "scatter": Kind(
            "shuffle",
            "spl_batch.airborne.tasks.time_domain:scatter",
            (*_TIME, "tiling.tile_m", "aoi", "water"),
        ),
        "build_tile": Kind("shuffle", "spl_batch.airborne.tasks.time_domain:build_tile", ()),
        "denoise": Kind(
            "denoise",
            "spl_batch.airborne.tasks.space_domain:denoise",
            ("filter", "noise", "afterpulse", "outputs.diagnostics"),
        ),
        "strip_patches": Kind("ground", "spl_batch.airborne.lines.comparison:strip_patches", ()),
        "strip_pairs": Kind(
            "ground", "spl_batch.airborne.lines.comparison:strip_pairs", ("survey.align",)
        ),
        "ground": Kind("ground", "spl_batch.airborne.tasks.space_domain:ground", ("ground",)),
        "surface": Kind(
            "surfaces",
            "spl_batch.airborne.tasks.surfaces:surface",
            ("ground.cell_m", "products", "classes", "aoi", "water", "breaklines"),
        ),
        "deliver_file": Kind(
            "deliver",
            "spl_batch.airborne.tasks.delivery:deliver_file",
            ("outputs.diagnostics", "outputs.classes", "classes.overlap", "classes.withheld"),
        ),
        "deliver_tile": Kind(
            "deliver",
            "spl_batch.airborne.tasks.delivery:deliver_tile",
            ("outputs.tiles", "outputs.classes", "classes.overlap", "classes.withheld"),
        ),
        "deliver_copc": Kind("deliver", "spl_batch.airborne.tasks.delivery:deliver_copc", ()),
        "deliver_hillshade": Kind(
            "deliver", "spl_batch.airborne.tasks.delivery:deliver_hillshade", ()
        ),
        "deliver_differences": Kind(
            "deliver", "spl_batch.airborne.tasks.delivery:deliver_differences", ()
        ),
        "deliver_geoid": Kind(
            "deliver", "spl_batch.airborne.tasks.delivery:deliver_geoid", ("outputs.geoid",)
        ),
        "mosaic": Kind(
            "deliver",
            "spl_batch.airborne.tasks.delivery:mosaic",
            ("ground.cell_m", "products.cell_m", "products.void_max_m", "aoi"),
        ),
        "reference": Kind("report", "spl_batch.airborne.tasks.reference:reference", ()),
        "accuracy": Kind(
            "report", "spl_batch.airborne.tasks.accuracy:accuracy", ("products.cell_m",)
        ),
        "checkpoints": Kind(
            "report",
            "spl_batch.airborne.tasks.checkpoints:checkpoints",
            ("reference.checkpoints_crs", "reference.checkpoints_accuracy_m"),
        ),
        # It lists everything that is delivered, the checkpoints too: so it comes last.
        "deliver_catalogue": Kind(
            "report", "spl_batch.airborne.tasks.delivery:deliver_catalogue", ("survey.name",)
        ),
    }
)
