"""Classes of the points that a ground cell owns, and what is seen of noise among them."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.classes import point_classes
from spl_batch.airborne.classes.buildings import REACH_M, Floor, buildings
from spl_batch.airborne.diagnostics import air_fill
from spl_batch.airborne.products.raster_grid import cell_number, shape_of
from spl_batch.airborne.pulses.swaths import Swaths
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.cells import Cell
from spl_batch.airborne.store.label_tables import write_labels
from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    FLAG_OVERLAP,
    FLAG_WITHHELD,
    NODATA,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
)
from spl_batch.lattice.tables import EXCLUDED, PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta

Rasters = dict[str, NDArray[np.float32]]


def reach_q(asked: ClassSettings) -> int:
    """What is looked at around a cell [quanta]."""
    return quanta(REACH_M if asked.building else 0.0)


def columns(workflow: Workflow) -> tuple[str, ...]:
    """Columns of points that are looked at."""
    wires = ("wire",) if workflow.filter.wires.classify else ()
    return (*point_classes.COLUMNS_NEEDED, *wires, "noise_density")


def classes(cell: Cell, arrays: Rasters, swaths: Swaths) -> tuple[Path, dict[str, Any], int]:
    """Write the classes of what a cell owns, and look at its noise.

    Of the rasters ``dtm`` is looked at, and ``noise`` is added; ``swaths`` tell where overlap is
    flagged. Gives the file of labels, facts for the report, and how many points were labelled.
    """
    workflow, dtm = cell.context.workflow, arrays["dtm"]
    table, origin = cell.read(grow(cell.core, reach_q(workflow.classes)), columns(workflow))
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
    facts, noise_m3 = {}, _median(arrays["noise"])
    if noise_m3 is not None:
        highest = air_fill.highest_ground(dtm)
        air = air_fill.filled_blocks(mine, cell.core, highest, noise_m3)
        facts = {} if air is None else air_fill.fill_facts(air, cell.core)
    path = cell.context.store.table("classes", cell.args["cell"])
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
    mean = np.where(count > 0, total / np.maximum(count, 1), NODATA)
    return np.ascontiguousarray(mean.reshape(shape)[::-1], dtype=np.float32)


def _median(noise: NDArray[np.float32]) -> float | None:
    """Expected noise of a cell [1/m3]; None where there is none."""
    known = noise[noise > NODATA]
    return float(np.median(known)) if known.any() else None


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
