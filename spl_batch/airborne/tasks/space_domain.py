"""Stages ``denoise``, ``ground`` and ``surfaces``: a place with its halo, all flightlines."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.classes import point_classes
from spl_batch.airborne.classes.buildings import buildings
from spl_batch.airborne.classes.overlap import overlapping
from spl_batch.airborne.context import Context
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.filter.air import facts_of, look_at_air, noise_in_air
from spl_batch.airborne.filter.expected_noise import noise_model
from spl_batch.airborne.filter.kept_noise import within_signal
from spl_batch.airborne.ground import ground_methods as grounding
from spl_batch.airborne.hydro.flattening import Banks, flatten, water_heights
from spl_batch.airborne.products import near_ground, surface_points
from spl_batch.airborne.products import surface_rasters as surfacing
from spl_batch.airborne.products.cell_values import add_up_finite
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart
from spl_batch.airborne.pulses.pulse_maps import flightline_of
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.store.label_tables import read_region, write_labels
from spl_batch.airborne.store.raster_cells import write_cell
from spl_batch.airborne.tasks import pulses
from spl_batch.airborne.tasks.coverage import covered
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
from spl_batch.lattice.tiles import (
    Bounds,
    CellId,
    cells_touching,
    grow,
    inside,
    overlap,
    parse_cell,
    quanta,
)

Units = dict[CellId, list[tuple[str, str]]]

_GROUND_COLUMNS = ("x", "y", "z", "flags", "afterpulse")
_SURFACE_COLUMNS = (*_GROUND_COLUMNS, "input_class")
"""What the stages look at; a tile holds twice as much."""

_RASTER_COLUMNS = (
    *("gps_time", "channel", "return_number", "point_source_id"),
    "noise_density",
)
"""What is needed for pulses, the reflectance and the mean noise of raster cells alone."""


def denoise(args: Mapping[str, Any], context: Context) -> Produced:
    """Decide which points of a block are noise."""
    workflow = context.workflow
    core = Bounds(*args["core"])
    region = grow(core, args["halo"])
    cells = _cells(args["tiles"])
    table, origin = read_region(context.store, cells, region, denoising.COLUMNS_NEEDED, {})
    owned = inside(table["x"], table["y"], core)
    place = origin.of(owned)
    del origin
    by_voxel = denoising.asks_for_means(workflow.filter)
    model = noise_model(
        [table[axis] for axis in "xyz"], args["voxels"], args["beamlets"], context.store,
        workflow.noise,
    )  # fmt: skip
    look = look_at_air(table, model, workflow, core)
    # Air is looked for farther around than the filter looks.
    near = inside(table["x"], table["y"], grow(core, quanta(denoising.reach_m(workflow.filter))))
    if not near.all():
        table, owned = table.take(near), owned[near]
    noise = noise_in_air(
        table, np.ones(len(table), np.bool_) if by_voxel else owned, model, look.air
    )
    mean = (noise.mean[owned] if by_voxel else noise.mean).astype(np.float32)
    local, density = noise.local, noise.mean if by_voxel else noise.local
    del model, near, noise
    found = denoising.resolve(table, local, workflow.filter, workflow.afterpulse)
    del local
    # What has told the afterpulses and the noise is not held while the rest is judged.
    table = table.select(("x", "y", *denoising.COLUMNS_JUDGED))
    chosen = denoising.independent(table, density, owned, found, workflow.filter)
    table = table.select(denoising.COLUMNS_JUDGED)
    del density
    decided = denoising.judge(table, chosen, owned, found, workflow.filter)
    path = context.store.labels("noise", args["block"])
    labels: dict[str, NDArray[Any]] = {
        "noise_class": decided["noise_class"],
        "p_value": decided["p_value"],
        "wire": decided["wire"],
        "noise_density": mean,
    }
    write_labels(path, *place, labels)
    kinds, counts = np.unique(decided["noise_class"], return_counts=True)
    facts = {
        "core": list(core),
        "noise_class": dict(zip(map(str, kinds.tolist()), counts.tolist(), strict=True)),
        **facts_of(look, core),
    }
    return Produced([path], facts, int(np.count_nonzero(owned)))


def ground(args: Mapping[str, Any], context: Context) -> Produced:
    """Find the ground of a cell."""
    settings = context.workflow.ground
    core = Bounds(*args["core"])
    table, origin = read_region(
        context.store,
        _cells(args["tiles"]),
        grow(core, args["halo"]),
        _GROUND_COLUMNS,
        {"noise_class": _units(args["noise"])},
        ordered=False,
    )
    owned = inside(table["x"], table["y"], core)
    mask = grounding.ground_mask(table, surface_points.holds_ground(table), settings, owned)
    path = context.store.labels("ground", args["cell"])
    write_labels(path, *origin.of(owned), {"ground": mask[owned]})
    facts = {"ground": int(np.count_nonzero(mask & owned))}
    return Produced([path], facts, int(np.count_nonzero(owned)))


def surface(args: Mapping[str, Any], context: Context) -> Produced:
    """Raster cells and final classes of a ground cell."""
    workflow = context.workflow
    core = Bounds(*args["core"])
    noise = _units(args["noise"])
    labels = {"noise_class": noise, "noise_density": noise, "ground": _units(args["ground"])}
    if workflow.filter.wires.classify:
        labels["wire"] = noise
    # The intensity raster is of detections or of what was delivered.
    seen = surfacing.COLUMNS_OF_INTENSITY if args["fired"] is None else ()
    columns = (*dict.fromkeys((*_SURFACE_COLUMNS, *pulses.COLUMNS, *seen)),)
    region = grow(core, args["halo"])
    table, origin = read_region(
        context.store, _cells(args["tiles"]), region, columns, labels, ordered=False
    )
    noise_m3 = _mean_noise(table, core, quanta(workflow.products.cell_m))
    kept_noise = within_signal(table, core)
    returns = pulses.pulse_returns(table, core, workflow.products)
    reflected: dict[str, NDArray[np.float32]] = {}
    if args["fired"] is not None:
        paths = [context.store.path("fired", f"{name}.npz") for name in args["fired"]]
        parts = [FiredPart.from_arrays(read_arrays(path)) for path in paths]
        reflected["intensity"] = reflectance.raster(table, parts, core, workflow.products)
        del parts
    # What only these look at is not held any longer.
    done_with = set(_RASTER_COLUMNS) - set(seen)
    table = table.select([name for name in table.columns if name not in done_with])
    owned = inside(table["x"], table["y"], core)
    classified = (*point_classes.COLUMNS_NEEDED, *(("wire",) if "wire" in table else ()))
    mine, place = table.select(classified).take(owned), origin.of(owned)
    further = _further(table, region, owned, workflow.classes)
    del origin, owned
    shown = surface_points.makes_surfaces(table)
    table = table.select(near_ground.COLUMNS_NEEDED)
    arrays = surfacing.surfaces(shown, core, workflow.products)
    arrays |= reflected
    banks = _flatten(arrays, core, context)
    if workflow.aoi is not None:
        _mask_outside(arrays, core, context)
    counted = covered(shown, core, arrays, context)
    counted |= _fog_facts(table, core, arrays["dtm"], noise_m3)
    del table
    counted |= pulses.pulse_facts(returns, core, arrays["density"], context)
    del shown
    if workflow.products.maps:
        arrays |= pulses.pulse_rasters(returns, core, arrays["density"], args["passes"])
    arrays["noise"] = noise_m3
    chunks = _write_rasters(args["cell"], core, arrays, context)
    path = context.store.labels("classes", args["cell"])
    found = point_classes.classify(mine, core, arrays["dtm"], further)
    flags = _flags(mine, found, returns, args["passes"], workflow.classes)
    write_labels(path, *place, {"classification": found, **flags})
    sums = {k: hashlib.blake2b(v.tobytes(), digest_size=8).hexdigest() for k, v in arrays.items()}
    counted |= {"banks": list(banks)} if banks else {}
    facts = {"core": list(core), "rasters": sums, "kept_noise": kept_noise, **counted}
    return Produced([path, *chunks], facts, len(mine))


def _flatten(
    arrays: dict[str, NDArray[np.float32]], core: Bounds, context: Context
) -> Banks | None:
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
    """Mean expected noise density of the points in each raster cell, north-up [1/m3].

    Sums in 64 bits of so few values of 24 bits each are exact: the points' order does not count.
    """
    rows, columns = (core.ymax - core.ymin) // cell, (core.xmax - core.xmin) // cell
    total, count = np.zeros(rows * columns), np.zeros(rows * columns, np.int64)
    mine = table.select(("x", "y", "noise_density")).take(inside(table["x"], table["y"], core))
    add_up_finite(surfacing.cell_number(mine, core, cell), mine["noise_density"], total, count)
    mean = np.where(count > 0, total / np.maximum(count, 1), NODATA)
    return np.ascontiguousarray(mean.reshape(rows, columns)[::-1], dtype=np.float32)


def _write_rasters(
    name: str, core: Bounds, arrays: dict[str, NDArray[np.float32]], context: Context
) -> list[Path]:
    """Raster cells of a ground cell; files of their chunks."""
    edge = quanta(context.workflow.ground.cell_m)
    for other in map(str, cells_touching(grow(core, edge), edge)):
        # When the survey was another a cell beside it owned some of its squares, or one of them
        # was a cell by itself: that receipt must not speak for chunks that are written over.
        receipt = None if other == name else read_receipt(context.store, "surface", other)
        if receipt and not receipt.failed and overlap(Bounds(*receipt.facts["core"]), core):
            forget_receipt(context.store, "surface", other)
    return write_cell(context.rasters, CellId(core.xmin // edge, core.ymin // edge), arrays)


def _mask_outside(arrays: dict[str, NDArray[np.float32]], core: Bounds, context: Context) -> None:
    """Take away raster cells whose centres lie outside the area of interest."""
    cell = quanta(context.workflow.products.cell_m)
    x = np.arange(core.xmin + cell // 2, core.xmax, cell, dtype=np.int64)
    y = np.arange(core.ymin + cell // 2, core.ymax, cell, dtype=np.int64)[::-1]
    east, north = (grid.ravel() for grid in np.meshgrid(x, y))
    polygons = read_polygons(context.resolve(context.workflow.aoi or ""), context.crs)
    outside = ~contains(polygons, east, north).reshape(len(y), len(x))
    for name, values in arrays.items():
        arrays[name] = np.where(outside, np.float32(NODATA), values)


def _cells(names: Sequence[str]) -> list[CellId]:
    return [parse_cell(name) for name in names]


def _units(units: Mapping[str, Sequence[Sequence[str]]]) -> Units:
    """Label units by tile, as a task's arguments carry them."""
    return {
        parse_cell(tile): [(kind, name) for kind, name in listed] for tile, listed in units.items()
    }
