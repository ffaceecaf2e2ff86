"""Stages ``shots`` and ``shuffle``: whole shots of a flightline, stretch by stretch.

A stretch is a run of whole shots on the flightline's absolute grid. Everything that is
computed here is keyed on that grid, so where a flightline is cut does not matter.

Without a trajectory a stretch leaves its best lines of sight first; a flightline's path is the
place where they meet, and only then can the stretches be observed.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from spl_batch.airborne import shots
from spl_batch.airborne.afterpulse import afterpulse_law
from spl_batch.airborne.afterpulse.law_warnings import disagreements, uneven
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams import sensor_path as paths
from spl_batch.airborne.context import Context
from spl_batch.airborne.filter.published import shot_noise
from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.products.reflectance import fired_beamlets
from spl_batch.airborne.store.flown_lines import Pass, line_of
from spl_batch.airborne.store.voxel_parts import voxel_file, write_voxels
from spl_batch.airborne.tasks.line_findings import line_findings
from spl_batch.airborne.tasks.stretches import (
    GROUP_POINTS,
    read_kept,
    read_stretch,
    repeats,
    without_copies,
)
from spl_batch.engine.findings import Finding
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.gps_clock import leap_seconds, usable_times
from spl_batch.formats.trajectory.positions import read_slice, write_trajectory
from spl_batch.formats.verified.parquet_npz import (
    read_arrays,
    read_rows,
    write_arrays,
    write_table,
)
from spl_batch.lattice.row_order import distinct, lexicographic_order
from spl_batch.lattice.tables import (
    CANONICAL_ORDER,
    SOURCE_COLUMNS,
    TILE_COLUMNS,
    BeamTable,
    PointFlag,
    PointTable,
    ShotClock,
    Trajectory,
    concat,
)
from spl_batch.lattice.tiles import cell_index, quanta

ALIKE = CANONICAL_ORDER[:-2]
"""Points alike in all of these are copies if they have times, which a later delivery may give
another intensity; others if that is alike as well."""

_POINT_COLUMNS = tuple(name for name in TILE_COLUMNS if name in SOURCE_COLUMNS)


_POSITIONED: Final = ("trajectory", "intersection")
"""What beams may be taken from that has positions of the sensor; else by scan angle or vertical."""

SIGHT_RETURNS: Final = 262_144
"""Returns of a stretch whose lines of sight are compared with the trajectory [count]."""


def _columns(args: Mapping[str, Any]) -> tuple[str, ...]:
    """Columns that beams are found from, beyond those that points of a stretch always have."""
    return () if args["heading_rad"] is None else ("scan_angle",)


def _beams(table: PointTable, store: Store, args: Mapping[str, Any]) -> BeamTable:
    """Line of sight of each point of a stretch: by trajectory, found path, or scan angle.

    ``args``: ``line``, ``basis`` and ``heading_rad`` of the task.
    """
    trajectory: Trajectory | None = None
    if args["basis"] in _POSITIONED:
        path = store.path("trajectory.parquet")
        if args["basis"] == "intersection":
            path = store.path("paths", f"{args['line']}.parquet")
        time = table["gps_time"]
        trajectory = read_slice(path, float(time.min()), float(time.max()))
    return geometry.beams(table, trajectory, heading_rad=args["heading_rad"])


def _beamlets(args: Mapping[str, Any], context: Context) -> shots.Beamlets:
    """How the shots of a stretch are seen; beams may separate beamlets that no file numbers."""
    sensor = context.workflow.sensor
    unnumbered = args["beamlets"] == 1 and sensor.beamlets > 1
    return shots.Beamlets(sensor, args["beamlets"], unnumbered and args["basis"] in _POSITIONED)


def sensor_path(args: Mapping[str, Any], context: Context) -> Produced:
    """Path of the sensor over a flightline, from the lines of sight of its stretches.

    Where they do not meet, the flight direction: scan angles lean to its starboard.
    """
    parts = [read_arrays(context.store.path("sights", f"{s}.npz")) for s in args["stretches"]]
    first, last = args["span_s"]
    found = paths.find_path(paths.merge(parts), (first, last))
    if found.trajectory is None:
        heading = geometry.heading_from_track(geometry.merge_track(parts))
        facts = {"basis": "vertical" if heading is None else "scan_angle", "heading_rad": heading}
        return Produced((), facts, args["points"])
    path = context.store.path("paths", f"{args['line']}.parquet")
    write_trajectory(path, [(found.trajectory.time_s, found.trajectory.xyz_m)])
    return Produced([path], {"basis": "intersection", "heading_rad": None}, args["points"])


def sights(args: Mapping[str, Any], context: Context) -> Produced:
    """Leave the best lines of sight of a stretch, whose beams are not known yet.

    And how its points drift: where these lines do not meet, the flight direction follows from that.
    """
    table, _ = read_stretch(args, context, ("scan_angle",))
    if not len(table):
        return Produced((), {"points": 0})
    lines = paths.collect(table, args["beamlets"], context.workflow.noise.interval_shots)
    path = context.store.path("sights", f"{args['stretch']}.npz")
    write_arrays(path, lines | geometry.observe_track(table))
    return Produced([path], {"points": len(table)}, len(table))


def _other_unit(
    table: PointTable, known: BeamTable, args: Mapping[str, Any], context: Context
) -> tuple[float, float] | None:
    """Heights of the sensor by the trajectory and by lines of sight, where units differ [m]."""
    some = table.take(slice(0, SIGHT_RETURNS))
    interval = context.workflow.noise.interval_shots
    lines = paths.Lines(**paths.collect(some, args["beamlets"], interval))
    row = np.searchsorted(some["gps_time"], lines.time_s)
    return paths.other_unit(lines, known.origin_m[row])


def _leap(table: PointTable, store: Store) -> int | None:
    """Whole leap seconds that, added to the trajectory's times, bring the sensor above its returns.

    None where those of UTC do not, either way: then something else is wrong.
    """
    table = table.take(slice(None, None, max(len(table) // geometry.AHEAD_RETURNS, 1)))
    time = table["gps_time"]
    first, last = float(time.min()), float(time.max())
    leap = leap_seconds(first)
    for added in (leap, -leap):
        found = read_slice(store.path("trajectory.parquet"), first - added, last - added)
        moved = Trajectory(found.time_s + added, found.xyz_m, found.max_gap_s)
        known = geometry.beams(table, moved)
        look = geometry.look_ahead(known, time) if np.mean(known.known) > 0.5 else None
        if look is not None and look.is_above:
            return added
    return None


def observe(args: Mapping[str, Any], context: Context) -> Produced:
    """Noise and afterpulses of a stretch, with what its beams leave out."""
    table, _ = read_stretch(args, context, _columns(args))
    if not len(table):
        return Produced((), {"points": 0, "uncovered": 0})
    known = _beams(table, context.store, args)
    unknown, flown = table["gps_time"][~known.known], args["basis"] == "trajectory"
    facts: dict[str, Any] = {"points": len(table), "uncovered": len(unknown) if flown else 0}
    if facts["uncovered"]:
        facts["uncovered_span_s"] = [float(unknown.min()), float(unknown.max())]
    if args["beamlets"] > 1:
        facts["off_one_beam"] = geometry.off_one_beam(table)
    ahead = geometry.look_ahead(known, table["gps_time"]) if flown else None
    if ahead is not None:
        facts["ahead"] = [round(value, 3) for value in ahead]
    unknown_part = len(unknown) / len(table)
    if flown and (unknown_part > 0.5 or (ahead is not None and not ahead.is_above)):
        facts["leap_s"] = _leap(table, context.store)
    if flown:
        facts["other_unit"] = _other_unit(table, known, args, context)
    observed = shots.observe(table, known, context.workflow.noise, _beamlets(args, context))
    stats = context.store.path("observed", f"{args['stretch']}.npz")
    write_arrays(stats, observed)
    return Produced([stats], facts, len(table))


def fit_line(args: Mapping[str, Any], context: Context) -> Produced:
    """Line noise model of a flightline, from what its stretches observed."""
    parts = [read_arrays(context.store.path("observed", f"{s}.npz")) for s in args["stretches"]]
    beamlets = _beamlets(args, context)
    model, law, rate = shots.fit(parts, context.workflow.noise, beamlets)
    path = context.store.path("lines", f"{args['line']}.npz")
    found: tuple[Finding, ...] = ()
    if context.workflow.afterpulse.enabled:
        found = disagreements(law, beamlets.seen)
        found += uneven(parts, _spans_s(args), law, rate, beamlets.seen)
    write_arrays(path, {**model.to_arrays(), **law.to_arrays()})
    seen = model.seen_fraction
    wrong = line_findings(args["line"], args["stretches"], context.store)
    facts = {
        **{k: args[k] for k in ("points", "span_s", "prf_hz", "prf_basis", "beamlets", "basis")},
        "name": str(args["line"]),
        "gate_m": model.gate_m,
        "gate_basis": model.gate_basis,
        "noise_per_m": model.mean_rate,
        "seen_fraction": float(seen.mean()) if len(seen) else None,
        "findings": [*wrong, *model.findings, *found],
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
        table, copies = read_stretch(args, context, (*_POINT_COLUMNS, *_columns(args)))
        line = np.full(len(table), args["number"], np.uint16)
    outputs: list[Path] = []
    facts: dict[str, Any] = {"tiles": {}}
    unknown = dict.fromkeys(shots.COLUMNS_ADDED, np.zeros(len(table), np.float32))
    table = table.with_columns(**unknown, line=line)
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
    sights = _beams(table, context.store, args)
    line = read_arrays(context.store.path("lines", f"{args['line']}.npz"))
    law = afterpulse_law.AfterpulseLaw.from_arrays(line)
    model = LineModel.from_arrays(line)
    beamlets = _beamlets(args, context)
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
    paths = [voxel_file(context.store, name) for name in names]
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
    """Write where the beamlets pointed, if asked for, where positions and channels are known."""
    asked = context.workflow.products.intensity == "detection"
    if not asked or args["basis"] not in _POSITIONED or args["beamlets"] < 2:
        return []
    clock = ShotClock(args["t0_s"], args["prf_hz"])
    sensor = _beamlets(args, context).seen
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
