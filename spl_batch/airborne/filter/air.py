"""Noise of a block: as the model has it, and as it is where haze or cloud fills the air."""

from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.filter.expected_noise import NoiseModel
from spl_batch.airborne.noise.haze import (
    CUBE_M,
    WINDOW,
    Air,
    Axes,
    Layers,
    count_cubes,
    find_air,
    noise_by_layer,
    noise_with_air,
)
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, inside, quanta

COLUMNS_NEEDED: Final = ("x", "y", "z", "flags", "afterpulse")


class Look(NamedTuple):
    """What a cell shows of its noise."""

    core: Bounds  #: What it owns [quanta].
    #: Air that holds more noise than the model expects, in the cell and around it.
    air: Air | None = None
    layers: Layers | None = None  #: How the model fits elsewhere.


def look_at_air(
    table: PointTable, model: NoiseModel | None, workflow: Workflow, core: Bounds
) -> Look:
    """Air of a cell and its margin that holds more noise than the model expects.

    ``table``: points with :data:`COLUMNS_NEEDED`.
    """
    if model is None or not denoising.asks_for_air(workflow.filter, workflow.noise):
        return Look(core)
    counted = ~table.has(EXCLUDED | PointFlag.NO_BEAM) & ~dependents(table)
    x, y, z = (table[axis] for axis in "xyz")
    counts = count_cubes((x, y, z), counted)
    if counts is None:
        return Look(core)
    air = find_air(counts, model.local)
    heard = model.listened if model.heard else None
    return Look(core, air, noise_by_layer(counts, air, model.local, core, heard))


class NoiseInAir(NamedTuple):
    """Noise expected in a region, the larger of the model's and the air's."""

    model: NoiseModel | None
    air: Air | None = None  #: From :func:`look_at_air`.

    def local(self, table: PointTable) -> NDArray[np.float64]:
        """Noise around points, of what is listened to; they are tested with it: (n,) [1/m3]."""
        return self._larger(table, lambda model, xyz: model.local(xyz))

    def mean(self, table: PointTable) -> NDArray[np.float64]:
        """Noise of the whole voxels around points, silence included: (n,) [1/m3]."""
        return self._larger(table, lambda model, xyz: model.mean(xyz))

    def _larger(
        self, table: PointTable, of_model: Callable[[NoiseModel, Axes], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        if self.model is None:
            return np.zeros(len(table))
        xyz = (table["x"], table["y"], table["z"])
        return noise_with_air(xyz, of_model(self.model, xyz), self.air)


def facts_of(look: Look) -> dict[str, Any]:
    """Report entries of a cell: ``air`` over what it owns, by :func:`_places`, and ``layers``.

    ``layers`` has index, returns and expected returns of each; none where nothing was looked at.
    """
    layers = () if look.layers is None else zip(*(v.tolist() for v in look.layers), strict=True)
    listed = [[layer, *both] for layer, *both in layers if any(both)]
    return {"air": _listed(look), "layers": listed}


def _listed(look: Look) -> list[list[float]]:
    """Air over what a cell owns, by :func:`_places`."""
    if look.air is None:
        return []
    centre = look.air.cube * quanta(CUBE_M) + quanta(CUBE_M) // 2
    mine = look.air.held & inside(centre[:, 0], centre[:, 1], look.core)
    if not mine.any():
        return []
    return list(_places(look.air.cube[mine], look.air.returns[mine], look.air.expected[mine]))


def _places(
    cube: NDArray[np.int64], count: NDArray[np.int64], expected: NDArray[np.float64]
) -> Iterator[list[float]]:
    """Air by squares of the absolute grid, each from one layer without any to the next.

    Yields
    ------
    [west, south, east, north, low, high, squares, cubes, returns, expected]
        Box around its cubes, and the layers between which nine tenths of its returns lie [cubes];
        cubes seen from above, all cubes, returns and what the model expects of them [count].
    """
    square = cube[:, :2] // WINDOW
    order = np.lexsort((cube[:, 2], square[:, 1], square[:, 0]))
    cube, square, count, expected = cube[order], square[order], count[order], expected[order]
    new = (np.diff(square, axis=0) != 0).any(axis=1) | (np.diff(cube[:, 2]) > 1)
    for own in np.split(np.arange(len(cube)), np.flatnonzero(new) + 1):
        at, returns = cube[own], count[own]
        share = np.cumsum(returns) / returns.sum()
        low, high = (int(at[np.searchsorted(share, end), 2]) for end in (0.05, 0.95))
        yield [
            *at[:, :2].min(axis=0).tolist(), *(at[:, :2].max(axis=0) + 1).tolist(), low, high,
            len(np.unique(at[:, :2], axis=0)), len(own), int(returns.sum()),
            round(float(expected[own].sum()) * CUBE_M**3, 3),
        ]  # fmt: skip
