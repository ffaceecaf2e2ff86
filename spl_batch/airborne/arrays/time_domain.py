"""The time domain of a cloud in memory: beams, noise of each flightline, afterpulse candidates.

The same functions as in a run, flightline by flightline; a flightline is one stretch.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne import shots
from spl_batch.airborne.arrays.labels import Basis
from spl_batch.airborne.beams import geometry, sensor_path
from spl_batch.airborne.beams.rays import look
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.filter.expected_noise import NoiseModel, noise_model
from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.plan.flightlines import FALLBACK_PRF_HZ
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.reported import texts
from spl_batch.formats.gps_clock import usable_times
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import BeamTable, PointFlag, PointTable, ShotClock, VoxelPart


class Assessed(NamedTuple):
    """A cloud with what the time domain knows of it."""

    #: Points in the caller's order, with the columns that it adds; ``NO_BEAM`` is flagged.
    table: PointTable
    lines: list[list[VoxelPart]]  #: Shares of the expected noise, for each flightline.
    beamlets: int  #: Beamlets of a shot.
    basis: Basis  #: What beams are from: ``beams``, ``intersection`` or ``vertical``.
    warnings: tuple[str, ...]  #: What a user should know.

    def model(self, xyz: list[NDArray[np.int64]], settings: Workflow) -> NoiseModel | None:
        """Noise of the voxels around places [quanta]; None without any."""
        return noise_model(xyz, self.lines, self.beamlets, settings.noise)


def assess(table: PointTable, origin_m: NDArray[np.float64] | None, settings: Workflow) -> Assessed:
    """Noise and afterpulses of a cloud by its shots.

    Without channels (all the same) each shot is one beamlet. ``origin_m`` (n, 3) is the position of
    the sensor at each point's shot [m], NaN where it is not known; None finds its path where lines
    of sight meet, or takes beams as vertical.
    """
    known = usable_times(table["gps_time"])
    channels = table["channel"]
    apart = bool(len(channels)) and bool((channels != channels[0]).any())
    sensor, count = settings.sensor, settings.sensor.beamlets if apart else 1
    added: dict[str, NDArray[Any]] = {
        name: np.zeros(len(table), np.float32) for name in shots.COLUMNS_ADDED
    }
    added["channel"] = channels.copy()
    added["flags"] = np.where(known, table["flags"], table["flags"] | PointFlag.NO_BEAM)
    lines, bases, found = [], set[Basis](), list[Finding]()
    for name, rows in _flightlines(table, np.flatnonzero(known), settings.survey.gap_s):
        time = table["gps_time"][rows]
        rate = sensor.prf_hz or geometry.estimate_prf(geometry.shot_steps(time))
        if rate is None:
            assumed = {"kind": "assumed", "prf_hz": FALLBACK_PRF_HZ}
            found.append(Finding("T01", assumed, name))
        clock = ShotClock(float(np.floor(time[0])), rate or FALLBACK_PRF_HZ)
        mine = table.take(rows).with_columns(shot=clock.shot(time))
        of_line, beams = _beams(mine, None if origin_m is None else origin_m[rows], count, settings)
        bases.add(of_line)
        unnumbered = count < sensor.beamlets and of_line != "vertical"
        beamlets = shots.Beamlets(sensor, count, unnumbered)
        observed = shots.observe(mine, beams, settings.noise, beamlets)
        model, law, _ = shots.fit([observed], settings.noise, beamlets)
        found += [finding._replace(subject=name) for finding in model.findings]
        mine, lit, beams, ground = shots.assess(mine, beams, (model, law), settings, beamlets)
        for key, values in added.items():
            values[rows] = mine[key]
        lines.append(voxel_noise.deposit(lit, beams, model, settings.noise, ground))
    basis: Basis = "vertical" if "vertical" in bases else next(iter(bases), "beams")
    return Assessed(table.with_columns(**added), lines, count, basis, texts(found))


def _flightlines(
    table: PointTable, rows: NDArray[np.intp], gap_s: float
) -> Iterator[tuple[str, NDArray[np.intp]]]:
    """Name and rows, in time order, of each flightline: a source id between two long pauses."""
    keys = ("point_source_id", "gps_time", "channel", "return_number", "x", "y", "z", "index")
    rows = rows[lexicographic_order([table[key][rows] for key in keys])] if len(rows) else rows
    ids, time = table["point_source_id"][rows].astype(np.int64), table["gps_time"][rows]
    cuts = np.flatnonzero((np.diff(ids) != 0) | (np.diff(time) > gap_s)) + 1
    for part in np.split(rows, cuts):
        if len(part):
            first = table["gps_time"][part[0]]
            yield f"{table['point_source_id'][part[0]]:05d}_{np.floor(first):.0f}", part


def _beams(
    table: PointTable, origin_m: NDArray[np.float64] | None, beamlets: int, settings: Workflow
) -> tuple[Basis, BeamTable]:
    """Lines of sight of a flightline, and what they are from."""
    if origin_m is not None:
        return "beams", _from_origins(table, origin_m)
    sights = sensor_path.collect(table, beamlets, settings.noise.interval_shots)
    span = float(table["gps_time"][0]), float(table["gps_time"][-1])
    path = sensor_path.find_path(sensor_path.merge([sights]), span).trajectory
    return "vertical" if path is None else "intersection", geometry.beams(table, path)


def _from_origins(table: PointTable, origin_m: NDArray[np.float64]) -> BeamTable:
    """Lines of sight by the sensor's position at each shot: that of its first return."""
    n = len(table)
    shots = run_starts(table["gps_time"])
    sensor = np.ascontiguousarray(origin_m[shots[:-1]])
    origin, direction, range_m = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    look(shots, sensor, (table["x"], table["y"], table["z"]), QUANTUM_M, origin, direction, range_m)
    covered = np.isfinite(sensor).all(axis=1)
    known: NDArray[np.bool_] = np.repeat(covered, np.diff(shots)) & (range_m > 0)
    return BeamTable(origin, direction, range_m, known)
