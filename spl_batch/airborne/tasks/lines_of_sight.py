"""Beams of a stretch, and the sensor's path where the survey brings no trajectory.

Without a trajectory a stretch leaves its best lines of sight; a flightline's path is the
place where they meet, and only then can the stretches be observed.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from spl_batch.airborne import shots
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.beams import sensor_path as paths
from spl_batch.airborne.context import Context
from spl_batch.airborne.tasks.stretches import read_stretch
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.gps_clock import leap_seconds
from spl_batch.formats.trajectory.positions import read_slice, write_trajectory
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tables import BeamTable, PointTable, Trajectory

POSITIONED: Final = ("trajectory", "intersection")
"""What beams may be taken from that has positions of the sensor; else by scan angle or vertical."""

SIGHT_RETURNS: Final = 262_144
"""Returns of a stretch whose lines of sight are compared with the trajectory [count]."""


def columns(args: Mapping[str, Any]) -> tuple[str, ...]:
    """Columns that beams are found from, beyond those that points of a stretch always have."""
    return () if args["heading_rad"] is None else ("scan_angle",)


def beams(table: PointTable, store: Store, args: Mapping[str, Any]) -> BeamTable:
    """Line of sight of each point of a stretch: by trajectory, found path, or scan angle.

    ``args``: ``line``, ``basis`` and ``heading_rad`` of the task.
    """
    trajectory: Trajectory | None = None
    if args["basis"] in POSITIONED:
        path = store.path("trajectory.parquet")
        if args["basis"] == "intersection":
            path = store.path("paths", f"{args['line']}.parquet")
        time = table["gps_time"]
        trajectory = read_slice(path, float(time.min()), float(time.max()))
    return geometry.beams(table, trajectory, heading_rad=args["heading_rad"])


def beamlets(args: Mapping[str, Any], context: Context) -> shots.Beamlets:
    """How the shots of a stretch are seen; beams may separate beamlets that no file numbers."""
    sensor = context.workflow.sensor
    unnumbered = args["beamlets"] == 1 and sensor.beamlets > 1
    return shots.Beamlets(sensor, args["beamlets"], unnumbered and args["basis"] in POSITIONED)


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
    table, _ = read_stretch(args, context, columns(args))
    if not len(table):
        return Produced((), {"points": 0, "uncovered": 0})
    known = beams(table, context.store, args)
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
    observed = shots.observe(table, known, context.workflow.noise, beamlets(args, context))
    stats = context.store.path("observed", f"{args['stretch']}.npz")
    write_arrays(stats, observed)
    return Produced([stats], facts, len(table))
