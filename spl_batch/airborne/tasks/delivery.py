"""Stage ``deliver``: labels back to the input files, mosaics, points by tile."""

import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from spl_batch.airborne.catalogue.catalogues import write_catalogues
from spl_batch.airborne.context import Context
from spl_batch.airborne.products.cell_values import shape_of
from spl_batch.airborne.products.wide_voids import Void, void_findings, wide_voids
from spl_batch.airborne.pulses.swaths import Outlined, outlines
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.flown_lines import read_shifts
from spl_batch.airborne.store.label_tables import label_files, read_region, units_of
from spl_batch.airborne.store.raster_cells import stored_blocks
from spl_batch.airborne.tasks import index, pulses
from spl_batch.airborne.tasks.delivered_points import IN_NO_TILE, PLACE, Dropping, Terrain, gone
from spl_batch.airborne.tasks.stretches import Copies
from spl_batch.constants import FLAG_WITHHELD, NODATA, NOISE_NOT_ASSESSED, NOISE_SIGNAL, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.store.working_store import read_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import as_indexed, unchanged
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.geoid import Geoid
from spl_batch.formats.las.convert import conversion
from spl_batch.formats.las.copc import copy_as_copc
from spl_batch.formats.las.frame import Extent, header_changes
from spl_batch.formats.las.header import EXTERNAL_BIT, read_header
from spl_batch.formats.las.known_records import broken_records
from spl_batch.formats.las.layers import GIVEN
from spl_batch.formats.las.records import HEIGHT, record_layout
from spl_batch.formats.las.writer import (
    KEEP_BUT_GROUND,
    KEEP_CLASS,
    Decoded,
    added_dimensions,
    kept_classes,
    write_classified,
    write_points,
)
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.rasters.parts import BLOCK, centres, opened, place_m, windows
from spl_batch.formats.verified.parquet_npz import read_arrays, read_columns
from spl_batch.lattice.tables import COLUMNS, PointTable
from spl_batch.lattice.tiles import Bounds, parse_cell, quanta

PASS_POINTS = 32_000_000
"""Points of a file whose labels are held in memory at once [count]."""

_DELIVERED = ("noise_class", "classification")
_DIAGNOSTICS = ("noise_density", "p_value")
"""Labels that are written always, and where they are asked for."""

_FOUND_HERE = (HEIGHT, "flags")
"""What no unit has labelled: it follows from a point's place, or lies in its tile."""


def written_labels(workflow: Workflow) -> tuple[str, ...]:
    """Labels of a point that a delivered file is written by."""
    asked = workflow.outputs
    names = (*_DELIVERED, *_DIAGNOSTICS * asked.diagnostics)
    names += (*("set_flags",) * workflow.classes.flags, *(HEIGHT,) * asked.height_above_ground)
    return (*names, *("flags",) * bool(asked.drop))


