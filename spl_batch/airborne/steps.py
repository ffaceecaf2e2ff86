"""Steps of an airborne survey, in the order in which they are done."""

from functools import partial
from typing import Any, Final

from spl_batch.airborne.settings import AfterpulseSettings, NoiseSettings
from spl_batch.engine.tasks.step import Step, Steps, table

_INDEXED: Final = ("survey.channel_dimension", "survey.gap_s")

_OBSERVED: Final = (
    *(f"noise.{key}" for key in NoiseSettings.model_fields if key != "haze"),
    *("acquisition", "survey.sensor", "survey.channel_dimension"),
)
"""Haze is looked for in the space domain."""

_TIME: Final = (
    *_OBSERVED,
    *(f"afterpulse.{key}" for key in AfterpulseSettings.model_fields if key != "vegetation_loss"),
)
"""How many returns may go with the afterpulses is decided later, in the space domain."""

_CLASSES: Final = (
    *("outputs.classes", "classes.overlap", "classes.withheld"),
    *("outputs.drop", "outputs.height_above_ground"),
)


_HOME: Final = "spl_batch.airborne"

_LABELLED: Final = f"{_HOME}.store.label_tables:labelled"
"""A task has the labels of what is finished, and goes without those of what has failed."""


def _step(name: str, stage: str, run: str, *, tasks: str, **options: Any) -> Step:
    """A step whose places begin where they do here."""
    return Step(
        name=name,
        stage=stage,
        run=f"{_HOME}.{run}",
        tasks=f"{_HOME}.plan.{tasks}",
        **options,
    )


_SHUFFLED: Final = ("build_tile", "align")
"""What the space domain is planned from: its points by tile, and whether flightlines are moved."""

_cell = partial(_step, unit="ground cell")
_patches = partial(
    _cell,
    stage="ground",
    run="lines.comparison:strip_patches",
    bytes_per_point=80,
    remedy="lower ground.cell_m",
    bind=_LABELLED,
)
_delivery = partial(_step, stage="deliver", delivers=True)

