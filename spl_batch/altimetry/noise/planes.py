"""Planes in which photons look for their neighbours [W17 4.1.1, Eq. 4.1].

In a plane noise is equally dense, and a neighbourhood is a circle. The track is stretched by the
noise of each cell; what a unit is in height follows from the noise that is usual around. So a plane
belongs to one usual noise: photons of cells with another one are in it as neighbours alone.

Deviation: the source has one plane for a whole channel, so the labels of a stretch depend on the
noise of the night behind it. Here nothing farther than :data:`USUAL_CELLS` and a block counts.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.photon_table import Scale
from spl_batch.altimetry.settings import RateSettings, SignalSettings
from spl_batch.altimetry.water.level_water import NO_WATER

UNIT_QUANTA: Final = 4096
"""Lattice of a plane [quanta per unit]."""

CAP_UNITS: Final = 5.0
"""Farthest neighbour in a plane [units]; 78 noise photons are expected nearer."""

UNIT_M: Final = (0.5, 15.0)
"""Least and greatest height of a unit [m]."""

USUAL_CELLS: Final = 100
"""Cells to each side of a block whose median noise is the usual one [count]."""

BLOCK_CELLS: Final = 20
"""Cells of a block of the absolute grid, which has one usual noise [count]."""

_LEAST_NOISE: Final = 1e-6
"""What is usual where there is no noise at all [1/m2]."""

_STEPS: Final = 8
"""Steps in which a usual noise doubles: with few of them there are few planes [count]."""

ALPHA_MIN: Final = 1e-4
"""Least noise in a unit [1/unit2]."""


@dataclass(frozen=True, slots=True)
class Plane:
    """Cells of a usual noise, and those within reach of them, in order."""

    rows: NDArray[np.intp]  #: (m,): rows of the scale.
    own: NDArray[np.bool_]  #: (m,): whether the plane is that of their own usual noise.
    start: NDArray[np.int64]  #: (m,): where the cell starts [1/4096 units].
    per_m: NDArray[np.float64]  #: (m,): units per metre of track within the cell [1/m].
    #: (m,): farthest neighbour that counts; nowhere farther along the track than the reach [units].
    cap: NDArray[np.float64]
    #: (m,): noise photons per square unit; 1 unless the reach is what limits a unit's length.
    alpha: NDArray[np.float64]
    unit_m: float  #: Height of a unit [m].

    def row_of(self, cells: int) -> NDArray[np.intp]:
        """Row here of each of so many cells of the scale, (cells,) intp; -1 of those not here."""
        found = np.full(cells, -1, np.intp)
        found[self.rows] = np.arange(len(self.rows))
        return found


def usual_noise(
    index: NDArray[np.int64], density: NDArray[np.float64], signal: SignalSettings
) -> NDArray[np.float64]:
    """Noise that is usual around each cell, in steps: (n,) float64 [1/m2].

    Without scaling it is that of the whole beam.
    """
    if not signal.scaling:
        return np.full(len(index), median_noise(density))
    block, at = np.unique(index // BLOCK_CELLS, return_inverse=True)
    first = np.searchsorted(index, block * BLOCK_CELLS - USUAL_CELLS)
    stop = np.searchsorted(index, (block + 1) * BLOCK_CELLS + USUAL_CELLS)
    pairs = zip(first.tolist(), stop.tolist(), strict=True)
    median = np.array([median_noise(density[a:b]) for a, b in pairs])
    usual: NDArray[np.float64] = 2.0 ** (np.rint(_STEPS * np.log2(median)) / _STEPS)
    return usual[at]


def median_noise(density: NDArray[np.float64]) -> float:
    """Median of the noise of cells that have some [1/m2]."""
    known = density[density > 0.0]
    return float(np.median(known)) if len(known) else _LEAST_NOISE


def planes(
    scale: Scale, rows: NDArray[np.intp], rate: RateSettings, signal: SignalSettings
) -> Iterator[Plane]:
    """Planes that together are the own ones of some cells.

    Parameters
    ----------
    rows : (r,) intp
        Rows of the cells, in order.
    rate, signal : RateSettings, SignalSettings
        Cells; aspect and reach.
    """
    reach = int(np.ceil(signal.reach_m / rate.cell_m)) + 1
    for usual in np.unique(scale.usual[rows]).tolist():
        mine = rows[scale.usual[rows] == usual]
        near = _between(scale.index[mine], scale.index - reach, scale.index + reach)
        some = np.flatnonzero(near)
        yield _plane(scale, some, np.isin(some, mine), usual, (rate, signal))


def _between(
    values: NDArray[np.int64], low: NDArray[np.int64], high: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether one of the ordered values lies in each range, its ends included: (n,) bool."""
    found: NDArray[np.bool_] = np.searchsorted(values, low) < np.searchsorted(values, high, "right")
    return found


def _plane(
    scale: Scale,
    rows: NDArray[np.intp],
    own: NDArray[np.bool_],
    usual: float,
    settings: tuple[RateSettings, SignalSettings],
) -> Plane:
    """Plane of a usual noise."""
    rate, signal = settings
    index, aspect = scale.index[rows], scale.aspect[rows]
    noise = scale.density[rows] if signal.scaling else np.full(len(rows), usual)
    longest_m = signal.reach_m / (CAP_UNITS * signal.aspect)
    unit_m = float(np.clip(1.0 / np.sqrt(usual * signal.aspect), *UNIT_M))
    unit_m = min(unit_m, max(longest_m, UNIT_M[0]))
    wet = scale.level[rows] != NO_WATER
    used = np.where(wet, usual, noise) / (usual * aspect * unit_m**2)
    # By night noise would press kilometres into a unit: none is longer than its share of the reach.
    used = np.maximum(used, 1.0 / (aspect * unit_m * longest_m))
    per_m = used * unit_m
    least = _least_around(index, per_m, int(np.ceil(signal.reach_m / rate.cell_m)) + 1)
    cap = np.minimum(CAP_UNITS, signal.reach_m * least)
    gap_m = np.maximum(np.diff(index, prepend=index[:1]) - 1, 0) * rate.cell_m
    # Beyond twice the farthest neighbour it does not matter how far.
    before = np.minimum(gap_m * CAP_UNITS / signal.reach_m, 2 * CAP_UNITS)
    # Whole numbers: where a cell lies beside another does not depend on where the plane begins.
    before_q, long_q = (
        np.rint(v * UNIT_QUANTA).astype(np.int64) for v in (before, per_m * rate.cell_m)
    )
    start = np.cumsum(before_q) + np.concatenate([[0], np.cumsum(long_q)[:-1]])
    alpha = np.maximum(noise / used, ALPHA_MIN)
    return Plane(rows, own, start, per_m, cap, alpha, unit_m)


def _least_around(
    index: NDArray[np.int64], values: NDArray[np.float64], reach: int
) -> NDArray[np.float64]:
    """The least of the values of the cells within ``reach`` of each, (n,) float64."""
    least = values.copy()
    for step in range(1, reach + 1):
        for at in (index - step, index + step):
            other = np.minimum(np.searchsorted(index, at), len(index) - 1)
            there = index[other] == at
            least[there] = np.minimum(least[there], values[other[there]])
    return least
