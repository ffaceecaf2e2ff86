"""Cells of the ground that beamlets look at, as the first pass counts by them.

Domain: time. Background is sunlight that the patch under a beamlet sends back [W17 Eq. 2.4]. The
patch is where the beam comes to the height of the signal of its shots.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.noise.noise_intervals import GROUP_RETURNS, SUMMARY, signal_depths
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import BeamTable, PointTable

CELL_M: Final = 2.5
"""Edge of a ground cell: half of a shot's patch [m]. Half and twice move 312 + 0 and 223 + 10
labels."""

STRIDE: Final = int(np.iinfo(np.int32).max) + 1
"""Cell (i, j) has the number i x stride + j."""

PARTS: Final = 2**20
"""Parts of a whole that is shared out, or added up: whole numbers add up alike in any order."""


class Signal(NamedTuple):
    """Where the returns of a stretch lie about the signal of their shots."""

    starts: NDArray[np.int64]  #: (m + 1,): rows where intervals start, then n.
    order: NDArray[np.intp]  #: (n,): rows by interval and increasing height.
    groups: NDArray[np.int64]  #: (m,): groups of shots of each interval.
    height: NDArray[np.float64]  #: (g,): height of the signal in each group [m].
    summary: NDArray[np.float64]  #: (m, 10): see :data:`SUMMARY`.
    below: NDArray[np.float64]  #: (n,): height of the signal less that of the return [m].


def signal_of(table: PointTable, beams: BeamTable, settings: NoiseSettings) -> Signal:
    """Signal of the shots of a stretch; rows in time order, all of known beams."""
    interval = np.floor_divide(table["shot"], settings.interval_shots)
    offset = table["shot"] - interval * settings.interval_shots
    starts = run_starts(interval)
    size = np.diff(starts)
    # Sorted all at once: numpy has vector instructions for it, a kernel has none.
    order = lexicographic_order([np.repeat(np.arange(len(size)), size), table["z"]])
    groups = np.clip(size // GROUP_RETURNS, 1, settings.interval_shots)
    first = np.append(0, np.cumsum(groups))
    found = Signal(
        starts, order, groups, np.empty(first[-1]), np.zeros((len(size), len(SUMMARY))),
        np.empty(len(table)),
    )  # fmt: skip
    signal_depths(
        starts, table["z"] * QUANTUM_M, order, beams.range_m,
        np.maximum(-beams.direction[:, 2], 0.1), offset, first, settings.interval_shots,
        settings.peak_m, found.height, found.summary, found.below,
    )  # fmt: skip
    return found


def cells(table: PointTable, beams: BeamTable, below: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of the ground cell that each return's beamlet looks at: (n,) int64."""
    along = below / np.minimum(beams.direction[:, 2], -0.1)
    i, j = (
        np.floor((table[axis] * QUANTUM_M + along * beams.direction[:, k]) / CELL_M)
        for k, axis in enumerate("xy")
    )
    number = i.astype(np.int64) * STRIDE + j.astype(np.int64)
    # A shot without channel numbers is one beamlet: its returns look where the first one does.
    beamlet = run_starts(table["gps_time"], table["channel"])
    return np.repeat(number[beamlet[:-1]], np.diff(beamlet))


def look_through(
    table: PointTable, beams: BeamTable, signal: Signal
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.int64]]]:
    """Which ground the beamlets of a stretch look at: l pairs of an interval and a cell.

    Returns
    -------
    row : (n,) int64
        Pair of each return.
    looks : dict
        ``looks`` (m,), pairs of each interval; ``look_cell`` (l,), number of the cell;
        ``look_number`` (l,), looks, of which each shot has :data:`PARTS`.
    """
    cell = cells(table, beams, signal.below)
    shot = run_starts(table["gps_time"])
    beamlet = run_starts(table["gps_time"], table["channel"])
    of_shot = np.diff(np.searchsorted(beamlet, shot))
    share = np.zeros(len(table), np.int64)
    share[beamlet[:-1]] = np.repeat(PARTS // np.maximum(of_shot, 1), of_shot)
    interval = np.repeat(np.arange(len(signal.groups)), np.diff(signal.starts))
    order = lexicographic_order([interval, *np.divmod(cell, STRIDE)])
    starts = run_starts(interval[order], cell[order])
    row = np.empty(len(table), np.int64)
    row[order] = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    first = order[starts[:-1]]
    return row, {
        "looks": np.bincount(interval[first], minlength=len(signal.groups)),
        "look_cell": cell[first],
        "look_number": np.add.reduceat(share[order], starts[:-1]),
    }