STEPS: Final[Steps] = table(
    _step(
        "trajectory_file",
        "index",
        "tasks.index:look_through",
        tasks="time_tasks:trajectory_file",
        settings=("survey.trajectory_crs",),
        after=(),
    ),
    _step(
        "index_part",
        "index",
        "tasks.index:index_part",
        tasks="time_tasks:index_part",
        settings=_INDEXED,
        bytes_per_point=300,
        after=(),
    ),
    _step(
        "index_file",
        "index",
        "tasks.index:index_file",
        tasks="time_tasks:index_file",
        settings=_INDEXED,
        unit="file",
        after=("index_part",),
    ),
    _step(
        "trajectory",
        "index",
        "tasks.index:gather_trajectory",
        tasks="time_tasks:trajectory",
        settings=("survey.trajectory_crs",),
        after=("trajectory_file", "index_file"),
    ),
    _step(
        "sights",
        "shots",
        "tasks.lines_of_sight:collect",
        tasks="time_tasks:sights",
        settings=_OBSERVED,
        unit="stretch",
        bytes_per_point=380,
    ),
    _step("sensor_path", "shots", "tasks.lines_of_sight:find_path", tasks="time_tasks:sensor_path"),
    _step(
        "observe",
        "shots",
        "tasks.lines_of_sight:observe",
        tasks="time_tasks:observe",
        settings=_OBSERVED,
        unit="stretch",
        bytes_per_point=380,
    ),
    _step(
        "fit_line",
        "shots",
        "tasks.time_domain:fit_line",
        tasks="time_tasks:fit_line",
        settings=_TIME,
        unit="flightline",
    ),
    _step(
        "scatter",
        "shuffle",
        "tasks.time_domain:scatter",
        tasks="time_tasks:scatter",
        settings=(*_TIME, "tiling.tile_m", "aoi", "water"),
        unit="stretch",
        bytes_per_point=540,
    ),
    _step(
        "build_tile",
        "shuffle",
        "tasks.time_domain:build_tile",
        tasks="space_tasks:build",
        unit="tile",
        bytes_per_point=280,
        remedy="lower tiling.tile_m",
    ),
    _step(
        "denoise",
        "denoise",
        "tasks.space_domain:denoise",
        tasks="space_tasks:denoise",
        settings=("filter", "noise", "afterpulse", "outputs.diagnostics"),
        unit="cell",
        bytes_per_point=150,
        remedy="lower tiling.tile_m",
        after=("build_tile",),
    ),
    _patches("recorded_patches", tasks="strip_tasks:recorded_patches", after=("build_tile",)),
    _step(
        "align",
        "ground",
        "lines.comparison:align",
        tasks="strip_tasks:align",
        settings=("survey.align",),
        after=("recorded_patches",),
    ),
    _cell(
        "ground",
        "ground",
        "tasks.space_domain:ground",
        tasks="space_tasks:ground",
        settings=("ground",),
        bytes_per_point=215,
        remedy="lower ground.cell_m or ground.buffer_m",
        after=_SHUFFLED,
        bind=_LABELLED,
    ),
    _patches("strip_patches", tasks="strip_tasks:patches", after=_SHUFFLED),
    _cell(
        "surface",
        "surfaces",
        "tasks.surfaces:surface",
        tasks="space_tasks:surface",
        settings=(
            "ground.cell_m",
            "products",
            "classes",
            "aoi",
            "water",
            "breaklines",
            "survey.sensor",
        ),
        bytes_per_point=225,
        remedy="lower ground.cell_m or products.void_max_m",
        after=_SHUFFLED,
        bind=f"{_HOME}.store.label_tables:on_ground",
    ),
    _step(
        "strip_pairs",
        "surfaces",
        "lines.comparison:strip_pairs",
        tasks="strip_tasks:pairs",
        after=("strip_patches", "align"),
        bind=_LABELLED,
    ),
    _delivery(
        "deliver_file",
        run="tasks.delivery:deliver_file",
        tasks="space_tasks:deliver",
        settings=("outputs.diagnostics", *_CLASSES),
        after=_SHUFFLED,
        bind=_LABELLED,
    ),
    _delivery(
        "deliver_tile",
        run="tasks.delivery:deliver_tile",
        tasks="space_tasks:deliver_tiles",
        settings=("outputs.tiles", *_CLASSES),
        bytes_per_point=280,
        after=_SHUFFLED,
        bind=_LABELLED,
    ),
    _delivery(
        "mosaic",
        run="tasks.delivery:mosaic",
        tasks="space_tasks:mosaic",
        settings=("ground.cell_m", "products.cell_m", "products.void_max_m", "aoi"),
        after=("surface",),
    ),
    _step(
        "reference",
        "report",
        "tasks.reference:reference",
        tasks="reference_tasks:reference",
        after=("surface",),
    ),
    _delivery(
        "deliver_copc",
        run="tasks.delivery:deliver_copc",
        tasks="space_tasks:deliver_copc",
        unit="file",
        bytes_per_point=280,
        remedy="set outputs.copc: false, and outputs.tiles: copc for octrees by tile",
        after=("deliver_file",),
    ),
    _delivery(
        "deliver_geoid",
        run="tasks.delivery:deliver_geoid",
        tasks="space_tasks:geoid",
        settings=("outputs.geoid",),
        after=("mosaic",),
    ),
    _delivery(
        "reproject_file",
        run="tasks.client_tiles:reproject_file",
        tasks="client_tasks:reprojected_files",
        settings=("outputs.crs", "outputs.units"),
        unit="file",
        after=("deliver_file",),
    ),
    _delivery(
        "reproject_raster",
        run="tasks.client_tiles:reproject_raster",
        tasks="client_tasks:reprojected_rasters",
        settings=("outputs.crs", "outputs.units", "outputs.cell", "products.cell_m"),
        after=("mosaic",),
    ),
    _delivery(
        "deliver_contours",
        run="tasks.client_tiles:deliver_contours",
        tasks="client_tasks:contours",
        after=("mosaic",),
    ),
    _delivery(
        "deliver_client_tile",
        run="tasks.client_tiles:deliver_client_tile",
        tasks="client_tasks:client_tiles",
        settings=("outputs.client_tiles.format", "outputs.units"),
        unit="client's tile",
        bytes_per_point=280,
        remedy="set outputs.client_tiles.format: laz",
        after=(
            "deliver_file",
            "mosaic",
            "deliver_geoid",
            "align",
            "reproject_file",
            "reproject_raster",
        ),
    ),
    _step(
        "accuracy",
        "report",
        "tasks.accuracy:accuracy",
        tasks="reference_tasks:accuracy",
        settings=("products.cell_m",),
        unit="square of the reference",
        bytes_per_point=300,
        remedy="cut the reference into files that fill their bounding boxes evenly",
        after=("reference", "mosaic"),
        bind=_LABELLED,
    ),
    _step(
        "checkpoints",
        "report",
        "tasks.checkpoints:checkpoints",
        tasks="reference_tasks:checkpoints",
        settings=("reference.checkpoints_crs", "reference.checkpoints_accuracy_m"),
        unit="file",
        after=("mosaic",),
    ),
    # It lists everything that is delivered, the checkpoints too: so it comes last.
    _step(
        "deliver_catalogue",
        "report",
        "tasks.delivery:deliver_catalogue",
        tasks="space_tasks:catalogue",
        settings=tuple(f"survey.{key}" for key in ("name", "organisation", "contact", "licence")),
        delivers=True,
    ),
)
"""What an airborne survey's tasks do."""
