"""Stages ``shots`` and ``shuffle``: whole shots of a flightline, stretch by stretch.

A stretch is a run of whole shots on the flightline's absolute grid. Everything that is
computed here is keyed on that grid, so where a flightline is cut does not matter.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.io.las import iter_points
from spl_batch.io.polygons import contains, read_polygons
from spl_batch.io.store import write_voxels
from spl_batch.io.tables import (
    group_ranges,
    read_arrays,
    read_table,
    write_arrays,
    write_table,
    writing,
)
from spl_batch.io.trajectory import read_slice
from spl_batch.model import (
    COLUMNS,
    EXCLUDED,
    SOURCE_COLUMNS,
    TILE_COLUMNS,
    BeamTable,
    PointFlag,
    PointTable,
    ShotClock,
    Trajectory,
    canonical_order,
    concat,
)
from spl_batch.runner.context import Context, Produced
from spl_batch.runner.index import RUN_POINTS
from spl_batch.sensor import Sensor
from spl_batch.stages import afterpulse, geometry, line_noise, voxel_noise
from spl_batch.tiling import cell_index, quanta

GROUP_POINTS = 16_384
"""Points of a row group of a re-ordered file [count]."""

CHUNK_POINTS = RUN_POINTS * 16
"""Points read at once from an input file [count]."""

STRETCH_COLUMNS = (*SOURCE_COLUMNS, "shot")
_TIME_ORDER = ("gps_time", "channel", "return_number", "x", "y", "z", "source", "index")


def sort_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Re-order a file that is not in time order, so that a stretch reads little of it.

    Each chunk is sorted and cut into short row groups, whose footers tell their times;
    a stretch then reads at most one group too many from each chunk.
    """
    path = context.store.path("sorted", f"{args['source']}.parquet")
    points = 0
    with writing(path, {name: COLUMNS[name].dtype for name in SOURCE_COLUMNS}) as writer:
        for table in _chunks(args, context, 0, None):
            usable = table.take(np.isfinite(table["gps_time"]) & ~table.has(EXCLUDED))
            usable = usable.take(_time_order(usable))
            for start in range(0, len(usable), GROUP_POINTS):
                writer.write(usable.take(slice(start, start + GROUP_POINTS)).columns)
            points += len(usable)
    return Produced([path], {}, points)


def gather(args: Mapping[str, Any], context: Context) -> Produced:
    """Collect a stretch's points from every file that has some, and observe its noise."""
    clock = ShotClock(args["t0_s"], args["prf_hz"])
    pieces = [
        _of_stretch(piece, args, clock)
        for source in args["sources"]
        for piece in _source_pieces(source, args, context)
    ]
    table = concat(pieces, STRETCH_COLUMNS)
    table = table.take(_time_order(table))
    path = context.store.path("stretches", f"{args['stretch']}.parquet")
    write_table(path, table)
    outputs = [path]
    facts: dict[str, Any] = {"points": len(table), "uncovered": 0}
    if len(table):
        beams = _beams(table, context, args)
        facts["uncovered"] = int(np.count_nonzero(~beams.known))
        facts["uncovered_span_s"] = _span(table["gps_time"][~beams.known])
        observed = line_noise.observe(table, beams, context.workflow.noise)
        stats = context.store.path("observed", f"{args['stretch']}.npz")
        write_arrays(stats, observed)
        outputs.append(stats)
    return Produced(outputs, facts, len(table))


def gather_range(args: Mapping[str, Any], context: Context) -> Produced:
    """Collect a run of points of a file without times: no shots, no beams, no noise model."""
    pieces = [
        table.take(~table.has(EXCLUDED))
        for table in _chunks(args, context, int(args["start"]), int(args["stop"]))
    ]
    table = concat(pieces, SOURCE_COLUMNS)
    table = table.with_columns(shot=np.zeros(len(table), np.int64))
    path = context.store.path("stretches", f"{args['stretch']}.parquet")
    write_table(path, table)
    return Produced([path], {"points": len(table), "uncovered": 0}, len(table))


