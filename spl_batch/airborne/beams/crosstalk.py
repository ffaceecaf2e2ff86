"""Crosstalk: a detection in one channel sets off the channels beside it at the same moment.

Domain: time. Crosstalk makes pairs of noise, which look like a signal of two beamlets. Far from the
surface, pairs of one shot within :data:`SAME_M` of range are counted, by their directions: of
beamlets one pitch apart, and of those somewhat farther apart. Chance makes as many of both. Wires
and towers make pairs too, but not everywhere: a flightline is cut into :data:`PARTS`, and the half
with fewest pairs must show it. One shot in :data:`EVERY` is counted.

It is told, and nothing is removed: nobody knows which of a pair set the other off. No source has a
rule for it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.crosstalk_pairs import count_pairs
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.errors import Remark
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"

EVERY: Final = 8
"""One shot in so many is looked at, by shot number: no cut matters."""

SAME_M: Final = 0.15
"""Ranges of one moment: three times the ranging noise of the instrument [m]."""

FAR_M: Final = 30.0
"""How far from most returns of its shot a return is noise: beyond trees and houses [m]."""

BESIDE: Final = (0.6, 1.25)
"""Directions of beamlets side by side [pitches of the array]."""

FURTHER: Final = 2.3
"""Directions of those that are compared with them, up to two rows and one column away [pitches]."""

LIKELY: Final = 180 / 610
"""Pairs of beamlets side by side over those farther apart, in an array of 10 x 10."""

NEIGHBOURS: Final = 3.6
"""Channels beside one, on average over such an array [count]."""

CLOSER: Final = 4.0
"""Factor to chance by which more pairs must lie side by side: patches of ground between towers
reach half of it."""

PARTS: Final = 16
"""Parts of a flightline that are compared [count]."""

SURE: Final = 5.0
"""Standard deviations of chance beyond which it is crosstalk."""

LEAST: Final = 0.005
"""Chance to set off one given neighbour that is worth a word."""


def observe(
    table: PointTable, beams: BeamTable, sensor: Sensor, interval_shots: int
) -> dict[str, NDArray[np.int64]]:
    """Count pairs of one stretch.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by ``gps_time``, with ``shot``.
    beams : BeamTable
        Their beams; rows without a known one take no part.

    Returns
    -------
    dict
        ``crosstalk`` (m, 4) int64: number of the interval, returns far from the surface, their
        pairs side by side, and those farther apart, at one range [count].
    """
    rows = np.flatnonzero(beams.known & (table["shot"] % EVERY == 0))
    starts = run_starts(table["gps_time"][rows])
    of_shot = table["shot"][rows[starts[:-1]]] // interval_shots
    interval, row = np.unique(of_shot, return_inverse=True)
    counts = np.zeros((len(interval), 3), np.int64)
    apart = np.array([*BESIDE, FURTHER]) * sensor.beamlet_pitch_urad * 1e-6
    count_pairs(
        starts, beams.range_m[rows], beams.direction.take(rows, axis=0), row.reshape(-1),
        FAR_M, SAME_M, apart**2, counts,
    )  # fmt: skip
    return {"crosstalk": np.column_stack([interval, counts]).astype(np.int64)}


def told(parts: Sequence[Mapping[str, NDArray[Any]]]) -> tuple[Remark, ...]:
    """What to tell of a flightline's crosstalk; nothing where there is none.

    ``parts``: results of :func:`observe`, where beams are known.
    """
    known = [part["crosstalk"] for part in parts if "crosstalk" in part]
    rows = np.concatenate([np.empty((0, 4), np.int64), *known])
    # An interval may lie in two stretches: added up first, it counts alike however these are cut.
    interval, row = np.unique(rows[:, 0], return_inverse=True)
    ordered = np.zeros((len(interval), 3), np.int64)
    np.add.at(ordered, row, rows[:, 1:])
    sums = np.array([part.sum(axis=0) for part in np.array_split(ordered, PARTS)])
    fewest = np.argsort(sums[:, 1] / np.maximum(sums[:, 0], 1), kind="stable")[: PARTS // 2]
    returns, beside, further = sums[fewest].sum(axis=0).tolist()
    by_chance = LIKELY * further
    if beside - CLOSER * by_chance <= SURE * np.sqrt(beside + CLOSER**2 * LIKELY * by_chance):
        return ()
    chance = (beside - by_chance) / (NEIGHBOURS * max(returns - beside, 1))
    if chance < LEAST:
        return ()
    text = (
        "far from the surface a return sets off each channel beside its own with a chance of "
        f"{100 * chance:.1f} %, at the same range: crosstalk; noise comes in pairs, so that more "
        "of it than filter.alpha counts as signal, and edges of surfaces are blurred by a beamlet"
    )
    return (Remark(text, chance),)
