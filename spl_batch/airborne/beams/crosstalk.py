"""Crosstalk: a detection in one channel sets off the channels beside it at the same moment.

Domain: time. Crosstalk makes pairs of noise, which look like a signal of two beamlets. Far from the
surface, pairs of one shot within :data:`SAME_M` of range are counted, by their directions: of
beamlets one pitch apart, and of those somewhat farther apart. Chance makes as many of both. Wires
and towers make pairs too, but not everywhere: a flightline is cut into :data:`PARTS`, and the half
with fewest pairs must show it; the half in the middle tells how much. One shot in :data:`EVERY` is
counted.

Where a flightline shows it, a pair that stands alone in its shot is one witness (:func:`set_off`):
of returns side by side at one range, with next to nothing else of the shot within :data:`ALONE_M`,
all but one are no evidence of their own and share the label of that one. Nobody knows which of them
set the others off, and nobody needs to. Beside a surface many returns of a shot have one range;
there crosstalk stays, and edges are blurred by a beamlet. No source has a rule for it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from spl_batch.airborne.beams.crosstalk_pairs import count_pairs
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.engine.findings import Finding
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

ALONE_M: Final = 1.0
MOST: Final = 8
"""Returns of a shot that lie alone: so many at the most within so much of range [m, count]. One has
four neighbours, which may have followers, and another pair may be near."""


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


def chance(parts: Sequence[Mapping[str, NDArray[Any]]]) -> float:
    """Chance that a return sets off one given channel beside its own; 0 where nothing shows it.

    ``parts``: results of :func:`observe` of a flightline, where beams are known.
    """
    known = [part["crosstalk"] for part in parts if "crosstalk" in part]
    rows = np.concatenate([np.empty((0, 4), np.int64), *known])
    # An interval may lie in two stretches: added up first, it counts alike however these are cut.
    interval, row = np.unique(rows[:, 0], return_inverse=True)
    ordered = np.zeros((len(interval), 3), np.int64)
    np.add.at(ordered, row, rows[:, 1:])
    sums = np.array([part.sum(axis=0) for part in np.array_split(ordered, PARTS)])
    order = np.argsort(sums[:, 1] / np.maximum(sums[:, 0], 1), kind="stable")
    _, beside, further = sums[order[: PARTS // 2]].sum(axis=0).tolist()
    by_chance = LIKELY * further
    if beside - CLOSER * by_chance <= SURE * np.sqrt(beside + CLOSER**2 * LIKELY * by_chance):
        return 0.0
    # The fewest of equals are too few: how much it is, the half in the middle tells.
    middle = order[PARTS // 4 : PARTS - PARTS // 4]
    returns, beside, further = sums[middle].sum(axis=0).tolist()
    by_chance = LIKELY * further
    found = (beside - by_chance) / (NEIGHBOURS * max(returns - beside, 1))
    return found if found >= LEAST else 0.0


def share_of_returns(found: float) -> float:
    """Share of all returns that others set off, by the :func:`chance` of it, 0..1."""
    return NEIGHBOURS * found / (1.0 + NEIGHBOURS * found)


def told(found: float) -> tuple[Finding, ...]:
    """What to tell of the :func:`chance` of a flightline; nothing where there is none."""
    if not found:
        return ()
    return (Finding("A01", {"kind": "crosstalk", "chance": found}, badness=found),)


def set_off(table: PointTable, beams: BeamTable, sensor: Sensor) -> NDArray[np.bool_]:
    """Returns that are no evidence beside another one of their shot, which stays one: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Rows in time order, with ``gps_time``.
    beams : BeamTable
        Their beams, all known.
    """
    out = np.zeros(len(table), np.bool_)
    if not len(table):
        return out
    shot = np.cumsum(np.diff(table["gps_time"], prepend=table["gps_time"][0]) != 0)
    order = np.lexsort((beams.range_m, shot))
    shot, range_m = shot[order], beams.range_m[order]
    # Shots lie farther apart on this line than any gate is long.
    along = shot * (float(np.ptp(range_m)) + 4 * ALONE_M) + range_m
    near = np.searchsorted(along, along + ALONE_M, "right")
    near -= np.searchsorted(along, along - ALONE_M, "left")
    alone = (near > 1) & (near <= MOST)
    direction = beams.direction.take(order, axis=0)
    low, high = (np.array(BESIDE) * sensor.beamlet_pitch_urad * 1e-6) ** 2
    pairs = []
    for step in range(1, MOST):
        first = np.flatnonzero(alone[:-step] & alone[step:])
        first = first[along[first + step] - along[first] <= SAME_M]
        angle = ((direction[first] - direction[first + step]) ** 2).sum(axis=1)
        first = first[(angle >= low) & (angle <= high)]
        pairs.append(np.stack([first, first + step]))
    one, other = np.concatenate(pairs, axis=1)
    links = coo_array((np.ones(len(one), np.bool_), (one, other)), (len(order),) * 2)
    _, group = connected_components(links, directed=False)
    first_of = np.unique(group, return_index=True)[1]
    out[order] = True
    out[order[first_of]] = False
    return out