class _FileLabels:
    """Labels of one input file by position, a pass of it at a time."""

    def __init__(self, args: Mapping[str, Any], context: Context, names: tuple[str, ...]) -> None:
        self.args = args
        self.context = context
        self.names = names
        self.start = self.stop = 0
        self.values: dict[str, NDArray[Any]] = {}
        self.counts, self.copied = np.zeros((2, 256), np.int64)

    def __call__(self, start: int, stop: int) -> Mapping[str, NDArray[Any]]:
        """Labels of points ``[start, stop)``."""
        if start < self.start or stop > self.stop:
            self._load(start, max(stop, start + PASS_POINTS))
        part = {k: v[start - self.start : stop - self.start] for k, v in self.values.items()}
        self.counts += np.bincount(part["noise_class"], minlength=256)
        return part

    def _load(self, start: int, stop: int) -> None:
        self.start, self.stop = start, min(stop, int(self.args["points"]))
        n = self.stop - self.start
        fill = {"noise_class": 255, "classification": KEEP_CLASS, "set_flags": 0}
        fill["flags"] = IN_NO_TILE
        self.values = {
            k: np.full(n, fill.get(k, np.nan), dtype=COLUMNS[k].dtype) for k in self.names
        }
        source = np.uint64(int(self.args["source"]))
        copied = np.zeros(n, np.bool_)
        for table, is_copy in self._tiles():
            mine = table.take(table["source"] == source)
            place = mine["index"].astype(np.int64)
            mine = mine.take((place >= self.start) & (place < self.stop))
            at = mine["index"].astype(np.int64) - self.start
            for name in self.names:
                self.values[name][at] = mine[name]
            copied[at] = is_copy
        classes, noise_class = self.values["classification"], self.values["noise_class"]
        _keep(classes, noise_class, self.context)
        noise_class[copied] = NOISE_NOT_ASSESSED
        self.values["copied"] = copied
        self.copied += np.bincount(classes[copied], minlength=256)
        if self.context.workflow.classes.withheld:
            self.values["set_flags"][copied] |= FLAG_WITHHELD

    def _tiles(self) -> Iterator[tuple[PointTable, bool]]:
        """Points of each tile that count, and their copies with the same labels."""
        store = self.context.store
        high = HEIGHT in self.names
        columns = ("source", "index", *PLACE * high, *("flags",) * ("flags" in self.names))
        labels = units_of(self.args, [name for name in self.names if name not in _FOUND_HERE])
        shifts = read_shifts(self.args, store) if high else None
        terrain = Terrain(self.args, self.context) if high else None
        files = label_files(store)
        for name in self.args["tiles"]:
            tile = parse_cell(name)
            table, _ = read_region(
                store, [tile], None, columns, labels, ordered=False, shifts=shifts, files=files
            )
            if terrain is not None:
                table = table.with_columns(HeightAboveGround=terrain.heights_above(tile, table))
            yield table, False
            if name in self.args["copies"]:
                copies = Copies(**read_arrays(store.path("copies", f"{name}.npz")))
                yield copies.of(table), True


def _keep(
    classification: NDArray[np.uint8], noise_class: NDArray[np.uint8], context: Context
) -> None:
    """Mark what keeps the class of its input: signal where only noise was asked for.

    Otherwise what nothing labelled keeps it, but for ground: class 2 is what this project found.
    """
    if context.workflow.outputs.classes == "noise":
        classification[noise_class == NOISE_SIGNAL] = KEEP_CLASS
    else:
        classification[classification == KEEP_CLASS] = KEEP_BUT_GROUND


