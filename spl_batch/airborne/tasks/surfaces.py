"""Stage ``surfaces``: raster cells and final classes of a ground cell.

Four looks at the same points follow each other, each with the columns and the returns that it
needs and no others. Where there is memory for all of them, points are read once for all looks.
Where those of a single look do not fit, each look takes them strip by strip: what it needs of all
of them (means of ground, heights of noise, counts) is gathered first, and each raster cell and
point has the same value as in a cell at once.
"""

import hashlib
from collections.abc import Mapping
from math import lcm
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.diagnostics.terrain_sigma import terrain_facts
from spl_batch.airborne.filter.stray_returns import bare_cells
from spl_batch.airborne.ground.water.level import CELL_M
from spl_batch.airborne.hydro.flattening import Banks, flatten, water_heights
from spl_batch.airborne.products import surface_points
from spl_batch.airborne.products import surface_rasters as surfacing
from spl_batch.airborne.products.footprint import Footprint
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart
from spl_batch.airborne.products.top_surface import top_margin
from spl_batch.airborne.pulses.pulse_returns import ends_in_parts
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.flown_lines import read_shifts
from spl_batch.airborne.store.raster_cells import write_cell
from spl_batch.airborne.tasks.cells import cell_classes, pulses
from spl_batch.airborne.tasks.cells.ground_cell import Cell
from spl_batch.constants import NODATA, NOISE_SIGNAL
from spl_batch.engine.store.working_store import forget_receipt, read_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.spare_memory import give_back
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.polygons import contains, read_polygons
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.eastings import once
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, CellId, cells_touching, grow, overlap, quanta

Rasters = dict[str, NDArray[np.float32]]


class Look(NamedTuple):
    """How strips of a cell may be cut where it is looked at."""

    step_q: int  #: They begin at multiples of this [quanta].
    reach_q: int  #: What each of them reads on either side [quanta].
    margin_q: int  #: What is read around the cell [quanta].


def looks_at_surface(workflow: Workflow, halo_q: int) -> dict[str, Look]:
    """The looks at a surface cell, by name.

    ``tops`` are all that ask for whole raster cells alone, and where there is water for whole cells
    of its level.

    ``halo_q``: what is read around the cell at the most [quanta].
    """
    cell, near = quanta(workflow.products.cell_m), min(halo_q, pulses.reach(workflow.products))
    around = cell_classes.reach_q(workflow.classes)
    level = 1 if workflow.water is None else quanta(CELL_M)
    return {
        "tops": Look(lcm(cell, level), top_margin(workflow.products) * cell, halo_q),
        "pulses": Look(lcm(cell, pulses.STEP_Q), 0, near),
        "classes": Look(lcm(cell, cell_classes.step_q(workflow.classes)), around, around),
    }


def surface(args: Mapping[str, Any], context: Context) -> Produced:
    """Raster cells and final classes of a ground cell, strip by strip where it is cut."""
    workflow, core = context.workflow, Bounds(*args["core"])
    cell = Cell(args, context, core, read_shifts(args, context.store))
    if args.get("held"):
        cell = cell.holding(*_at_once(cell))
    reflected = {} if args["fired"] is None else _reflectance(cell)
    give_back()
    arrays, squares = _surfaces(cell)
    arrays |= reflected
    banks = _flatten(arrays, core, context)
    if workflow.aoi is not None:
        _mask_outside(arrays, core, context)
    counted = pulses.covered(squares, arrays, context)
    counted |= terrain_facts(arrays["dtm_quality"], arrays["dtm"], core)
    give_back()
    found = _pulses(cell)
    judged = found.judged(squares)
    counted |= found.facts(judged)
    arrays |= found.rasters(arrays["density"], judged)
    give_back()
    labels, facts, n_points = cell_classes.classes(cell, arrays, found.lines)
    counted |= facts | ({"banks": list(banks)} if banks else {})
    chunks = _write_rasters(args["cell"], core, arrays, context)
    sums = {k: hashlib.blake2b(v.tobytes(), digest_size=8).hexdigest() for k, v in arrays.items()}
    facts = {"core": list(core), "rasters": sums, **counted}
    return Produced([labels, *chunks], facts, n_points)


