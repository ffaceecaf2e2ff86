"""Noise that is observed over what is expected, by layer of height, as facts of a cell.

Cubes are those of :mod:`~spl_batch.airborne.noise.haze`; the findings are those of
:mod:`~spl_batch.airborne.diagnostics.noise_fit`.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.expected_noise import Look, NoiseModel
from spl_batch.airborne.noise.gains import CHANCE_SIGMA
from spl_batch.airborne.noise.ground_cells import PARTS
from spl_batch.airborne.noise.haze import (
    CELL_M,
    CUBE_M,
    SMOOTH,
    WINDOW,
    Air,
    Axes,
    Counts,
    Expected,
    centres,
    quarters,
    sum_of_square,
)
from spl_batch.lattice.tiles import quanta

STEP: Final = 1.1
"""Ratio of the model's noise from one layer to the next from which on a gate ends there: one of ten
flightlines; elsewhere it changes over tens of metres."""


class Layers(NamedTuple):
    """Returns of cubes in noise alone, by layer, beside what the model expects."""

    layer: NDArray[np.int64]  #: (l,): index on the absolute lattice.
    returns: NDArray[np.int64]  #: (l,): returns [count].
    expected: NDArray[np.float64]  #: (l,): by the model [count].


def layer_facts(look: Look, model: NoiseModel | None) -> list[list[float]]:
    """Index, returns and expected returns of each layer of a cell, of one at least."""
    if look.counts is None or model is None:
        return []
    heard = model.listened if model.heard else None
    layers = noise_by_layer(look.counts, look.air, model.local, look.core, heard)
    listed = zip(*(values.tolist() for values in layers), strict=True)
    return [[layer, *both] for layer, *both in listed if any(both)]


def noise_by_layer(
    counts: Counts,
    air: Air | None,
    expected: Expected,
    core: tuple[int, int, int, int],
    heard_at: Expected | None = None,
) -> Layers:
    """Noise that is seen beside noise that is expected, away from haze and surfaces.

    Even squares of the absolute grid without an empty column hold noise alone; those that a gate's
    end cuts, or lies beside, are left out.

    Parameters
    ----------
    counts, expected
        As for :func:`~spl_batch.airborne.noise.haze.find_air`.
    core : (int, int, int, int)
        West, south, east, north: squares count whose middle lies in it [quanta].
    heard_at
        The model's noise where flightlines are known to listen, 0 elsewhere; as ``expected``
        without.
    """
    edge, half = quanta(CUBE_M), WINDOW // 2
    asked = np.zeros(counts.held.shape, np.bool_)
    inside = []
    for axis, (low, high) in enumerate(((core[0], core[2]), (core[1], core[3]))):
        cube = np.arange(counts.held.shape[axis]) + counts.corner[axis]
        middle = cube * edge + edge // 2
        inside.append((cube % WINDOW == half) & (low <= middle) & (middle < high))
    asked[np.ix_(*inside, counts.held.any(axis=(0, 1)))] = True
    full = sum_of_square(np.asarray(counts.held.any(axis=2), np.int64)) == WINDOW**2
    asked &= full[:, :, np.newaxis]
    columns, cells = (sum_of_square(pairs) for pairs in (counts.columns, counts.cells))
    parts = round(CUBE_M / CELL_M)
    asked &= parts * cells <= columns + CHANCE_SIGMA * np.sqrt(2.0 * (parts - 1) * columns)
    if air is not None:
        at = air.cube - [*counts.corner, 0]
        at[:, 2] = np.searchsorted(counts.layer, at[:, 2])
        asked[tuple(at.T)] = False
    lower, upper = quarters(counts.held, asked)
    asked &= upper <= SMOOTH * (lower + CHANCE_SIGMA * np.sqrt(lower + 1.0))
    at_middle = np.nonzero(asked)
    # The middle cube stands for its square.
    place = centres(counts, at_middle)
    model, seen = expected(place) * CUBE_M**3, counts.held[at_middle]
    model = np.rint(model * PARTS) / PARTS
    heard = (model > 0.0) & ~_cut(place, heard_at or expected)
    returns, predicted = (
        np.bincount(at_middle[2][heard], values[heard], len(counts.layer))
        for values in (seen, model)
    )
    return Layers(counts.layer, np.rint(returns).astype(np.int64), predicted.astype(np.float64))


def _cut(place: Axes, heard_at: Expected) -> NDArray[np.bool_]:
    """Cubes in which a gate ends, or beside which it does: the model has a step there."""
    x, y, z = place
    near = np.stack([heard_at((x, y, z + step * quanta(CUBE_M))) for step in (-1, 0, 1)])
    cut: NDArray[np.bool_] = (near[1] <= 0.0) | (near.max(axis=0) > STEP * near.min(axis=0))
    return cut
