"""Beamlets of a shot separated by where they point, where files do not number them.

Domain: time. Returns of one beamlet lie on one line of sight; the next line is a pitch away. So
returns whose directions differ by less than a part of the pitch are of one beamlet. A number is
another beamlet in the next shot, so neither gains nor dead channels can be estimated.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.lattice.tables import BeamTable, PointTable, rows_of
from spl_batch.numerics.compiled import njit


@njit()
def number_beamlets(
    starts: NDArray[np.int64], direction: NDArray[np.float64], apart_rad: float,
    number: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Number the different directions of each shot from 1 on, in the order of its rows: (n,).

    Directions that differ by less than ``apart_rad`` are one; a return is of the nearest that came
    before it; 255 are distinguished. ``starts`` (s + 1,): rows where shots start, then n.
    """
    seen = np.empty((255, 3))
    for shot in range(len(starts) - 1):
        count = 0
        for i in range(starts[shot], starts[shot + 1]):
            best, nearest = -1, apart_rad * apart_rad
            for k in range(count):
                off = 0.0
                for axis in range(3):
                    off += (direction[i, axis] - seen[k, axis]) ** 2
                if off < nearest:
                    best, nearest = k, off
            if best < 0 and count < 255:
                best = count
                seen[count] = direction[i]
                count += 1
            number[i] = best + 1


SAME: Final = 0.25
"""Directions of one beamlet differ by less [pitches of the array]."""


def separate_beamlets(
    table: PointTable, beams: BeamTable, sensor: Sensor
) -> tuple[PointTable, NDArray[np.intp]]:
    """Table with a beamlet's number in ``channel``, its rows in the order of these.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by time.
    beams : BeamTable
        Their beams; rows without a known one are beamlets by themselves, of number 0.

    Returns
    -------
    table : PointTable
        Sorted by (gps_time, channel), and as before within a beamlet.
    order : (n,) intp
        The rows of the given table in that order.
    """
    channel = np.zeros(len(table), np.uint8)
    rows = rows_of(beams.known)
    known = table["gps_time"][rows]
    found = np.zeros(len(known), np.uint8)
    number_beamlets(
        run_starts(known), np.ascontiguousarray(beams.direction[rows]),
        SAME * sensor.beamlet_pitch_urad * 1e-6, found,
    )  # fmt: skip
    channel[rows] = found
    shots = run_starts(table["gps_time"])
    shot = np.repeat(np.arange(len(shots) - 1), np.diff(shots))
    order = np.lexsort((channel, shot))
    return table.with_columns(channel=channel).take(order), order