def _at_once(cell: Cell) -> tuple[Bounds, list[str]]:
    """Region and columns of all looks at a cell."""
    workflow, far = cell.context.workflow, cell.args["halo"]
    columns = [*surfacing.COLUMNS_NEEDED, "afterpulse", *pulses.COLUMNS]
    columns += cell_classes.columns(workflow)
    if cell.args["fired"] is None:
        columns += surfacing.COLUMNS_OF_INTENSITY
    else:
        far = max(far, quanta(reflectance.reach_m(workflow.products)))
        columns += reflectance.COLUMNS_NEEDED
    return grow(cell.core, far), columns


def _reflectance(cell: Cell) -> Rasters:
    """Share of the fired beamlets that were seen, turned into reflectance."""
    products, store = cell.context.workflow.products, cell.context.store

    def read(part: Bounds) -> PointTable:
        return cell.read(
            part, reflectance.COLUMNS_NEEDED, lambda some: some["noise_class"] == NOISE_SIGNAL
        )[0]

    parts = cell.parts(grow(cell.core, quanta(reflectance.reach_m(products))), "tops")
    points = once(parts, read)
    fired = []
    for name in cell.args["fired"]:
        part = FiredPart.from_arrays(read_arrays(store.path("fired", f"{name}.npz")))
        if cell.shifts is not None:
            part = part.raised(cell.shifts.up_of(name.rpartition("/")[0]))
        fired.append(part)
    values = reflectance.raster(lambda: map(points, parts), fired, cell.core, products)
    return {"intensity": values}


def _surfaces(cell: Cell) -> tuple[Rasters, NDArray[np.bool_]]:
    """Rasters of a ground cell, and its squares that returns cover."""
    products = cell.context.workflow.products
    # The intensity raster is of detections or of what was delivered.
    seen = surfacing.COLUMNS_OF_INTENSITY if cell.args["fired"] is None else ()
    looked_at = (*surfacing.COLUMNS_NEEDED, "afterpulse", *seen)
    parts = cell.parts(grow(cell.core, cell.args["halo"]), "tops")

    def known(region: Bounds) -> PointTable:
        return cell.read(region, looked_at, surface_points.known)[0]

    bare = None
    if len(parts) > 1:
        bare = bare_cells(lambda: map(known, parts), spare_above=True)
    points = once(parts, lambda region: surface_points.makes_surfaces(known(region), bare))
    made, flown = surfacing.Surfaces(cell.core, products), Footprint(cell.core, products)

    def look(part: Bounds) -> None:
        table = points(part)
        made.look(table, part)
        flown.look(table, part)

    def add(part: Bounds) -> None:
        table = points(made.around(part))
        made.add(table, part)
        flown.add(table, part)

    for take in (look, add):
        for part in parts:
            take(part)
    squares = flown.squares(pulses.of_interest(cell.context))
    return made.rasters(), squares


def _pulses(cell: Cell) -> pulses.Pulses:
    """What the pulses of a ground cell tell."""
    workflow = cell.context.workflow
    found = pulses.Pulses(cell.core, cell.args["passes"], cell.context)
    near = min(cell.args["halo"], pulses.reach(workflow.products))
    parts = cell.parts(grow(cell.core, near), "pulses")

    def read(part: Bounds) -> PointTable:
        columns = (*pulses.COLUMNS, "flags", "noise_class")
        return cell.read(part, columns, pulses.usable)[0].select(pulses.COLUMNS)

    points = once(parts, read)
    # As many returns are looked at together as a strip has.
    ends = ends_in_parts(lambda: map(points, parts), len(parts))
    for part, of_part in zip(parts, ends, strict=True):
        found.add(pulses.returns_of(points(part), of_part), part)
    return found


def _flatten(arrays: Rasters, core: Bounds, context: Context) -> Banks | None:
    """Put lakes and rivers into the rasters of a ground cell, where breaklines give them."""
    if context.workflow.breaklines is None:
        return None
    waters = read_breaklines(context.resolve(context.workflow.breaklines), context.crs)
    rows, columns = arrays["dtm"].shape
    return flatten(arrays, water_heights(waters, core, (rows, columns)))


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