def fit_line(args: Mapping[str, Any], context: Context) -> Produced:
    """Line noise model of a flightline, from what its stretches observed."""
    parts = [read_arrays(context.store.path("observed", f"{s}.npz")) for s in args["stretches"]]
    model = line_noise.fit(line_noise.merge(parts), context.workflow.noise, _sensor(args, context))
    path = context.store.path("lines", f"{args['line']}.npz")
    write_arrays(path, model.to_arrays())
    seen = model.seen_fraction
    facts = {
        **{k: args[k] for k in ("points", "span_s", "prf_hz", "prf_basis")},
        "basis": _basis(args),
        "gate_m": model.gate_m,
        "noise_per_m": model.mean_rate,
        "seen_fraction": float(seen.mean()) if len(seen) else None,
        "warnings": list(model.warnings),
    }
    return Produced([path], facts, args["points"])


def scatter(args: Mapping[str, Any], context: Context) -> Produced:
    """Line noise density, voxel deposits and afterpulses of a stretch; points by tile."""
    table = read_table(
        context.store.path("stretches", f"{args['stretch']}.parquet"), STRETCH_COLUMNS
    )
    outputs: list[Path] = []
    facts: dict[str, Any] = {"tiles": {}}
    zeros = np.zeros(len(table), np.float32)
    table = table.with_columns(line_density=zeros, afterpulse=zeros)
    if len(table) and not args["timeless"]:
        table, part_path = _assess(table, args, context, facts)
        outputs.append(part_path)
    table = _mark_places(table, context)
    tile_q = quanta(context.workflow.tiling.tile_m)
    i, j = cell_index(table["x"], tile_q), cell_index(table["y"], tile_q)
    order = np.lexsort((i, j))
    table, i, j = table.take(order), i[order], j[order]
    starts = [0, *(np.flatnonzero((np.diff(i) != 0) | (np.diff(j) != 0)) + 1).tolist()]
    path = context.store.path("scatter", f"{args['stretch']}.parquet")
    write_table(path, table.select(TILE_COLUMNS), group_starts=starts)
    ends = [*starts[1:], len(table)]
    if len(table):
        facts["tiles"] = {
            f"{i[a]}_{j[a]}": [group, b - a]
            for group, (a, b) in enumerate(zip(starts, ends, strict=True))
        }
    return Produced([path, *outputs], facts, len(table))


def build_tile(args: Mapping[str, Any], context: Context) -> Produced:
    """Join a tile's points from the stretches, in canonical order."""
    pieces = [
        read_table(context.store.path("scatter", f"{stretch}.parquet"), TILE_COLUMNS, [group])
        for stretch, group in args["pieces"]
    ]
    table = concat(pieces, TILE_COLUMNS)
    table = table.take(canonical_order(table))
    path = context.store.tile(args["tile"])
    starts = np.arange(0, max(len(table), 1), RUN_POINTS)
    write_table(path, table, group_starts=starts.tolist())
    facts = {
        "points": len(table),
        "z": [int(table["z"].min()), int(table["z"].max())] if len(table) else None,
        "outside_aoi": int(np.count_nonzero(table.has(PointFlag.OUTSIDE_AOI))),
        "no_beam": int(np.count_nonzero(table.has(PointFlag.NO_BEAM))),
        "sources": sorted({str(s) for s in np.unique(table["source"]).tolist()}),
    }
    return Produced([path], facts, len(table))


def _assess(
    table: PointTable, args: Mapping[str, Any], context: Context, facts: dict[str, Any]
) -> tuple[PointTable, Path]:
    """Add what the time domain knows about each point; write the voxel part."""
    workflow = context.workflow
    beams = _beams(table, context, args)
    flags = np.where(beams.known, table["flags"], table["flags"] | PointFlag.NO_BEAM)
    table = table.with_columns(flags=flags)
    known = np.flatnonzero(beams.known)
    subset, beams = table.take(known), _take_beams(beams, known)
    model = line_noise.LineModel.from_arrays(
        read_arrays(context.store.path("lines", f"{args['line']}.npz"))
    )
    density = np.zeros(len(table), np.float32)
    density[known] = line_noise.line_density(subset, model)
    chance = np.zeros(len(table), np.float32)
    if workflow.afterpulse.enabled:
        chance[known] = afterpulse.probability(
            subset, beams, workflow.afterpulse, _sensor(args, context), gate_m=model.gate_m
        )
    part = voxel_noise.deposit(subset, beams, model, workflow.noise)
    path = context.store.path("voxels", f"{args['stretch']}.zarr")
    write_voxels(path, part)
    facts["voxels"] = [
        *part.corner,
        *(c + n for c, n in zip(part.corner, part.amount.shape, strict=True)),
    ]
    return table.with_columns(line_density=density, afterpulse=chance), path


