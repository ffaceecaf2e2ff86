"""Gains: how much of a flightline's noise comes back from each cell of the ground.

Domain: time. The noise of all shots that looked at a cell, over what the rates of their intervals
expect, is its gain. It is drawn towards that of the cells around, and these towards one, as far as
chance explains their differences (empirical Bayes, gamma prior).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.channel_gains import prior_weight
from spl_batch.airborne.noise.ground_cells import STRIDE, cells
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"


def ground(
    merged: dict[str, NDArray[Any]],
    interval: NDArray[np.int64],
    expected: NDArray[np.float64],
    buffer: int,
    sides: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cells of the ground that a flightline looked at, ascending, and their gains: two (c,).

    Parameters
    ----------
    merged : dict
        From :func:`~spl_batch.airborne.noise.line_statistics.merge`.
    interval : (m,) int64
        Intervals, ascending: those of the looks, and silent ones.
    expected : (m,) float64
        Noise of each by its rate; 0 for one that is not counted [count].
    buffer : int
        Rung of the ladder of buffers.
    sides : (2,) float64
        Weights of the sides of the signal.
    """
    cell, at = np.unique(merged["look_cell"], return_inverse=True)
    row = np.repeat(np.searchsorted(interval, merged["interval"]), merged["looks"])
    number = merged["look_number"].astype(np.float64)
    share = number / np.bincount(row, number, len(interval))[row]
    counted = (merged["look_outside"][:, :, buffer] @ sides) * (expected[row] > 0.0)
    n, model = (
        np.bincount(at, values, len(cell)).astype(np.float64)
        for values in (counted, share * expected[row])
    )
    return cell, gains(cell, n, model)


def gains(
    cell: NDArray[np.int64], n: NDArray[np.float64], expected: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Gains of cells, ascending, by the noise in them and what was expected: (c,) float64."""
    around = shrunk(_around(cell, n), _around(cell, expected), np.ones(len(n)))
    gain = shrunk(n, expected, around)
    mean = float(np.sum(gain * expected)) / max(float(expected.sum()), 1e-300)
    return gain / mean if mean > 0.0 else np.ones(len(n))


def looked_at(table: PointTable, beams: BeamTable, model: LineModel) -> NDArray[np.float64]:
    """Gain of the ground that each point's beamlet looks at: (n,) float64.

    ``table``, ``beams``: rows of a stretch in time order, all of known beams.
    """
    if not len(model.cell) or not len(table):
        return np.ones(len(table))
    cell = cells(table, beams, model.signal_at(table["shot"]) - table["z"] * QUANTUM_M)
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
