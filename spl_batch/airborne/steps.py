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


def _step(stage: str, run: str, tasks: str, name: str, **options: Any) -> Step:
    """A step whose task, and what makes its tasks, are functions of its name.

    ``run``: module of the first, with the function where it has another name; ``tasks``: of the
    second, below ``plan``.
    """
    place = f"{_HOME}.{run}" if ":" in run else f"{_HOME}.{run}:{name}"
    return Step(name=name, stage=stage, run=place, tasks=f"{_HOME}.plan.{tasks}:{name}", **options)


_SHUFFLED: Final = ("build_tile", "align")
"""What the space domain is planned from: its points by tile, and whether flightlines are moved."""

# Stage, where tasks are done, and where they are planned.
_index = partial(_step, "index", "tasks.index", "time_tasks")
_shots = partial(_step, "shots", "tasks.time_domain", "time_tasks")
_scatter = partial(_step, "shuffle", "tasks.time_domain", "time_tasks")
_tiles = partial(_step, "shuffle", "tasks.time_domain", "space_tasks", unit="tile")
_denoise = partial(_step, "denoise", "tasks.space_domain", "space_tasks", unit="cell")
_ground = partial(_step, "ground", "tasks.space_domain", "space_tasks", unit="ground cell")
_align = partial(_step, "ground", "lines.comparison", "space_tasks")
_surface = partial(_step, "surfaces", "tasks.surfaces", "space_tasks", unit="ground cell")
_pairs = partial(_step, "surfaces", "lines.comparison", "space_tasks")
_delivery = partial(_step, "deliver", "tasks.delivery", "delivery_tasks", delivers=True)
_client = partial(_step, "deliver", "tasks.client_tiles", "delivery_tasks", delivers=True)
_reference = partial(_step, "report", "tasks.reference", "reference_tasks")
_accuracy = partial(_step, "report", "tasks.accuracy", "reference_tasks")
_catalogue = partial(_step, "report", "tasks.delivery", "delivery_tasks", delivers=True)

STEPS: Final[Steps] = table(
    _index("trajectory_file", settings=("survey.trajectory_crs",), after=()),
    _index("index_part", settings=_INDEXED, after=()),
    _index("index_file", settings=_INDEXED, unit="file", after=("index_part",)),
    _index(
        "trajectory",
        settings=("survey.trajectory_crs",),
        after=("trajectory_file", "index_file"),
    ),
    _shots("sights", settings=_OBSERVED, unit="stretch"),
    _shots("sensor_path"),
    _shots("observe", settings=_OBSERVED, unit="stretch"),
    _shots("fit_line", settings=_TIME, unit="flightline"),
    _scatter(
        "scatter",
        settings=(*_TIME, "tiling.tile_m", "aoi", "water", "products.intensity"),
        unit="stretch",
        bytes_per_point=540,
    ),
    _tiles("build_tile", bytes_per_point=280, remedy="lower tiling.tile_m"),
    _denoise(
        "denoise",
        settings=("filter", "noise", "afterpulse", "outputs.diagnostics"),
        bytes_per_point=150,
        remedy="lower tiling.tile_m",
        after=("build_tile",),
    ),
    _align(
        "strip_patches",
        unit="ground cell",
        bytes_per_point=80,
        remedy="lower ground.cell_m",
        after=("build_tile",),
        bind=_LABELLED,
    ),
    _align("align", settings=("survey.align",), after=("strip_patches",)),
    _ground(
        "ground",
        settings=("ground",),
        bytes_per_point=215,
        remedy="lower ground.cell_m or ground.buffer_m",
        after=_SHUFFLED,
        bind=_LABELLED,
    ),
    _surface(
        "surface",
        settings=(
            *("ground.cell_m", "products", "classes"),
            *("aoi", "water", "breaklines", "survey.sensor"),
        ),
        bytes_per_point=225,
        remedy="lower ground.cell_m or products.void_max_m",
        after=_SHUFFLED,
        bind=f"{_HOME}.store.label_tables:on_ground",
    ),
    _pairs("strip_pairs", after=("strip_patches", "align"), bind=_LABELLED),
    _delivery(
        "deliver_file",
        settings=("outputs.diagnostics", *_CLASSES),
        after=_SHUFFLED,
        bind=_LABELLED,
    ),
    _delivery(
        "deliver_tile",
        settings=("outputs.tiles", *_CLASSES),
        bytes_per_point=280,
        after=_SHUFFLED,
        bind=_LABELLED,
    ),
    _delivery(
        "mosaic",
        settings=("ground.cell_m", "products.cell_m", "products.void_max_m", "aoi"),
        after=("surface",),
    ),
    _reference("reference", after=("surface",)),
    _delivery(
        "deliver_copc",
        unit="file",
        bytes_per_point=280,
        remedy="set outputs.copc: false, and outputs.tiles: copc for octrees by tile",
        after=("deliver_file",),
    ),
    _delivery("deliver_geoid", settings=("outputs.geoid",), after=("mosaic",)),
    _client(
        "reproject_file",
        settings=("outputs.crs", "outputs.units"),
        unit="file",
        after=("deliver_file",),
    ),
    _client(
        "reproject_raster",
        settings=("outputs.crs", "outputs.units", "outputs.cell", "products.cell_m"),
        after=("mosaic",),
    ),
    _client("deliver_contours", after=("mosaic",)),
    _client(
        "deliver_client_tile",
        settings=("outputs.client_tiles.format", "outputs.units"),
        unit="client's tile",
        bytes_per_point=280,
        remedy="set outputs.client_tiles.format: laz",
        after=(
            *("deliver_file", "mosaic", "deliver_geoid", "align"),
            *("reproject_file", "reproject_raster"),
        ),
    ),
    _accuracy(
        "accuracy",
        settings=("products.cell_m",),
        unit="square of the reference",
        bytes_per_point=300,
        remedy="cut the reference into files that fill their bounding boxes evenly",
        after=("reference", "mosaic"),
        bind=_LABELLED,
    ),
    _reference(
        "checkpoints",
        settings=("reference.checkpoints_crs", "reference.checkpoints_accuracy_m"),
        unit="file",
        after=("mosaic",),
    ),
    # It lists everything that is delivered, the checkpoints too: so it comes last.
    _catalogue(
        "deliver_catalogue",
        settings=tuple(f"survey.{key}" for key in ("name", "organisation", "contact", "licence")),
    ),
)
"""What an airborne survey's tasks do."""
