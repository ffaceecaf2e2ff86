"""Heights of delivered points above the terrain, and points that are not delivered."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.products.cell_values import shape_of
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.raster_cells import stored_blocks
from spl_batch.airborne.tasks.index import CHUNK_POINTS
from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    FLAG_WITHHELD,
    NODATA,
    QUANTUM_M,
)
from spl_batch.engine.store.working_store import read_receipt
from spl_batch.formats.las.header import LasHeader
from spl_batch.formats.las.reader import coordinate
from spl_batch.formats.las.writer import KEEP_BUT_GROUND
from spl_batch.formats.rasters.parts import RasterPart
from spl_batch.formats.vector_files import contains, read_polygons
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import (
    Bounds,
    BoxIndex,
    CellId,
    cell_bounds,
    grow,
    quanta,
    whole_cells,
)

IN_NO_TILE: Final = int(np.iinfo(np.uint8).max)
"""Flags of points that nothing has looked at: those that the input withholds or calls noise."""

PLACE: Final = ("x", "y", "z")
"""Columns that a height above the terrain is computed from."""


def terrain_margin_q(workflow: Workflow) -> int:
    """How far around a tile the terrain is read for heights above it [quanta]."""
    return 2 * quanta(workflow.products.cell_m) * workflow.outputs.height_above_ground


class Terrain:
    """The terrain model of the working store, as far as a task's surfaces are there."""

    def __init__(self, args: Mapping[str, Any], context: Context) -> None:
        self._context = context
        receipts = (read_receipt(context.store, "surface", n) for n in args["labels"]["surface"])
        cores = {one.name: Bounds(*one.facts["core"]) for one in receipts if one is not None}
        self._cores = BoxIndex(cores)

    def heights_above(self, tile: CellId, table: PointTable) -> NDArray[np.float32]:
        """Heights of a tile's points above the terrain, (n,) in the delivered unit; NaN at voids.

        The terrain is bilinear between cell centres; beside a void it is that of the point's cell.
        """
        workflow = self._context.workflow
        pixel = quanta(workflow.products.cell_m)
        reach = grow(cell_bounds(tile, quanta(workflow.tiling.tile_m)), pixel)
        bounds = whole_cells(reach, pixel)
        heights = np.full(shape_of(bounds, pixel), NODATA, np.float32)
        cells = self._cores.overlapping(bounds)
        for row, col, block in stored_blocks(self._context.store, "dtm", cells, bounds):
            heights[row : row + block.shape[0], col : col + block.shape[1]] = block
        corner_m = bounds.xmin * QUANTUM_M, bounds.ymax * QUANTUM_M
        terrain = RasterPart(heights, *corner_m, pixel * QUANTUM_M)
        surface = terrain.sampled(np.column_stack([table["x"], table["y"]]) * QUANTUM_M)
        above = (table["z"] * QUANTUM_M - surface) / self._context.units.vertical_m
        found: NDArray[np.float32] = above.astype(np.float32)
        return found


def gone(
    kind: str, classes: NDArray[np.uint8], las_flags: NDArray[np.uint8], flags: NDArray[np.uint8]
) -> NDArray[np.bool_]:
    """Which points a value of ``outputs.drop`` means: (n,) bool.

    Parameters
    ----------
    classes, las_flags : (n,) uint8
        Class and classification flags as they are delivered.
    flags : (n,) uint8
        Bits of :class:`~spl_batch.lattice.tables.PointFlag`.
    """
    means: dict[str, NDArray[np.bool_]] = {
        "noise": np.isin(classes, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE)),
        "withheld": las_flags & np.uint8(FLAG_WITHHELD) != 0,
        "outside": flags & np.uint8(PointFlag.OUTSIDE_AOI) != 0,
    }
    return means[kind]


class Dropping:
    """Which records of a file are written, and a count of the others by reason."""

    def __init__(
        self, kinds: Sequence[str], points: int, header: LasHeader, context: Context
    ) -> None:
        aoi = context.workflow.aoi if "outside" in kinds else None
        self._area = None if aoi is None else read_polygons(context.resolve(aoi), context.crs)
        self._header, self._units = header, context.units
        self.counts = dict.fromkeys(kinds, 0)
        chunks = -(-points // CHUNK_POINTS)
        self.kept = np.zeros(chunks, np.int64)  #: Of each chunk of the index [count].
        self.copied = np.zeros(256, np.int64)  #: Labelled copies that are dropped, by class.
        self._start = 0

    def __call__(
        self, records: NDArray[Any], labels: Mapping[str, NDArray[Any]]
    ) -> NDArray[np.bool_]:
        """Of records that follow those before, by the first reason that holds: (n,) bool."""
        left, flags = np.ones(len(records), np.bool_), self._flags(records, labels["flags"])
        for kind in self.counts:
            mine = left & gone(
                kind, records["classification"], records["classification_flags"], flags
            )
            self.counts[kind] += int(np.count_nonzero(mine))
            left &= ~mine
        chunk = (self._start + np.flatnonzero(left)) // CHUNK_POINTS
        self.kept += np.bincount(chunk, minlength=len(self.kept))
        self._start += len(records)
        copied = labels["copied"] & (labels["classification"] < KEEP_BUT_GROUND) & ~left
        self.copied += np.bincount(labels["classification"][copied], minlength=256)
        return left

    def _flags(self, records: NDArray[Any], flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Flags of records; of those in no tile the one that the area of interest decides."""
        lost = flags == IN_NO_TILE
        outside = np.zeros(len(records), np.bool_)
        if self._area is not None and lost.any():
            x, y = (coordinate(records[lost], self._header, k, 0, self._units) for k in range(2))
            outside[lost] = ~contains(self._area, x, y)
        return np.where(lost, outside * np.uint8(PointFlag.OUTSIDE_AOI), flags)

    def facts(self) -> dict[str, Any]:
        """What the report and client tiles need to know."""
        return {"dropped": self.counts, "kept": self.kept.tolist()}
