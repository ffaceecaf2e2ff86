"""Classes of the points that a ground cell owns, and what is seen of noise among them."""

from collections.abc import Sequence
from math import lcm
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.classes import point_classes
from spl_batch.airborne.classes.buildings import CELLS_M, REACH_M, Floor, buildings
from spl_batch.airborne.classes.overlap import overlapping
from spl_batch.airborne.diagnostics import air_fill
from spl_batch.airborne.products.cell_values import add_up_finite
from spl_batch.airborne.products.raster_grid import cell_number, columns_of
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.label_tables import Labelled, Origin, write_labels
from spl_batch.airborne.tasks.cells.ground_cell import Cell
from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    FLAG_OVERLAP,
    FLAG_WITHHELD,
    NODATA,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
)
from spl_batch.lattice.distinct import distinct
from spl_batch.lattice.eastings import once
from spl_batch.lattice.tables import EXCLUDED, PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta

Rasters = dict[str, NDArray[np.float32]]


class _Known(NamedTuple):
    """What is known of the whole cell before its points are told their classes.

    Parameters
    ----------
    level_m : float
        Stands for the surface where the DTM is void [m].
    highest : (rows, cols) float32
        Highest ground of raster cells (:func:`~.air_fill.highest_ground`) [m].
    floor : Floor, optional
        The ground around buildings, where these are looked for.
    lines : sequence of (2, k) int64
        Flightlines by square, where overlap is flagged.
    noise_m3 : float, optional
        Expected noise, where any is known [1/m3].
    """

    level_m: float
    highest: NDArray[np.float32]
    floor: Floor | None
    lines: Sequence[NDArray[np.int64]]
    noise_m3: float | None


class _Labelled(NamedTuple):
    """Labels of the points of a part, and blocks of air that returns fill."""

    labels: Labelled
    air: NDArray[np.bool_] | None


def step_q(asked: ClassSettings) -> int:
    """Parts of a cell are cut at multiples of this: places that are judged as one [quanta]."""
    squares_m = (air_fill.PLACE_M, *(CELLS_M if asked.building else ()))
    return lcm(*map(quanta, squares_m))


def reach_q(asked: ClassSettings) -> int:
    """What a part of a cell reads around it [quanta]."""
    return quanta(REACH_M if asked.building else 0.0)


def columns(workflow: Workflow) -> tuple[str, ...]:
    """Columns of points that are looked at."""
    wires = ("wire",) if workflow.filter.wires.classify else ()
    return (*point_classes.COLUMNS_NEEDED, *wires, "noise_density")


def classes(
    cell: Cell, arrays: Rasters, lines: Sequence[NDArray[np.int64]]
) -> tuple[Path, dict[str, Any], int]:
    """Write the classes of what a cell owns, and look at its noise.

    Parameters
    ----------
    cell : Cell
        The ground cell.
    arrays : dict of str to (rows, cols) float32
        Its rasters; ``dtm`` is looked at, ``noise`` is added.
    lines : sequence of (2, k) int64
        Flightlines by square (:func:`~spl_batch.airborne.classes.overlap.lines_by_square`).

    Returns
    -------
    path : Path
        The file of labels.
    facts : dict
        What the report needs to know.
    points : int
        How many were labelled [count].
    """
    workflow, building = cell.context.workflow, cell.context.workflow.classes.building
    reach, looked_at = reach_q(workflow.classes), columns(workflow)
    parts = cell.parts(cell.core, "classes")
    points = once(parts, lambda part: cell.read(grow(part, reach), looked_at))
    noise = _Noise(cell.core, quanta(workflow.products.cell_m))
    for part in parts:
        noise.add(points(part)[0], part)
    arrays["noise"] = noise.raster()
    floor = _floor(cell) if building else None
    highest = air_fill.highest_ground(arrays["dtm"])
    known = _Known(noise.level_m(), highest, floor, lines, _median(arrays["noise"]))
    found = [_label(cell, points(part), part, arrays["dtm"], known) for part in parts]
    air = [part.air for part in found if part.air is not None]
    facts = air_fill.fill_facts(np.concatenate(air, axis=1), cell.core) if air else {}
    path = cell.context.store.labels("classes", cell.args["cell"])
    write_labels(path, [part.labels for part in found])
    return path, facts, sum(len(part.labels[0].row) for part in found)


