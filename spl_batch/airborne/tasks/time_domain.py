"""Stages ``shots`` and ``shuffle``: whole shots of a flightline, stretch by stretch.

A stretch is a run of whole shots on the flightline's absolute grid. Everything that is
computed here is keyed on that grid, so where a flightline is cut does not matter.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from spl_batch.airborne import shots
from spl_batch.airborne.afterpulse import afterpulse_law
from spl_batch.airborne.afterpulse.law_warnings import disagreements, uneven
from spl_batch.airborne.context import Context
from spl_batch.airborne.filter.published import shot_noise
from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.products.reflectance import fired_beamlets
from spl_batch.airborne.store.flown_lines import Pass, line_of
from spl_batch.airborne.store.voxel_parts import write_voxels
from spl_batch.airborne.tasks import lines_of_sight
from spl_batch.airborne.tasks.stretches import read_kept, read_stretch, repeats, without_copies
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.gps_clock import usable_times
from spl_batch.formats.verified.parquet_npz import (
    read_arrays,
    read_rows,
    write_arrays,
    write_table,
)
from spl_batch.lattice.distinct import distinct
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import (
    CANONICAL_ORDER,
    SOURCE_COLUMNS,
    TILE_COLUMNS,
    BeamTable,
    PointFlag,
    PointTable,
    ShotClock,
    concat,
)
from spl_batch.lattice.tiles import cell_index, quanta

GROUP_POINTS = 16_384
"""Points of a row group [count]: a halo is read from few of a tile, and small tiles share one."""

ALIKE = CANONICAL_ORDER[:-2]
"""Points alike in all of these are copies if they have times, which a later delivery may give
another intensity; others if that is alike as well."""

_POINT_COLUMNS = tuple(name for name in TILE_COLUMNS if name in SOURCE_COLUMNS)


def fit_line(args: Mapping[str, Any], context: Context) -> Produced:
    """Line noise model of a flightline, from what its stretches observed."""
    parts = [read_arrays(context.store.path("observed", f"{s}.npz")) for s in args["stretches"]]
    beamlets = lines_of_sight.beamlets(args, context)
    model, law, rate = shots.fit(parts, context.workflow.noise, beamlets)
    path = context.store.path("lines", f"{args['line']}.npz")
    found: tuple[Finding, ...] = ()
    if context.workflow.afterpulse.enabled:
        found = disagreements(law, beamlets.seen)
        found += uneven(parts, _spans_s(args), law, rate, beamlets.seen)
    write_arrays(path, {**model.to_arrays(), **law.to_arrays()})
    seen = model.seen_fraction
    facts = {
        **{k: args[k] for k in ("points", "span_s", "prf_hz", "prf_basis", "beamlets", "basis")},
        "name": str(args["line"]),
        "gate_m": model.gate_m,
        "gate_basis": model.gate_basis,
        "noise_per_m": model.mean_rate,
        "seen_fraction": float(seen.mean()) if len(seen) else None,
        "findings": [*model.findings, *found],
    }
    return Produced([path], facts, args["points"])


def _spans_s(args: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Times of the stretches of a flightline, as far as it goes [s]."""
    first, last = args["span_s"]
    starts = [args["t0_s"] + int(name.rpartition("/")[2]) * args["stretch_s"]
              for name in args["stretches"]]  # fmt: skip
    return [(max(start, first), min(start + args["stretch_s"], last)) for start in starts]


def scatter(args: Mapping[str, Any], context: Context) -> Produced:
    """Line noise density, voxel deposits and afterpulses of a stretch; points by tile."""
    if args["timeless"]:
        columns = (*_POINT_COLUMNS, "point_source_id")
        table, copies = read_kept(args["kept"], context, columns), None
        passes = [Pass(*one) for one in args["passes"]]
        line = line_of(table["point_source_id"], table["gps_time"], passes)
    else:
        table, copies = read_stretch(
            args, context, (*_POINT_COLUMNS, *lines_of_sight.columns(args))
        )
        line = np.full(len(table), args["number"], np.uint16)
    outputs: list[Path] = []
    facts: dict[str, Any] = {"tiles": {}}
    zeros = np.zeros(len(table), np.float32)
    table = table.with_columns(
        line_density=zeros, afterpulse=zeros, afterpulse_rate=zeros, afterpulse_share=zeros,
        range_sigma=zeros, line=line,
    )  # fmt: skip
    if len(table) and not args["timeless"]:
        table, parts = _assess(table, args, context, facts)
        outputs.extend(parts)
    table = _mark_places(table, context).select(TILE_COLUMNS)
    if copies is not None and len(copies.row):
        table = concat([table, copies.of(table)], TILE_COLUMNS)
    tile_q = quanta(context.workflow.tiling.tile_m)
    i, j = cell_index(table["x"], tile_q), cell_index(table["y"], tile_q)
    order = lexicographic_order((j, i))
    table, i, j = table.take(order), i[order], j[order]
    starts = [0, *(np.flatnonzero((np.diff(i) != 0) | (np.diff(j) != 0)) + 1).tolist()]
    path = context.store.path("scatter", f"{args['stretch']}.parquet")
    ends = [*starts[1:], len(table)]
    write_table(path, table, group_starts=_group_starts(ends), sought=())
    if len(table):
        facts["tiles"] = {f"{i[a]}_{j[a]}": [a, b - a] for a, b in zip(starts, ends, strict=True)}
    return Produced([path, *outputs], facts, len(table))


