"""The time domain of a cloud in memory: beams, noise of each flightline, afterpulse candidates.

The same functions as in a run, flightline by flightline; a flightline is one stretch.
"""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import afterpulse_law, candidates
from spl_batch.airborne.beams import geometry, sensor_path
from spl_batch.airborne.beams.rays import look
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.beams.told_apart import told_apart
from spl_batch.airborne.filter.expected_noise import HeldVoxels, NoiseModel, model_of_lines
from spl_batch.airborne.noise import line_noise, voxel_noise
from spl_batch.airborne.plan.flightlines import FALLBACK_PRF_HZ
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.reported import texts
from spl_batch.formats.gps_clock import usable_times
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import BeamTable, PointFlag, PointTable, ShotClock, VoxelPart

_ADDED: Final = (
    "line_density", "afterpulse", "afterpulse_rate", "afterpulse_share", "range_sigma",
)  # fmt: skip
"""Columns that the time domain adds."""


class Assessed(NamedTuple):
    """A cloud with what the time domain knows of it.

    Parameters
    ----------
    table : PointTable
        The points, in the caller's order, with the columns that it adds; ``NO_BEAM`` is flagged.
    lines : list of list of VoxelPart
        Shares of the expected noise, for each flightline.
    beamlets : int
        Beamlets of a shot.
    basis : str
        What beams are from: ``beams``, ``intersection`` or ``vertical``.
    warnings : tuple of str
        What a user should know.
    """

    table: PointTable
    lines: list[list[VoxelPart]]
    beamlets: int
    basis: str
    warnings: tuple[str, ...]

    def model(self, xyz: list[NDArray[np.int64]], settings: Workflow) -> NoiseModel | None:
        """Noise of the voxels around places [quanta]; None without any."""
        shares = [[HeldVoxels(part) for part in line] for line in self.lines]
        return model_of_lines(xyz, shares, self.beamlets, settings.noise)


def assess(table: PointTable, origin_m: NDArray[np.float64] | None, settings: Workflow) -> Assessed:
    """What the shots of a cloud tell of its noise and its afterpulses.

    Parameters
    ----------
    table : PointTable
        ``x, y, z, flags, gps_time, channel, point_source_id, return_number, source, index``.
        Without channels (all the same) each shot is one beamlet.
    origin_m : (n, 3) float64 or None
        Position of the sensor at each point's shot [m]; NaN where it is not known. None finds the
        sensor's path where lines of sight meet, or takes beams as vertical.
    settings : Workflow
        The settings.
    """
    known = usable_times(table["gps_time"])
    channels = table["channel"]
    apart = bool(len(channels)) and bool((channels != channels[0]).any())
    sensor = settings.sensor
    if not apart:
        sensor = sensor.model_copy(update={"beamlets": 1})
    added = {name: np.zeros(len(table), np.float32) for name in _ADDED}
    added["channel"] = channels.copy()
    flags = np.where(known, table["flags"], table["flags"] | PointFlag.NO_BEAM)
    lines, bases, found = [], set(), list[Finding]()
    for name, rows in _flightlines(table, np.flatnonzero(known), settings.survey.gap_s):
        one = _Line(
            table.take(rows), None if origin_m is None else origin_m[rows], sensor, settings
        )
        bases.add(one.basis)
        found += [finding._replace(subject=name) for finding in one.model.findings]
        if one.rate_is_assumed:
            assumed = {"kind": "assumed", "prf_hz": FALLBACK_PRF_HZ}
            found.append(Finding("T01", assumed, name))
        columns, parts = one.assess()
        for key, values in columns.items():
            added[key][rows] = values
        flags[rows] |= ~one.beams.known * np.uint8(PointFlag.NO_BEAM)
        lines.append(parts)
    basis = "vertical" if "vertical" in bases else next(iter(bases), "beams")
    return Assessed(
        table.with_columns(flags=flags, **added), lines, sensor.beamlets, basis, texts(found)
    )


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


class _Line:
    """One flightline in time order."""

    def __init__(
        self,
        table: PointTable,
        origin_m: NDArray[np.float64] | None,
        sensor: Sensor,
        settings: Workflow,
    ) -> None:
        time = table["gps_time"]
        rate = sensor.prf_hz or geometry.estimate_prf(geometry.shot_steps(time))
        self.rate_is_assumed = rate is None
        clock = ShotClock(float(np.floor(time[0])), rate or FALLBACK_PRF_HZ)
        self.table = table.with_columns(shot=clock.shot(time))
        self.settings, self.sensor = settings, sensor
        self.basis, self.beams = self._beams(origin_m)
        # Beams may tell beamlets apart that nobody has numbered.
        stated = settings.sensor
        self.unnumbered = sensor.beamlets < stated.beamlets and self.basis != "vertical"
        observed = line_noise.observe(self.table, self.beams, settings.noise)
        seen, beams = self.table, self.beams
        if self.unnumbered:
            seen, order = told_apart(seen, beams, stated)
            beams = beams.take(order)
        observed |= candidates.observe(seen, beams, stated)
        self.model = line_noise.fit(line_noise.merge([observed]), settings.noise, sensor)
        beamlets = stated.beamlets if self.unnumbered else 1
        self.law = afterpulse_law.fit([observed], self.model.mean_rate / beamlets, sensor)

    def _beams(self, origin_m: NDArray[np.float64] | None) -> tuple[str, BeamTable]:
        table = self.table
        if origin_m is not None:
            return "beams", _from_origins(table, origin_m)
        interval = self.settings.noise.interval_shots
        sights = sensor_path.collect(table, self.sensor.beamlets, interval)
        span = float(table["gps_time"][0]), float(table["gps_time"][-1])
        path = sensor_path.find_path(sensor_path.merge([sights]), span).trajectory
        return "vertical" if path is None else "intersection", geometry.beams(table, path)

    def assess(self) -> tuple[dict[str, NDArray[Any]], list[VoxelPart]]:
        """Columns that the time domain adds, and the shares of the expected noise."""
        rows = np.flatnonzero(self.beams.known)
        table, beams, model = self.table.take(rows), self.beams.take(rows), self.model
        added: dict[str, NDArray[Any]] = {
            name: np.zeros(len(self.table), np.float32) for name in _ADDED
        }
        added["line_density"][rows] = line_noise.line_density(table, model)
        added["channel"] = self.table["channel"].copy()
        if self.settings.afterpulse.enabled:
            self._add_afterpulses(added, table, beams, rows)
        return added, voxel_noise.deposit_apart(table, beams, model, self.settings.noise)

    def _add_afterpulses(
        self,
        added: dict[str, NDArray[Any]],
        table: PointTable,
        beams: BeamTable,
        rows: NDArray[np.intp],
    ) -> None:
        """What shots say of afterpulses, for rows whose beams are known."""
        sensor, of_shot = self.sensor, 1.0
        if self.unnumbered:
            sensor = self.settings.sensor
            of_shot = float(sensor.beamlets)
            table, order = told_apart(table, beams, sensor)
            beams, rows = beams.take(order), rows[order]
            added["channel"][rows] = table["channel"]
        added["afterpulse"][rows] = candidates.probability(
            table, beams, self.settings.afterpulse, sensor, gate_m=self.model.gate_m, law=self.law
        )
        rate = afterpulse_law.rate(table, beams, self.law)
        added["afterpulse_rate"][rows] = rate * np.float32(of_shot)
        added["afterpulse_share"][rows] = self.law.probability
        added["range_sigma"][rows] = self.law.sigma_m


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
