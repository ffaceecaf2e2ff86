"""Stage ``surfaces``: raster cells and final classes of a ground cell.

Four looks at the same points follow each other, each with the columns and the returns that it
needs and no others: at 150 returns per square metre a cell with its margin holds ten million.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.classes import point_classes
from spl_batch.airborne.classes.buildings import buildings
from spl_batch.airborne.classes.overlap import overlapping
from spl_batch.airborne.context import Context
from spl_batch.airborne.filter import kept_noise
from spl_batch.airborne.hydro.flattening import Banks, flatten, water_heights
from spl_batch.airborne.products import near_ground, surface_points
from spl_batch.airborne.products import surface_rasters as surfacing
from spl_batch.airborne.products.cell_values import add_up_finite
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart
from spl_batch.airborne.pulses.pulse_maps import flightline_of
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.store.label_tables import Origin, read_region, write_labels
from spl_batch.airborne.store.raster_cells import write_cell
from spl_batch.airborne.tasks import pulses
from spl_batch.airborne.tasks.coverage import covered, flown_squares
from spl_batch.airborne.tasks.space_domain import label_units, tile_cells
from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    FLAG_OVERLAP,
    FLAG_WITHHELD,
    NODATA,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
)
from spl_batch.engine.store.working_store import forget_receipt, read_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.polygons import contains, read_polygons
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.tables import EXCLUDED, PointTable
from spl_batch.lattice.tiles import Bounds, CellId, cells_touching, grow, inside, overlap, quanta

_LABELS: Final = ("noise_class", "ground", "noise_density", "wire")

Rasters = dict[str, NDArray[np.float32]]


class _Cell(NamedTuple):
    """A ground cell: what its task was told, and where its points lie."""

    args: Mapping[str, Any]
    context: Context
    core: Bounds

    def read(
        self,
        reach: int,
        columns: Sequence[str],
        keep: Callable[[PointTable], NDArray[np.bool_]] | None = None,
    ) -> tuple[PointTable, Origin]:
        """Points of the cell and so far around it [quanta], tile by tile, and where they lie."""
        noise, ground = (label_units(self.args[kind]) for kind in ("noise", "ground"))
        labels = {k: ground if k == "ground" else noise for k in columns if k in _LABELS}
        return read_region(
            self.context.store, tile_cells(self.args["tiles"]), grow(self.core, reach),
            [k for k in columns if k not in labels], labels, ordered=False, keep=keep,
        )  # fmt: skip


def surface(args: Mapping[str, Any], context: Context) -> Produced:
    """Raster cells and final classes of a ground cell."""
    workflow, core = context.workflow, Bounds(*args["core"])
    cell = _Cell(args, context, core)
    reflected = {} if args["fired"] is None else _reflectance(cell)
    # The intensity raster is of detections or of what was delivered.
    seen = surfacing.COLUMNS_OF_INTENSITY if args["fired"] is None else ()
    looked_at = (*surfacing.COLUMNS_NEEDED, "afterpulse", *seen)
    shown = surface_points.makes_surfaces(
        cell.read(args["halo"], looked_at, surface_points.known)[0]
    )
    arrays = surfacing.surfaces(shown, core, workflow.products) | reflected
    banks = _flatten(arrays, core, context)
    if workflow.aoi is not None:
        _mask_outside(arrays, core, context)
    squares = flown_squares(shown, core, context)
    counted = covered(squares, arrays, context)
    del shown
    columns = (*pulses.COLUMNS, "flags", "noise_class")
    returns = pulses.pulse_returns(
        cell.read(args["halo"], columns, pulses.usable)[0], core, workflow.products
    )
    counted |= pulses.pulse_facts(returns, core, squares, context)
    if workflow.products.maps:
        arrays |= pulses.pulse_rasters(returns, core, arrays["density"], args["passes"])
    labels, facts, n_points = _classes(cell, arrays, returns)
    counted |= facts | ({"banks": list(banks)} if banks else {})
    chunks = _write_rasters(args["cell"], core, arrays, context)
    sums = {k: hashlib.blake2b(v.tobytes(), digest_size=8).hexdigest() for k, v in arrays.items()}
    facts = {"core": list(core), "rasters": sums, **counted}
    return Produced([labels, *chunks], facts, n_points)


def _reflectance(cell: _Cell) -> Rasters:
    """Share of the fired beamlets that were seen, turned into reflectance."""
    products, store = cell.context.workflow.products, cell.context.store
    table = cell.read(
        quanta(reflectance.reach_m(products)), reflectance.COLUMNS_NEEDED,
        lambda some: some["noise_class"] == NOISE_SIGNAL,
    )[0]  # fmt: skip
    paths = [store.path("fired", f"{name}.npz") for name in cell.args["fired"]]
    parts = [FiredPart.from_arrays(read_arrays(path)) for path in paths]
    return {"intensity": reflectance.raster(table, parts, cell.core, products)}


def _classes(
    cell: _Cell, arrays: Rasters, returns: pulses.PulseReturns
) -> tuple[Path, dict[str, Any], int]:
    """Write the classes of what the cell owns, and look at its noise; file, facts, points."""
    context, core, classes = cell.context, cell.core, cell.context.workflow.classes
    wires = ("wire",) if context.workflow.filter.wires.classify else ()
    needed = (*point_classes.COLUMNS_NEEDED, *wires)
    reach = cell.args["halo"] if classes.building else quanta(kept_noise.EDGE_M)
    table, origin = cell.read(reach, (*needed, "noise_density"))
    facts: dict[str, Any] = {"kept_noise": kept_noise.within_signal(table, core)}
    owned = inside(table["x"], table["y"], core)
    further = _further(table, grow(core, reach), owned, classes)
    table, place = table.take(owned), origin.of(owned)
    del origin, owned
    arrays["noise"] = _mean_noise(table, core, quanta(context.workflow.products.cell_m))
    table = table.select(needed)
    facts |= _fog_facts(table, core, arrays["dtm"], arrays["noise"])
    path = context.store.labels("classes", cell.args["cell"])
    found = point_classes.classify(table, core, arrays["dtm"], further)
    flags = _flags(table, found, returns, cell.args["passes"], classes)
    write_labels(path, *place, {"classification": found, **flags})
    return path, facts, len(found)


def _flatten(arrays: Rasters, core: Bounds, context: Context) -> Banks | None:
    """Put lakes and rivers into the rasters of a ground cell, where breaklines give them."""
    if context.workflow.breaklines is None:
        return None
    waters = read_breaklines(context.resolve(context.workflow.breaklines), context.crs)
    rows, columns = arrays["dtm"].shape
    return flatten(arrays, water_heights(waters, core, (rows, columns)))


def _further(
    table: PointTable, region: Bounds, owned: NDArray[np.bool_], classes: ClassSettings
) -> point_classes.Further:
    """What else is asked of the classes of points that a ground cell owns."""
    if not classes.building:
        return point_classes.Further(vegetation=classes.vegetation)
    usable = np.isin(table["noise_class"], (NOISE_SIGNAL, NOISE_NOT_ASSESSED))
    roofs = buildings(table, usable & ~table.has(EXCLUDED), region)
    return point_classes.Further(roofs[owned], classes.vegetation)


def _flags(
    mine: PointTable,
    classification: NDArray[np.uint8],
    returns: pulses.PulseReturns,
    passes: Sequence[tuple[int, float, float]],
    classes: ClassSettings,
) -> dict[str, NDArray[np.uint8]]:
    """Flags of the points of a ground cell, where some are asked for."""
    if not classes.flags:
        return {}
    flags = np.zeros(len(mine), np.uint8)
    if classes.withheld:
        flags[np.isin(classification, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))] |= FLAG_WITHHELD
    if classes.overlap:
        line = flightline_of(returns.point_source_id, returns.time_s, passes)
        over = overlapping(returns.first[:, :2], line, mine["x"], mine["y"])
        flags[over] |= FLAG_OVERLAP
    return {"set_flags": flags}


def _fog_facts(
    table: PointTable, core: Bounds, dtm: NDArray[np.float32], noise_m3: NDArray[np.float32]
) -> dict[str, Any]:
    """How many places of a ground cell hold returns evenly just above the ground."""
    known = noise_m3[noise_m3 > NODATA]
    if not len(known) or not known.any():
        return {}
    noise = float(np.median(known))
    return {"filled": near_ground.filled_places(table, core, dtm, noise)}


def _mean_noise(table: PointTable, core: Bounds, cell: int) -> NDArray[np.float32]:
    """Mean expected noise density of the points of a cell in each raster cell, north-up [1/m3].

    Sums in 64 bits of so few values of 24 bits each are exact: the points' order does not count.
    """
    rows, columns = (core.ymax - core.ymin) // cell, (core.xmax - core.xmin) // cell
    total, count = np.zeros(rows * columns), np.zeros(rows * columns, np.int64)
    add_up_finite(surfacing.cell_number(table, core, cell), table["noise_density"], total, count)
    mean = np.where(count > 0, total / np.maximum(count, 1), NODATA)
    return np.ascontiguousarray(mean.reshape(rows, columns)[::-1], dtype=np.float32)


def _write_rasters(name: str, core: Bounds, arrays: Rasters, context: Context) -> list[Path]:
    """Raster cells of a ground cell; files of their chunks."""
    edge = quanta(context.workflow.ground.cell_m)
    for other in map(str, cells_touching(grow(core, edge), edge)):
        # When the survey was another a cell beside it owned some of its squares, or one of them
        # was a cell by itself: that receipt must not speak for chunks that are written over.
        receipt = None if other == name else read_receipt(context.store, "surface", other)
        if receipt and not receipt.failed and overlap(Bounds(*receipt.facts["core"]), core):
            forget_receipt(context.store, "surface", other)
    return write_cell(context.rasters, CellId(core.xmin // edge, core.ymin // edge), arrays)


def _mask_outside(arrays: Rasters, core: Bounds, context: Context) -> None:
    """Take away raster cells whose centres lie outside the area of interest."""
    cell = quanta(context.workflow.products.cell_m)
    x = np.arange(core.xmin + cell // 2, core.xmax, cell, dtype=np.int64)
    y = np.arange(core.ymin + cell // 2, core.ymax, cell, dtype=np.int64)[::-1]
    east, north = (grid.ravel() for grid in np.meshgrid(x, y))
    polygons = read_polygons(context.resolve(context.workflow.aoi or ""), context.crs)
    outside = ~contains(polygons, east, north).reshape(len(y), len(x))
    for name, values in arrays.items():
        arrays[name] = np.where(outside, np.float32(NODATA), values)