def _mark_places(table: PointTable, context: Context) -> PointTable:
    """Set the flags that polygons decide."""
    flags = table["flags"].copy()
    workflow = context.workflow
    for name, flag, within in (
        (workflow.aoi, PointFlag.OUTSIDE_AOI, False),
        (workflow.water, PointFlag.WATER, True),
    ):
        if name is not None and len(table):
            polygons = read_polygons(context.resolve(name), context.crs)
            flags[contains(polygons, table["x"], table["y"]) == within] |= np.uint8(flag)
    return table.with_columns(flags=flags)


def _time_order(table: PointTable) -> NDArray[np.intp]:
    return np.lexsort([table[k] for k in reversed(_TIME_ORDER)])


def _beams(table: PointTable, context: Context, args: Mapping[str, Any]) -> BeamTable:
    trajectory: Trajectory | None = None
    if args["trajectory"]:
        time = table["gps_time"]
        trajectory = read_slice(
            context.store.path("trajectory.parquet"), float(time.min()), float(time.max())
        )
    return geometry.beams(table, trajectory, heading_rad=args["heading_rad"])


def _take_beams(beams: BeamTable, rows: NDArray[np.intp]) -> BeamTable:
    return BeamTable(
        beams.origin_m[rows],
        beams.direction[rows],
        beams.range_m[rows],
        beams.known[rows],
    )


def _sensor(args: Mapping[str, Any], context: Context) -> Sensor:
    """The instrument; without a channel dimension a shot is one beamlet."""
    return context.workflow.sensor.model_copy(update={"beamlets": args["beamlets"]})


def _basis(args: Mapping[str, Any]) -> str:
    if args["trajectory"]:
        return "trajectory"
    return "vertical" if args["heading_rad"] is None else "scan_angle"


def _span(time: NDArray[np.float64]) -> list[float] | None:
    return [float(time.min()), float(time.max())] if len(time) else None


def _of_stretch(table: PointTable, args: Mapping[str, Any], clock: ShotClock) -> PointTable:
    """Rows of the stretch, with their shot numbers."""
    first, last = args["span_s"]
    time = table["gps_time"]
    mine = np.isfinite(time) & (time >= first) & (time <= last) & ~table.has(EXCLUDED)
    table = table.take(mine & (table["point_source_id"] == args["psid"]))
    table = table.with_columns(shot=clock.shot(table["gps_time"]))
    low, high = args["shots"]
    return table.take((table["shot"] >= low) & (table["shot"] < high))


def _source_pieces(
    source: Mapping[str, Any], args: Mapping[str, Any], context: Context
) -> Iterator[PointTable]:
    """Chunks of a file that can hold points of a time span."""
    low_s, high_s = args["window_s"]
    if source["sorted"]:
        path = context.store.path("sorted", f"{source['source']}.parquet")
        for group, (first, last) in enumerate(group_ranges(path, "gps_time")):
            if first <= high_s and last >= low_s:
                yield read_table(path, SOURCE_COLUMNS, [group])
        return
    index = read_arrays(context.store.path("index", f"{source['source']}.npz"))
    hits = np.flatnonzero((index["first"] <= high_s) & (index["last"] >= low_s))
    if not len(hits):
        return
    for run in np.split(hits, np.flatnonzero(np.diff(hits) > 1) + 1):
        start, stop = int(run[0]) * RUN_POINTS, (int(run[-1]) + 1) * RUN_POINTS
        yield from _chunks(source, context, start, stop)


def _chunks(
    source: Mapping[str, Any], context: Context, start: int, stop: int | None
) -> Iterator[PointTable]:
    return iter_points(
        Path(source["path"]),
        channel_dimension=context.workflow.survey.channel_dimension,
        source=int(source["source"]),
        start=start,
        stop=stop,
        chunk=CHUNK_POINTS,
    )
