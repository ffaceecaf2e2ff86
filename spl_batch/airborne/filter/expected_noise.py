"""Noise expected at points: the sum of all stretches' shares of the voxels around them.

Where haze or cloud fills the air, it is what the air holds.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.noise.haze import (
    CUBE_M,
    WINDOW,
    Air,
    Axes,
    Counts,
    count_cubes,
    find_air,
    noise_with_air,
)
from spl_batch.airborne.noise.local_noise import MARGIN_VOXELS, SQUARES, around, listened
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.lattice.tables import EXCLUDED, ROWS_AT_ONCE, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, cell_index, inside, quanta

COLUMNS_OF_AIR: Final = ("x", "y", "z", "flags", "afterpulse")
"""Columns by which the air is looked at."""


class Share(Protocol):
    """A stretch's share of the expected noise."""

    def layers(self) -> range:
        """Absolute indices of its layers of voxels."""

    def add(self, corner: Sequence[int], totals: Mapping[str, NDArray[Any]]) -> None:
        """Add it to a box of voxels, in place: first voxel, and the box's sums by name."""


class _Box(NamedTuple):
    """Voxels of points with those around: an edge here may show in none of them alone.

    It has no layers beyond those that hold noise: one stray point would stretch it to the sky. What
    lies above or below is as silent as its highest or lowest layer.
    """

    corner: tuple[int, int, int]
    shape: tuple[int, int, int]
    edge: int

    def voxels(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> tuple[NDArray[np.int64], ...]:
        """Indices of some points' voxels."""
        i, j, k = (
            cell_index(axis.astype(np.int64, copy=False), self.edge) - first
            for axis, first in zip(xyz, self.corner, strict=True)
        )
        return i, j, np.clip(k, 0, self.shape[2] - 1)


class NoiseModel(NamedTuple):
    """Noise of a region's voxels, ready to be asked at places in it."""

    box: _Box
    density: NDArray[np.float64]  #: (i, j, k): mean of each voxel [1/m3].
    heard: tuple[NDArray[np.float32], ...]  #: Noise of each flightline over its squares [1/m3].

    def local(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> NDArray[np.float64]:
        """Noise at places, of the part of their voxels that is listened to: (n,) [1/m3]."""
        out = np.empty(len(xyz[0]))
        for some in _batches(len(out)):
            place = [axis[some] for axis in xyz]
            near = self.listened(place)
            # published, or beside all that any beamlet crosses
            none = np.flatnonzero(~(near > 0.0))
            near[none] = self.density[self.box.voxels([axis[none] for axis in place])]
            out[some] = near
        return out

    def listened(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> NDArray[np.float64]:
        """The same, 0 where no flightline is known to listen, as beyond a gate: (n,) [1/m3]."""
        return around(self.heard, xyz, self.box.edge, self.box.corner)

    def mean(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> NDArray[np.float64]:
        """Mean noise of the voxels around places: (n,) [1/m3]."""
        out = np.empty(len(xyz[0]))
        for some in _batches(len(out)):
            out[some] = self.density[self.box.voxels([axis[some] for axis in xyz])]
        return out


def noise_model(
    xyz: Sequence[NDArray[np.integer[Any]]],
    lines: Sequence[Sequence[Share]],
    beamlets: int,
    settings: NoiseSettings,
) -> NoiseModel | None:
    """Noise of the voxels around points; None without points or shares.

    Parameters
    ----------
    xyz : three of (n,) integer
        Absolute coordinates [quanta].
    lines : sequence of sequences of Share
        Shares of each flightline's stretches with voxels within two voxels of the points'.
    beamlets : int
        Beamlets of a shot, for the published correction.
    """
    if not len(xyz[0]) or not lines:
        return None
    layers = [layers for line in lines for share in line if (layers := share.layers())]
    box = _box(xyz, quanta(settings.voxel_m), layers)
    published = settings.correction == "published"
    names = ("amount", "shots", "beamlets") if published else ("amount",)
    totals = {name: np.zeros(box.shape, dtype=np.int64) for name in names}
    heard: list[NDArray[np.float32]] = []
    for line in lines:
        sums: dict[str, NDArray[Any]] = {k: np.zeros(box.shape, dtype=np.int64) for k in names}
        if not published:
            sums["squares"] = np.zeros((*box.shape, SQUARES**2), dtype=np.uint32)
        for share in line:
            share.add(box.corner, sums)
        for name in names:
            totals[name] += sums[name]
        if not published:
            found = listened(sums["amount"], sums["squares"], settings.voxel_m)
            heard += [] if found is None else [found]
    density = voxel_noise.density(
        totals["amount"],
        settings,
        shots=totals.get("shots"),
        beamlets=totals.get("beamlets"),
        beamlets_per_shot=beamlets,
    )
    return NoiseModel(box, density, tuple(heard))


def _box(xyz: Sequence[NDArray[np.integer[Any]]], edge: int, layers: Sequence[range]) -> _Box:
    """Box around points, no higher and no lower than layers that hold noise."""
    ends = [np.array([axis.min(), axis.max()], dtype=np.int64) for axis in xyz]
    low, high = map(list, zip(*(cell_index(pair, edge).tolist() for pair in ends), strict=True))
    low[2] = max(low[2], min((some.start for some in layers), default=high[2]))
    high[2] = max(min(high[2], max((some.stop for some in layers), default=low[2])), low[2])
    corner = tuple(i - MARGIN_VOXELS for i in low)
    shape = tuple(i - c + 1 + MARGIN_VOXELS for i, c in zip(high, corner, strict=True))
    return _Box((corner[0], corner[1], corner[2]), (shape[0], shape[1], shape[2]), edge)


def _batches(n: int) -> Iterator[slice]:
    return (slice(first, first + ROWS_AT_ONCE) for first in range(0, n, ROWS_AT_ONCE))


class Look(NamedTuple):
    """What a cell shows of its noise."""

    core: Bounds  #: What it owns [quanta].
    #: Air that holds more noise than the model expects, in the cell and around it.
    air: Air | None = None
    counts: Counts | None = None  #: Returns of cubes, by which it was found.


def look_at_air(
    table: PointTable, model: NoiseModel | None, workflow: Workflow, core: Bounds
) -> Look:
    """Air of a cell and its margin that holds more noise than the model expects.

    ``table``: points with :data:`COLUMNS_OF_AIR`.
    """
    if model is None or not denoising.asks_for_air(workflow.filter, workflow.noise):
        return Look(core)
    counted = ~table.has(EXCLUDED | PointFlag.NO_BEAM) & ~dependents(table)
    x, y, z = (table[axis] for axis in "xyz")
    counts = count_cubes((x, y, z), counted)
    if counts is None:
        return Look(core)
    return Look(core, find_air(counts, model.local), counts)


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


def air_facts(look: Look) -> list[list[float]]:
    """Air over what a cell owns, as facts of the cell, by :func:`_places`."""
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
