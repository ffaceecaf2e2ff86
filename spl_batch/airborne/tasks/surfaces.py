"""Stage ``surfaces``: raster cells and final classes of a ground cell, and its noise.

Points are read once; four looks at them follow each other, each with the columns and the returns
that it needs.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.classes import point_classes
from spl_batch.airborne.classes.buildings import REACH_M, Floor, buildings
from spl_batch.airborne.context import Context
from spl_batch.airborne.diagnostics import air_fill
from spl_batch.airborne.diagnostics.terrain_sigma import terrain_facts
from spl_batch.airborne.hydro.flattening import Banks, flatten, water_heights
from spl_batch.airborne.products import surface_points
from spl_batch.airborne.products import surface_rasters as surfacing
from spl_batch.airborne.products.cell_values import cell_number, north_up, shape_of
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart
from spl_batch.airborne.pulses.first_returns import first_returns
from spl_batch.airborne.pulses.swaths import Swaths
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.label_tables import Cell, write_labels
from spl_batch.airborne.store.raster_cells import write_cell
from spl_batch.airborne.tasks import pulses
from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    FLAG_OVERLAP,
    FLAG_WITHHELD,
    NODATA,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
)
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.spare_memory import give_back
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.tables import EXCLUDED, PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta

Rasters = dict[str, NDArray[np.float32]]


def surface(args: Mapping[str, Any], context: Context) -> Produced:
    """Raster cells and final classes of a ground cell."""
    workflow, cell = context.workflow, Cell.of(args, context)
    core = cell.core
    cell = cell.holding(grow(core, args["halo"]), _columns(cell))
    reflected = {} if args["fired"] is None else _reflectance(cell)
    give_back()
    arrays = _surfaces(cell)
    arrays |= reflected
    banks = _flatten(arrays, core, context)
    if workflow.aoi is not None:
        _mask_outside(arrays, workflow.aoi, core, context)
    counted = pulses.covered(arrays, workflow.products)
    counted |= terrain_facts(arrays["dtm_quality"], arrays["dtm"], core)
    if workflow.filter.method == "none":
        counted |= air_fill.alone_facts(arrays["dsm"], arrays["dtm"])
    give_back()
    of_pulses, swaths = pulses.pulse_facts(_first(cell), arrays["density"], core, context)
    counted |= of_pulses
    give_back()
    labels, facts, n_points = _classes(cell, arrays, swaths)
    counted |= facts | ({"banks": list(banks)} if banks else {})
    rasters = write_cell(context.store, args["cell"], core, arrays)
    return Produced([labels, *rasters], {"core": list(core), **counted}, n_points)


def _columns(cell: Cell) -> list[str]:
    """Columns of all looks at a cell."""
    unseen = cell.args["fired"] is None
    return [
        *(*surfacing.COLUMNS_NEEDED, "afterpulse", *pulses.COLUMNS),
        *_classes_columns(cell.context.workflow),
        *(surfacing.COLUMNS_OF_INTENSITY if unseen else reflectance.COLUMNS_NEEDED),
    ]


def _reflectance(cell: Cell) -> Rasters:
    """Share of the fired beamlets that were seen, turned into reflectance."""
    products, store = cell.context.workflow.products, cell.context.store
    region = grow(cell.core, quanta(reflectance.reach_m(products)))
    table = cell.read(
        region, reflectance.COLUMNS_NEEDED, lambda some: some["noise_class"] == NOISE_SIGNAL
    )[0]
    fired = []
    for name in cell.args["fired"]:
        part = FiredPart.from_arrays(read_arrays(store.path("fired", f"{name}.npz")))
        if cell.shifts is not None:
            part = part.raised(cell.shifts.of_name(name.rpartition("/")[0]))
        fired.append(part)
    return {"intensity": reflectance.raster(table, fired, cell.core, products)}


def _surfaces(cell: Cell) -> Rasters:
    """Rasters of a ground cell."""
    workflow = cell.context.workflow
    # The intensity raster is of detections or of what was delivered.
    seen = surfacing.COLUMNS_OF_INTENSITY if cell.args["fired"] is None else ()
    looked_at = (*surfacing.COLUMNS_NEEDED, "afterpulse", "noise_density", *seen)
    region = grow(cell.core, cell.args["halo"])
    known = cell.read(region, looked_at, surface_points.known)[0]
    table = surface_points.makes_surfaces(known)
    del known
    return surfacing.surfaces(table, cell.core, workflow.products, workflow.sensor.range_sigma_m)


def _first(cell: Cell) -> PointTable:
    """First returns of the pulses in and around a ground cell."""
    columns = (*pulses.COLUMNS, "flags", "noise_class")
    table = cell.read(grow(cell.core, cell.args["halo"]), columns, pulses.usable)[0]
    return table.select(("x", "y", "line")).take(first_returns(table.select(pulses.COLUMNS)))


def _flatten(arrays: Rasters, core: Bounds, context: Context) -> Banks | None:
    """Put lakes and rivers into the rasters of a ground cell, where breaklines give them."""
    if context.workflow.breaklines is None:
        return None
    waters = read_breaklines(context.resolve(context.workflow.breaklines), context.crs)
    rows, columns = arrays["dtm"].shape
    return flatten(arrays, water_heights(waters, core, (rows, columns)))


def _mask_outside(arrays: Rasters, aoi: str, core: Bounds, context: Context) -> None:
    """Take away raster cells whose centres lie outside the area of interest."""
    cell = quanta(context.workflow.products.cell_m)
    x = np.arange(core.xmin + cell // 2, core.xmax, cell, dtype=np.int64)
    y = np.arange(core.ymin + cell // 2, core.ymax, cell, dtype=np.int64)[::-1]
    east, north = (grid.ravel() for grid in np.meshgrid(x, y))
    outside = ~context.within(aoi, east, north).reshape(len(y), len(x))
    for name, values in arrays.items():
        arrays[name] = np.where(outside, np.float32(NODATA), values)


def _classes_columns(workflow: Workflow) -> tuple[str, ...]:
    """Columns of points that are looked at."""
    wires = ("wire",) if workflow.filter.wires.classify else ()
    return (*point_classes.COLUMNS_NEEDED, *wires, "noise_density")


def _classes(cell: Cell, arrays: Rasters, swaths: Swaths) -> tuple[Path, dict[str, Any], int]:
    """Write the classes of what a cell owns, and look at its noise.

    Of the rasters ``dtm`` is looked at, and ``noise`` is added; ``swaths`` show where overlap is
    flagged. Gives the file of labels, facts for the report, and how many points were labelled.
    """
    workflow, dtm = cell.context.workflow, arrays["dtm"]
    near = grow(cell.core, quanta(REACH_M if workflow.classes.building else 0.0))
    table, origin = cell.read(near, _classes_columns(workflow))
    owned = inside(table["x"], table["y"], cell.core)
    roofs = None
    if workflow.classes.building:
        roofs = buildings(table, _usable(table), _floor(cell))[owned]
    mine = table.take(owned)
    del table
    arrays["noise"] = _noise(mine, cell.core, quanta(workflow.products.cell_m))
    further = point_classes.Further(roofs, workflow.classes.vegetation)
    classification = point_classes.classify(mine, cell.core, dtm, further)
    labels = {"classification": classification}
    if workflow.classes.flags:
        labels["set_flags"] = _flags(mine, classification, workflow.classes, swaths)
    facts, noise = {}, arrays["noise"][arrays["noise"] > NODATA]
    if noise.size:
        highest = air_fill.highest_ground(dtm)
        air = air_fill.filled_blocks(mine, cell.core, highest, float(np.median(noise)))
        facts = {} if air is None else air_fill.fill_facts(air, cell.core)
    path = cell.context.store.table("surface", cell.args["cell"])
    write_labels(path, origin.of(owned), labels)
    return path, facts, len(mine)


def _noise(table: PointTable, core: Bounds, size: int) -> NDArray[np.float32]:
    """Mean expected noise density of each raster cell, north up [1/m3]."""
    shape = shape_of(core, size)
    known = np.isfinite(table["noise_density"])
    cell, value = cell_number(table, core, size)[known], table["noise_density"][known]
    # Sums in 64 bits of so few values of 24 bits each are exact: their order does not count.
    total = np.bincount(cell, value, shape[0] * shape[1])
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return north_up(mean.reshape(shape))


def _floor(cell: Cell) -> Floor:
    """The ground that buildings of a cell stand on."""
    region = grow(cell.core, cell.args["halo"])
    table = cell.read(region, ("x", "y", "z", "noise_class", "ground", "flags"))[0]
    return Floor(region, table, _usable(table))


def _usable(table: PointTable) -> NDArray[np.bool_]:
    """Signal that buildings are seen by."""
    usable = np.isin(table["noise_class"], (NOISE_SIGNAL, NOISE_NOT_ASSESSED))
    return usable & ~table.has(EXCLUDED)


def _flags(
    table: PointTable,
    classification: NDArray[np.uint8],
    asked: ClassSettings,
    swaths: Swaths,
) -> NDArray[np.uint8]:
    """Flags that are set: withheld noise, overlap."""
    flags = np.zeros(len(table), np.uint8)
    if asked.withheld:
        noise = np.isin(classification, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
        flags[noise] |= FLAG_WITHHELD
    if asked.overlap:
        flags[swaths.overlapping(table["x"], table["y"])] |= FLAG_OVERLAP
    return flags
