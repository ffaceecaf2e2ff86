"""Cells of the ground that beamlets look at, as the first pass counts by them.

Domain: time. Background is sunlight that the patch under a beamlet sends back [W17 Eq. 2.4]. The
patch is where the beam meets the surface: at the beamlet's return nearest to the signal of its
shots, or, if none is near, where the beam comes to the height of that signal.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.noise.noise_intervals import SUMMARY, signal_depths
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import BeamTable, PointTable
from spl_batch.numerics.compiled import njit

CELL_M: Final = 5.0
"""Edge of a ground cell: a shot's patch, and half of a voxel [m]."""

STRIDE: Final = 2**31
"""Cell (i, j) has the number i x stride + j."""

SURFACE_M: Final = 25.0
"""Height over or under the signal within which a return is of the surface itself [m]."""

SHOT: Final = 2**20
"""What the beamlets that are seen of one shot share as looks, in whole numbers."""


class Signal(NamedTuple):
    """Where the returns of a stretch lie about the signal of their shots."""

    starts: NDArray[np.int64]  #: (m + 1,): rows where intervals start, then n.
    order: NDArray[np.intp]  #: (n,): rows by interval and increasing height.
    summary: NDArray[np.float64]  #: (m, 10): see :data:`SUMMARY`.
    below: NDArray[np.float64]  #: (n,): height of the signal less that of the return [m].


class Looks(NamedTuple):
    """Which ground the beamlets of a stretch look at: l pairs of an interval and a cell."""

    row: NDArray[np.int64]  #: (n,): pair of each return.
    first: NDArray[np.int64]  #: (l,): first return of each pair, ascending.
    cell: NDArray[np.int64]  #: (l,): number of the cell.
    number: NDArray[np.int64]  #: (l,): looks, of which each shot has :data:`SHOT`.


def signal_of(table: PointTable, beams: BeamTable, settings: NoiseSettings) -> Signal:
    """Signal of the shots of a stretch; rows in time order, all of known beams."""
    interval = np.floor_divide(table["shot"], settings.interval_shots)
    offset = table["shot"] - interval * settings.interval_shots
    starts = run_starts(interval)
    m = len(starts) - 1
    # Sorted all at once: numpy has vector instructions for it, a kernel has none.
    order = lexicographic_order([np.repeat(np.arange(m), np.diff(starts)), table["z"]])
    found = Signal(starts, order, np.zeros((m, len(SUMMARY))), np.empty(len(table)))
    signal_depths(
        starts, table["z"] * QUANTUM_M, order, beams.range_m,
        np.maximum(-beams.direction[:, 2], 0.1), offset, settings.interval_shots,
        settings.peak_m, found.summary, found.below,
    )  # fmt: skip
    return found


def cells(table: PointTable, beams: BeamTable, below: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of the ground cell that each return's beamlet looks at: (n,) int64."""
    out = np.empty(len(table), np.int64)
    beamlet = run_starts(table["gps_time"], table["channel"])
    look_at(beamlet, (table["x"], table["y"]), QUANTUM_M, beams.direction, below, CELL_M, out)
    return out


def look_through(table: PointTable, beams: BeamTable, signal: Signal) -> Looks:
    """Ground that the beamlets of a stretch look at; rows as for :func:`signal_of`."""
    cell = cells(table, beams, signal.below)
    row, first = np.empty((2, len(table)), np.int64)
    count = number_looks(signal.starts, cell, row, first)
    shot = run_starts(table["gps_time"])
    beamlet = run_starts(table["gps_time"], table["channel"])
    of_shot = np.diff(np.searchsorted(beamlet, shot))
    number = np.zeros(count, np.int64)
    np.add.at(number, row[beamlet[:-1]], np.repeat(SHOT // np.maximum(of_shot, 1), of_shot))
    return Looks(row, first[:count], cell[first[:count]], number)


@njit()
def look_at(
    beamlet: NDArray[np.int64],
    place: tuple[NDArray[np.int64], NDArray[np.int64]],
    step_m: float,
    direction: NDArray[np.float64],
    below: NDArray[np.float64],
    cell_m: float,
    cell: NDArray[np.int64],
) -> None:
    """Ground cell that each beamlet looks at, for all of its returns.

    Parameters
    ----------
    beamlet : (b + 1,) int64
        Rows where beamlets start, then n.
    place : two of (n,) int64
        Easting and northing [steps].
    direction : (n, 3) float64
        Unit vectors along the beams.
    below : (n,) float64
        Height of the signal less that of the return [m].
    cell : (n,) int64
        Filled.
    """
    for b in range(len(beamlet) - 1):
        best = beamlet[b]
        for i in range(beamlet[b], beamlet[b + 1]):
            if abs(below[i]) < abs(below[best]):
                best = i
        along = 0.0
        if abs(below[best]) > SURFACE_M:
            along = -below[best] / max(-direction[best, 2], 0.1)
        x = place[0][best] * step_m + along * direction[best, 0]
        y = place[1][best] * step_m + along * direction[best, 1]
        number = np.int64(np.floor(x / cell_m)) * STRIDE + np.int64(np.floor(y / cell_m))
        for i in range(beamlet[b], beamlet[b + 1]):
            cell[i] = number


@njit()
def number_looks(
    starts: NDArray[np.int64],
    cell: NDArray[np.int64],
    look: NDArray[np.int64],
    first: NDArray[np.int64],
) -> int:
    """Number the ground cells of each interval; how many there are in all.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where intervals start, then n.
    cell : (n,) int64
        From :func:`cells`.
    look : (n,) int64
        Filled with the number of each row's interval and cell.
    first : (n,) int64
        Filled, as far as numbers go, with a row of each.
    """
    count, last = 0, 0
    for m in range(len(starts) - 1):
        begin = count
        for i in range(starts[m], starts[m + 1]):
            if begin == count or cell[first[last]] != cell[i]:
                last = begin
                while last < count and cell[first[last]] != cell[i]:
                    last += 1
                if last == count:
                    first[count] = i
                    count += 1
            look[i] = last
    return count