def deliver_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Write one input file again with its labels: every point once, in order."""
    asked = context.workflow.outputs
    diagnostics, heights = asked.diagnostics, asked.height_above_ground
    lines = read_shifts(args, context.store)
    shifted = None if lines is None else lines.of_file(args["spans"])
    labels = _FileLabels(args, context, written_labels(context.workflow))
    classes = np.zeros((2, 256), np.int64)
    target = context.output / "laz" / args["delivered"]
    source = Path(args["path"])
    stamp = as_indexed("index_file", args, context)
    extent = Extent.from_arrays(read_arrays(context.store.path("index", f"{args['source']}.npz")))
    with unchanged(source, stamp):
        header = read_header(source)
        dropping = Dropping(asked.drop, args["points"], header, context) if asked.drop else None
        written = write_classified(
            source,
            target,
            labels=labels,
            diagnostics=diagnostics,
            flags=context.workflow.classes.flags,
            heights=heights,
            crs=context.crs,
            # Of a file whose layers can be copied the index keeps what they hold.
            decoded=Decoded(_Given(args, context), extent) if extent.n_points else None,
            classes=classes,
            shifted=shifted,
            standard=args["standard"],
            kept=dropping,
        )
    copy, outputs = read_header(target), [target]
    waveforms = args["waveforms"]
    if waveforms and copy.global_encoding & EXTERNAL_BIT:
        outputs.append(context.output / "laz" / waveforms["delivered"])
        with (
            unchanged(Path(waveforms["path"]), waveforms["stamp"]),
            replacing(outputs[-1]) as temporary,
        ):
            shutil.copyfile(waveforms["path"], temporary)
    broken = Counter(broken_records(header))
    added = added_dimensions(record_layout(header), diagnostics=diagnostics, heights=heights)
    mended = Counter(
        f"extra dimension {name!a} is described anew"
        for name in conversion(record_layout(header), added).mended
    )
    labels.copied[KEEP_BUT_GROUND:] = 0
    labels.copied -= 0 if dropping is None else dropping.copied
    facts = {
        "name": args["delivered"],
        "points": written,
        "noise_class": _nonzero(labels.counts),
        "classes": _nonzero(classes.sum(axis=0) - labels.copied),
        "written": _nonzero(classes.sum(axis=0)),
        "assessed": _nonzero(classes[1]),
        **({} if dropping is None else dropping.facts()),
        "records_left_out": broken.total(),
        "header_changes": header_changes(header, copy),
        "findings": [*_of_header(broken, "left_out"), *_of_header(mended, "changed")],
    }
    return Produced(outputs, facts, written)


def _of_header(records: Mapping[str, int], kind: str) -> Iterator[Finding]:
    """Name what of a header a copy does without, or has in another way."""
    for text, n in records.items():
        yield Finding("I01", {"kind": kind, "what": f"{text}{f', {n} times' if n > 1 else ''}"})


class _Given:
    """What the index keeps of each record, some parts of a file at a time."""

    def __init__(self, args: Mapping[str, Any], context: Context) -> None:
        self.source, self.folder = args["source"], context.store.path("given")
        self.parts = range(0)
        self.values = np.empty(0, np.uint32)

    def __call__(self, start: int, stop: int) -> NDArray[np.uint32]:
        """Of records ``[start, stop)``."""
        size = index.CHUNK_POINTS * index.PART_CHUNKS
        parts = range(start // size, -(-stop // size))
        if parts != self.parts:
            names = (f"{index.part_name(self.source, part)}.parquet" for part in parts)
            held = [read_columns(self.folder / name, [GIVEN])[GIVEN] for name in names]
            self.values, self.parts = np.concatenate(held), parts
        return self.values[start - parts.start * size : stop - parts.start * size]


def _nonzero(counts: NDArray[np.int64]) -> dict[str, int]:
    return {str(k): int(v) for k, v in enumerate(counts) if v}


def deliver_tile(args: Mapping[str, Any], context: Context) -> Produced:
    """Write a tile's points with their labels."""
    asked, flags = context.workflow.outputs, context.workflow.classes.flags
    names = (*_DELIVERED, *("set_flags",) * flags)
    cell = parse_cell(args["tile"])
    labels = units_of(args, names)
    columns = (
        *("x", "y", "z", "gps_time", "channel", "return_number", "number_of_returns"),
        *("intensity", "input_class"),
        *("flags",) * bool(asked.drop),
    )
    lines = read_shifts(args, context.store)
    table, _ = read_region(
        context.store, [cell], None, columns, labels, ordered=False, shifts=lines
    )
    record = None if lines is None else lines.record()
    labelled = table["classification"].copy()
    _keep(labelled, table["noise_class"], context)
    table = table.with_columns(classification=kept_classes(labelled, table["input_class"]))
    if asked.height_above_ground:
        above = Terrain(args, context).heights_above(cell, table)
        table = table.with_columns(HeightAboveGround=above)
    for kind in asked.drop:
        set_flags = table["set_flags"] if flags else np.zeros(len(table), np.uint8)
        table = table.take(~gone(kind, table["classification"], set_flags, table["flags"]))
    copc = asked.tiles == "copc"
    target = context.output / "tiles" / f"{args['tile']}{'.copc' if copc else ''}.laz"
    extra = {"noise_class": table["noise_class"]}
    write_points(
        target,
        table,
        crs=context.crs,
        extra=extra,
        copc=copc,
        records_of_file=[] if record is None else [record],
    )
    return Produced([target], {"points": len(table)}, len(table))


def deliver_copc(args: Mapping[str, Any], context: Context) -> Produced:
    """Write a delivered cloud once more, as an octree: the same points with all dimensions."""
    target = context.output / args["target"]
    written = copy_as_copc(context.output / args["source"], target)
    return Produced([target], {"points": written}, written)