def _group_starts(ends: Sequence[int]) -> list[int]:
    """First row of each row group, by the end of each tile: small tiles share one.

    Whoever reads a tile reads the footer, which is as long as there are groups.
    """
    starts = [0]
    for end, following in pairwise(ends):
        if following - starts[-1] > GROUP_POINTS:
            starts.append(end)
    return starts


def build_tile(args: Mapping[str, Any], context: Context) -> Produced:
    """Join a tile's points from the stretches, in canonical order, each of them once.

    Copies of a stretch follow the returns that count; of files without times the first one counts.
    Where nothing is filtered, copies may name another flightline: otherwise noise is computed for
    each flightline, and a finding names those that are copies.
    """
    pieces = [
        read_rows(context.store.path("scatter", f"{stretch}.parquet"), TILE_COLUMNS, first, count)
        for stretch, first, count in args["pieces"]
    ]
    table = concat(pieces, TILE_COLUMNS)
    alike: tuple[str, ...] = (*ALIKE, "line") if args["by_line"] else ALIKE
    order = dict.fromkeys((*alike, "intensity", "line"))
    table = table.take(lexicographic_order([table[name] for name in order]))
    timed = usable_times(table["gps_time"]) & (table["gps_time"] != 0.0)
    again = repeats(table, alike) & (timed | repeats(table, ("intensity",)))
    table, copies = without_copies(table, again)
    path = context.store.table("tiles", args["tile"])
    outputs = [path]
    if len(copies.row):
        outputs.append(context.store.path("copies", f"{args['tile']}.npz"))
        write_arrays(outputs[-1], copies._asdict())
    pairs = np.stack([copies.source, table["source"][copies.row]], axis=1)
    pairs, counts = np.unique(pairs, axis=0, return_counts=True)
    starts = np.arange(0, max(len(table), 1), GROUP_POINTS)
    write_table(path, table, group_starts=starts.tolist(), sought=("x",))
    facts = {
        "points": len(table),
        "outside_aoi": int(np.count_nonzero(table.has(PointFlag.OUTSIDE_AOI))),
        "no_beam": int(np.count_nonzero(table.has(PointFlag.NO_BEAM))),
        "sources": sorted({str(s) for piece in pieces for s in distinct(piece["source"])[0]}),
        "copies": [[*map(str, p), n] for p, n in zip(pairs.tolist(), counts.tolist(), strict=True)],
    }
    return Produced(outputs, facts, len(table))


def _assess(
    table: PointTable, args: Mapping[str, Any], context: Context, facts: dict[str, Any]
) -> tuple[PointTable, list[Path]]:
    """Add what the time domain knows about each point; write the parts of the stretch."""
    workflow = context.workflow
    sights = lines_of_sight.beams(table, context.store, args)
    line = read_arrays(context.store.path("lines", f"{args['line']}.npz"))
    law = afterpulse_law.AfterpulseLaw.from_arrays(line)
    model = LineModel.from_arrays(line)
    beamlets = lines_of_sight.beamlets(args, context)
    table, lit, beams, ground = shots.assess(table, sights, (model, law), workflow, beamlets)
    if args["of_shots"] is not None:
        array = beamlets.seen.array_columns
        noise = shot_noise(lit, beams, workflow.filter, model.gate_m, array)
        flags = table["flags"].copy()
        flags[sights.known] |= noise * np.uint8(PointFlag.SHOT_NOISE)
        table = table.with_columns(flags=flags)
    parts = voxel_noise.deposit(lit, beams, model, workflow.noise, ground)
    # A stretch is one box of voxels, unless some of its points lie far from the rest.
    names = [f"{args['stretch']}{f'.{k}' if k else ''}" for k in range(len(parts))]
    paths = [context.store.path("voxels", f"{name}.zarr") for name in names]
    for path, part in zip(paths, parts, strict=True):
        write_voxels(path, part)
    facts["voxels"] = {name: part.box() for name, part in zip(names, parts, strict=True)}
    return table, [*paths, *_write_fired(lit, beams, model, args, context, facts)]


def _write_fired(
    table: PointTable,
    beams: BeamTable,
    model: LineModel,
    args: Mapping[str, Any],
    context: Context,
    facts: dict[str, Any],
) -> list[Path]:
    """Write where the beamlets pointed, if the sensor's positions and the channels tell."""
    if args["basis"] not in lines_of_sight.POSITIONED or args["beamlets"] < 2:
        return []
    clock = ShotClock(args["t0_s"], args["prf_hz"])
    sensor = lines_of_sight.beamlets(args, context).seen
    part = fired_beamlets.aim(table, beams, model, sensor, clock, args["number"])
    facts["fired"] = part.reach()
    path = context.store.path("fired", f"{args['stretch']}.npz")
    write_arrays(path, part.to_arrays())
    return [path]


def _mark_places(table: PointTable, context: Context) -> PointTable:
    """Set the flags that polygons decide."""
    flags = table["flags"].copy()
    workflow = context.workflow
    for name, flag, within in (
        (workflow.aoi, PointFlag.OUTSIDE_AOI, False),
        (workflow.water, PointFlag.WATER, True),
    ):
        if name is not None and len(table):
            flags[context.within(name, table["x"], table["y"]) == within] |= np.uint8(flag)
    return table.with_columns(flags=flags)
