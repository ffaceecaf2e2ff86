"""Gains: how much of a flightline's noise comes back from each cell of the ground.

Domain: time. The noise of all shots that looked at a cell, over what the rates of their intervals
expect, is its gain. It is drawn towards that of the cells around, and these towards one, as far as
chance explains their differences (empirical Bayes, gamma prior).
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.channel_gains import prior_weight
from spl_batch.airborne.noise.ground_cells import STRIDE, cells, signal_of
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"


class Ground(NamedTuple):
    """What each look of a flightline, an interval at a cell, counted: l looks at c cells."""

    cell: NDArray[np.int64]  #: (c,): numbers of the cells, ascending.
    row: NDArray[np.int64]  #: (l,): interval.
    at: NDArray[np.int64]  #: (l,): row of the cell.
    share: NDArray[np.float64]  #: (l,): part of the interval's looks.
    counted: NDArray[np.float64]  #: (l,): noise returns.

    def only(self, chosen: NDArray[np.bool_]) -> "Ground":
        """Without what some intervals, (m,) bool, have counted."""
        return self._replace(counted=self.counted * chosen[self.row])

    def brightness(self, gain: NDArray[np.float64], intervals: int) -> NDArray[np.float64]:
        """Mean gain of what each interval looks at: (m,) float64; 1 for a silent one."""
        mean = np.bincount(self.row, self.share * gain[self.at], intervals)
        looks = np.bincount(self.row, minlength=intervals)
        return np.where(looks > 0, mean, 1.0)

    def gains(self, expected: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gain of each cell: (c,) float64.

        Parameters
        ----------
        expected : (m,) float64
            Noise that each interval expects over ground of gain 1 [count].
        """
        n, model = (
            np.bincount(self.at, values, len(self.cell)).astype(np.float64)
            for values in (self.counted, self.share * expected[self.row])
        )
        wide_n, wide = _around(self.cell, n), _around(self.cell, model)
        gain = shrunk(wide_n, wide, np.ones(len(n)))
        gain = shrunk(n, model, gain)
        mean = float(np.sum(gain * model)) / max(float(model.sum()), 1e-300)
        return gain / mean if mean > 0.0 else np.ones(len(n))


def ground(
    merged: dict[str, NDArray[Any]],
    interval: NDArray[np.int64],
    buffer: int,
    sides: NDArray[np.float64],
) -> Ground:
    """What the looks of a flightline counted, of the region that holds noise.

    Parameters
    ----------
    merged : dict
        From :func:`~spl_batch.airborne.noise.line_statistics.merge`.
    interval : (m,) int64
        Intervals, ascending: those of the looks, and silent ones.
    buffer : int
        Rung of the ladder of buffers.
    sides : (2,) float64
        Weights of the sides of the signal.
    """
    cell, at = np.unique(merged["look_cell"], return_inverse=True)
    row = np.searchsorted(interval, merged["look_interval"])
    number = merged["look_number"].astype(np.float64)
    share = number / np.bincount(row, number, len(interval))[row]
    return Ground(cell, row, at, share, merged["look_outside"][:, :, buffer] @ sides)


def looked_at(
    table: PointTable, beams: BeamTable, model: LineModel, settings: NoiseSettings
) -> NDArray[np.float64]:
    """Gain of the ground that each point's beamlet looks at: (n,) float64.

    ``table``, ``beams``: rows of a stretch in time order, all of known beams.
    """
    if not len(model.cell) or not len(table):
        return np.ones(len(table))
    cell = cells(table, beams, signal_of(table, beams, settings).below)
    at = np.minimum(np.searchsorted(model.cell, cell), len(model.cell) - 1)
    return np.where(model.cell[at] == cell, model.ground[at], 1.0)


def shrunk(
    n: NDArray[np.float64], expected: NDArray[np.float64], prior: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Counts over what was expected, drawn to a prior: (c,) float64."""
    weight = prior_weight(n, prior * expected)
    gain: NDArray[np.float64] = (n + weight) / (expected + weight / prior)
    return gain


def _around(cell: NDArray[np.int64], value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum over each cell and the eight around it: (c,) float64."""
    total = np.zeros(len(cell))
    for step in (-1, 0, 1):
        for side in (-1, 0, 1):
            wanted = cell + step * STRIDE + side
            at = np.minimum(np.searchsorted(cell, wanted), len(cell) - 1)
            total += np.where(cell[at] == wanted, value[at], 0.0)
    return total