def deliver_catalogue(args: Mapping[str, Any], context: Context) -> Produced:
    """Write what other tools open at once: STAC, virtual point cloud, index."""
    drawn = outlines(
        _outlined(args["cells"], context),
        {one["number"]: one["id"] for one in args["flightlines"]},
    )
    survey = context.workflow.survey
    written, remarks = write_catalogues(context.output, survey, context.crs, args, drawn)
    facts = {"name": "catalogue", "findings": [Finding("D01", {"what": text}) for text in remarks]}
    return Produced(written, facts)


def _outlined(cells: Iterable[str], context: Context) -> Iterator[Sequence[Outlined]]:
    """Where swaths lie in each ground cell, by its receipt."""
    for name in cells:
        receipt = read_receipt(context.store, "surface", name)
        if receipt is not None and not receipt.failed:
            yield receipt.facts.get(pulses.OUTLINES, ())


def deliver_geoid(args: Mapping[str, Any], context: Context) -> Produced:
    """Write heights of a model once more above a geoid, some of them at a time."""
    named = context.workflow.outputs.geoid
    if named is None:  # a plan makes no such task
        raise WorkflowError("outputs.geoid: none is named")
    geoid = Geoid(named.grid, context.resolve(named.grid), context.crs)
    source, target = (context.output / f"{args[key]}.tif" for key in ("source", "name"))
    beyond = 0

    def blocks() -> Iterator[tuple[int, int, NDArray[np.float32]]]:
        nonlocal beyond
        for window in windows(Window(0, 0, model.width, model.height), BLOCK):
            heights = model.read(1, window=window)
            x, y = centres((left_m, top_m), cell_m, window)
            height_m = heights * context.units.vertical_m
            above = height_m - geoid.heights(x.ravel(), y.ravel()).reshape(heights.shape)
            known = heights != np.float32(NODATA)
            beyond += int(np.count_nonzero(known & np.isnan(above)))
            kept = np.where(known & ~np.isnan(above), above, NODATA)
            yield window.row_off, window.col_off, kept.astype(np.float32)

    with opened(source) as model:
        left_m, top_m, cell_m = place_m(model)
        write_cog(
            target,
            blocks(),
            shape=model.shape,
            origin_xy_m=(left_m, top_m),
            cell_m=cell_m,
            crs=geoid.crs_above(named.crs).to_wkt(),
            description=args["meaning"],
            unit=args["unit"],
        )
    lost = Finding("I05", {"kind": "geoid", "count": beyond, "grid": named.grid})
    return Produced([target], {"name": target.name, "findings": [lost] if beyond else []})


def mosaic(args: Mapping[str, Any], context: Context) -> Produced:
    """Join a product's raster cells into one cloud-optimised GeoTIFF."""
    cell_m, bounds = context.workflow.products.cell_m, Bounds(*args["bounds"])
    shape = shape_of(bounds, quanta(cell_m))
    origin_xy_m = bounds.xmin * QUANTUM_M, bounds.ymax * QUANTUM_M
    target = (context.output if args["delivered"] else context.store.local) / f"{args['name']}.tif"
    stored = partial(stored_blocks, context.store, cells=args["cells"], bounds=bounds)
    write_cog(
        target,
        stored(args["name"]),
        shape=shape,
        origin_xy_m=origin_xy_m,
        cell_m=cell_m,
        crs=context.crs_wkt or None,
        description=args["meaning"],
        unit=args["unit"],
    )
    facts: dict[str, Any] = {"name": target.name}
    if args["name"] == "dtm":
        found = wide_voids(stored("dtm"), stored("density"), shape, origin_xy_m, cell_m)
        facts["findings"] = _voids(found, context)
    return Produced([target], facts)


def _voids(found: list[Void], context: Context) -> list[Finding]:
    """A finding on voids in the terrain; holes of the area of interest are none."""
    if found and context.workflow.aoi is not None:
        east, north = (np.array([quanta(one[k]) for one in found], np.int64) for k in (1, 2))
        inside = context.within(context.workflow.aoi, east, north)
        found = [one for one, there in zip(found, inside, strict=True) if there]
    return void_findings(found, context.workflow.products.void_max_m)