class _Noise:
    """Noise of a cell, and the heights of its signal; added up part by part."""

    def __init__(self, core: Bounds, size: int) -> None:
        self._core, self._size = core, size
        self._shape = (core.ymax - core.ymin) // size, (core.xmax - core.xmin) // size
        self._total = np.zeros(self._shape[0] * self._shape[1])
        self._count = np.zeros(len(self._total), np.int64)
        # Heights of signal and how many have each: few, however many points there are.
        self._heights: list[tuple[NDArray[np.int32], NDArray[np.int64]]] = []

    def add(self, table: PointTable, part: Bounds) -> None:
        """Take in the points of a part, those around it among them."""
        owned = inside(table["x"], table["y"], part)
        mine = table.select(("x", "y", "noise_density")).take(owned)
        # Sums in 64 bits of so few values of 24 bits each are exact: their order does not count.
        number = cell_number(mine, self._core, self._size)
        add_up_finite(number, mine["noise_density"], self._total, self._count)
        signal = owned & (table["noise_class"] == NOISE_SIGNAL)
        heights, rank = distinct(table["z"][signal])
        self._heights.append((heights, np.bincount(rank, minlength=len(heights))))

    def raster(self) -> NDArray[np.float32]:
        """Mean expected noise density of each raster cell, north up [1/m3]."""
        count = self._count
        mean = np.where(count > 0, self._total / np.maximum(count, 1), NODATA)
        return np.ascontiguousarray(mean.reshape(self._shape)[::-1], dtype=np.float32)

    def level_m(self) -> float:
        """Median height of the signal [m]."""
        heights, counts = (np.concatenate(some) for some in zip(*self._heights, strict=True))
        return point_classes.middle_of_counts_m(heights, counts)


def _median(noise: NDArray[np.float32]) -> float | None:
    """Expected noise of a cell [1/m3]; None where there is none."""
    known = noise[noise > NODATA]
    return float(np.median(known)) if known.any() else None


def _floor(cell: Cell) -> Floor:
    """The ground that buildings of a cell stand on."""
    region = grow(cell.core, cell.args["halo"])
    floor = Floor(region)

    def add(part: Bounds) -> None:
        table = cell.read(part, ("x", "y", "z", "noise_class", "ground", "flags"))[0]
        floor.add(table, _usable(table))

    for part in cell.parts(region, "tops"):
        add(part)
    return floor


def _usable(table: PointTable) -> NDArray[np.bool_]:
    """Signal that buildings are seen by."""
    usable = np.isin(table["noise_class"], (NOISE_SIGNAL, NOISE_NOT_ASSESSED))
    return usable & ~table.has(EXCLUDED)


def _label(
    cell: Cell,
    found: tuple[PointTable, Origin],
    part: Bounds,
    dtm: NDArray[np.float32],
    known: _Known,
) -> _Labelled:
    """Classes and flags of the points of a part."""
    table, origin = found
    asked = cell.context.workflow.classes
    owned = inside(table["x"], table["y"], part)
    roofs = None
    if known.floor is not None:
        roofs = buildings(table, _usable(table), known.floor)[owned]
    mine = table.select([name for name in table.columns if name != "noise_density"]).take(owned)
    del table
    within = columns_of(part, cell.core, dtm.shape[1])
    further = point_classes.Further(roofs, asked.vegetation)
    classification = point_classes.classify(mine, part, dtm[:, within], further, known.level_m)
    labels = {"classification": classification}
    if asked.flags:
        flags = labels["set_flags"] = np.zeros(len(mine), np.uint8)
        if asked.withheld:
            noise = np.isin(classification, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
            flags[noise] |= FLAG_WITHHELD
        if asked.overlap:
            flags[overlapping(known.lines, mine["x"], mine["y"])] |= FLAG_OVERLAP
    air = None
    if known.noise_m3 is not None:
        air = air_fill.filled_blocks(mine, part, known.highest[:, within], known.noise_m3)
    return _Labelled((origin.of(owned), labels), air)
