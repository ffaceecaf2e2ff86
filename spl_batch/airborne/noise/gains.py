"""Gains: how much of a flightline's noise each channel hears, and comes from each ground cell.

Domain: time. Counts over what rates expect are drawn to a prior as far as chance explains their
differences (empirical Bayes, gamma prior): those of channels to one, those of ground cells to the
cells around, and these to one. Dead channels hear nothing.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.ground_cells import STRIDE, cells
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.lattice.tables import BeamTable, PointTable

CHANCE_SIGMA: Final = 3.0
"""Poisson deviations within which a difference between two counts may be chance."""

SURE_SIGMA: Final = 5.0
"""Poisson deviations from which on it is none, however many are compared: one of a million."""


def active_channels(
    seen: NDArray[np.int64], beamlets: int
) -> tuple[int, NDArray[np.float64], tuple[Finding, ...]]:
    """Beamlets per shot, gains as far as live and dead channels decide them, and warnings.

    ``seen``: (256,), beamlets seen of each channel; ``beamlets``: per shot, that the sensor has.
    Gains, (256,), are 0 for dead channels, equal for all others; their mean is one.
    """
    live = seen > 0
    alive = int(live.sum())
    if alive > beamlets:
        least = np.argsort(np.where(live, seen, seen.max() + 1), kind="stable")[: alive - beamlets]
        values = {"kind": "more", "alive": alive, "beamlets": beamlets, "channels": least.tolist()}
        return alive, live.astype(np.float64), (Finding("I04", values, badness=alive),)
    if seen.sum() < 10 * beamlets or alive == beamlets:
        return beamlets, np.ones(256), ()
    gain = live.astype(np.float64) * (beamlets / alive)
    numbers, dead = np.flatnonzero(live), beamlets - alive
    first, last = int(numbers[0]), int(numbers[-1])
    gaps = np.setdiff1d(np.arange(first, last), numbers).tolist()
    values = {
        "kind": "gaps" if gaps else "whole",
        "dead": dead, "beamlets": beamlets, "first": first, "last": last, "gaps": gaps,
    }  # fmt: skip
    return beamlets, gain, (Finding("I07", values, badness=dead),)


def channel_gains(
    by_channel: NDArray[np.int64], active: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Gain of each channel, by its noise returns, with the mean of ``active``: (256,) float64."""
    # A live channel without noise returns was seen, not counted: it keeps its mean share.
    used = np.flatnonzero((active > 0) & (by_channel > 0))
    if len(used) == 0:
        return active
    n = by_channel[used].astype(np.float64)
    # Weak channels are different: only ordinary ones share a prior.
    usual = float(np.median(n))
    ordinary = np.abs(n - usual) <= SURE_SIGMA * np.sqrt(usual + 1.0)
    expected = float(n[ordinary].mean())
    weight = prior_weight(by_channel[used][ordinary], np.full(ordinary.sum(), expected))
    raw = np.where(ordinary, (n + weight) / (expected + weight), n / expected)
    gain = active.copy()
    gain[used] = raw * (active[used].sum() / raw.sum())
    return gain


def prior_weight(n: NDArray[Any], expected: NDArray[np.float64]) -> float:
    """Counts that a gamma prior is worth: 1 / relative variance beyond Poisson."""
    excess = float(np.sum((n - expected) ** 2 - expected))
    square = float(np.sum(expected**2))
    return square / excess if excess > 1e-9 * square > 0 else 1e9


def ground(
    merged: dict[str, NDArray[Any]],
    interval: NDArray[np.int64],
    expected: NDArray[np.float64],
    buffers: tuple[int, int],
    sides: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cells of the ground that a flightline looked at, ascending, and their gains: two (c,).

    ``interval``: (m,), those of the looks, and silent ones. ``buffers``: rungs of the ladder, that
    of the rates, and a nearer one: it hears more noise, and is taken where no more lies between
    the two than beyond both. ``expected``: (2, m), noise of each interval by its rate beyond either
    [count]. ``sides``: (2,), weights of the sides of the signal.
    """
    cell, at = np.unique(merged["look_cell"], return_inverse=True)
    row = np.repeat(np.searchsorted(interval, merged["interval"]), merged["looks"])
    number = merged["look_number"].astype(np.float64)
    share = number / np.bincount(row, number, len(interval))[row]
    n, model = np.empty((2, 2, len(cell)))
    for k, (rung, of_interval) in enumerate(zip(buffers, expected, strict=True)):
        counted = (merged["look_outside"][:, :, rung] @ sides) * (of_interval[row] > 0.0)
        n[k], model[k] = (
            np.bincount(at, values, len(cell)) for values in (counted, share * of_interval[row])
        )
    between_n, between = n[1] - n[0], np.maximum(model[1] - model[0], 0.0)
    # With one gain the difference is 0 but for chance, with this variance. Signal only adds.
    chance = n[1] * between * model[0]
    clear = between_n * model[0] - n[0] * between <= CHANCE_SIGMA * np.sqrt(chance)
    n, model = (np.where(clear, values[1], values[0]) for values in (n, model))
    return cell, ground_gains(cell, n, model)


def ground_gains(
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
