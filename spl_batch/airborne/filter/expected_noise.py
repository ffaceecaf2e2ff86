"""Noise expected at points: the sum of all stretches' shares of the voxels around them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.noise.beamlet_counts import SQUARES
from spl_batch.airborne.noise.local_noise import MARGIN_VOXELS, Listened, around, listened
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.airborne.store.voxel_parts import add_voxels
from spl_batch.engine.store.working_store import Store
from spl_batch.lattice.tables import VoxelPart
from spl_batch.lattice.tiles import cell_index, quanta, shared_box

AT_ONCE: Final = 1 << 18
"""Points whose voxels are looked up at once [count]."""


Adder = Callable[[tuple[int, int, int], Mapping[str, NDArray[Any]]], None]
"""Adds a stretch's share to a box of voxels, in place: first voxel, and the box's sums by name."""


class Expected(NamedTuple):
    """Noise density at points [1/m3]."""

    mean: NDArray[np.float64]  #: (m,): of the whole voxel of each point that it was asked for.
    #: (n,): of the part of it that is listened to; points are tested with it.
    local: NDArray[np.float64]


class _Box(NamedTuple):
    """Voxels of points with those around: an edge here may show in none of them alone."""

    corner: tuple[int, int, int]
    shape: tuple[int, int, int]
    edge: int

    def voxels(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> tuple[NDArray[np.int64], ...]:
        """Indices of some points' voxels."""
        return tuple(
            cell_index(axis.astype(np.int64, copy=False), self.edge) - first
            for axis, first in zip(xyz, self.corner, strict=True)
        )

    def offsets(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> tuple[NDArray[np.float64], ...]:
        """From the centres of their squares, in squares, and voxels, in voxels [-0.5..0.5]."""
        return tuple(
            axis.astype(np.int64, copy=False) * parts % self.edge / self.edge - 0.5
            for axis, parts in zip(xyz, (SQUARES, SQUARES, 1), strict=True)
        )

    def squares(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> tuple[NDArray[np.int64], ...]:
        """Indices of their squares in a layer of voxels."""
        return tuple(
            (axis.astype(np.int64, copy=False) - first * self.edge) * SQUARES // self.edge
            for axis, first in zip(xyz[:2], self.corner[:2], strict=True)
        )


class NoiseModel(NamedTuple):
    """Noise of a region's voxels, ready to be asked at places in it."""

    box: _Box
    density: NDArray[np.float64]  #: (i, j, k): mean of each voxel [1/m3].
    within: NDArray[np.float64]  #: (i, j, k): the same of the part within the gate, roughly.
    heard: tuple[Listened, ...]  #: What each flightline listens to.

    def local(self, xyz: Sequence[NDArray[np.integer[Any]]]) -> NDArray[np.float64]:
        """Noise at places, of the part of their voxels that is listened to: (n,) [1/m3]."""
        n = len(xyz[0])
        out = np.empty(n)
        for some in _batches(n):
            place = [axis[some] for axis in xyz]
            voxel = self.box.voxels(place)
            near = around(self.heard, voxel, self.box.squares(place), self.box.offsets(place))
            # published, or beside all that any beamlet crosses
            none = np.flatnonzero(~(near > 0.0))
            near[none] = self.within[tuple(axis[none] for axis in voxel)]
            out[some] = near
        return out

    def mean(
        self, xyz: Sequence[NDArray[np.integer[Any]]], told: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Mean noise of the voxels of the m places told: (m,) [1/m3]."""
        found = [np.zeros(0)]
        for some in _batches(len(told)):
            chosen = np.flatnonzero(told[some])
            voxel = self.box.voxels([axis[some][chosen] for axis in xyz])
            found.append(self.density[voxel])
        return np.concatenate(found)


def noise_model(
    xyz: Sequence[NDArray[np.integer[Any]]],
    parts: Sequence[str],
    beamlets: int,
    store: Store,
    settings: NoiseSettings,
) -> NoiseModel | None:
    """Noise of the voxels around points; None without points or parts.

    Parameters
    ----------
    xyz, parts, beamlets, store, settings
        As for :func:`expected_noise`.
    """
    lines = [
        [partial(add_voxels, store.path("voxels", f"{part}.zarr")) for part in line]
        for line in _by_line(parts)
    ]
    return model_of_lines(xyz, lines, beamlets, settings)


def model_of_lines(
    xyz: Sequence[NDArray[np.integer[Any]]],
    lines: Sequence[Sequence[Adder]],
    beamlets: int,
    settings: NoiseSettings,
) -> NoiseModel | None:
    """The same from parts that lie anywhere.

    Parameters
    ----------
    xyz, beamlets, settings
        As for :func:`expected_noise`.
    lines : sequence of sequences of Adder
        Adders of each flightline's stretches; see :func:`adding`.
    """
    if not len(xyz[0]) or not lines:
        return None
    box = _box(xyz, quanta(settings.voxel_m))
    published = settings.correction == "published"
    names = ("amount", "shots", "beamlets") if published else ("amount",)
    totals = {name: np.zeros(box.shape, dtype=np.int64) for name in names}
    heard: list[Listened] = []
    for line in lines:
        sums: dict[str, NDArray[Any]] = {k: np.zeros(box.shape, dtype=np.int64) for k in names}
        if not published:
            sums["squares"] = np.zeros((*box.shape, SQUARES**2), dtype=np.uint32)
        for add in line:
            add(box.corner, sums)
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
    return NoiseModel(box, density, voxel_noise.within_gate(density), tuple(heard))


def expected_noise(
    xyz: Sequence[NDArray[np.integer[Any]]],
    told: NDArray[np.bool_],
    parts: Sequence[str],
    beamlets: int,
    store: Store,
    settings: NoiseSettings,
) -> Expected:
    """Noise expected at points.

    Parameters
    ----------
    xyz : three of (n,) integer
        Absolute coordinates [quanta].
    told : (n,) bool
        Points whose voxels' mean is wanted.
    parts : sequence of str
        ``LINE/K`` of every stretch with voxels within two voxels of the points'.
    beamlets : int
        Beamlets of a shot, for the published correction.
    """
    model = noise_model(xyz, parts, beamlets, store, settings)
    if model is None:
        return Expected(np.zeros(np.count_nonzero(told)), np.zeros(len(xyz[0])))
    return Expected(model.mean(xyz, told), model.local(xyz))


def _box(xyz: Sequence[NDArray[np.integer[Any]]], edge: int) -> _Box:
    ends = [np.array([axis.min(), axis.max()], dtype=np.int64) for axis in xyz]
    low, high = zip(*(cell_index(pair, edge).tolist() for pair in ends), strict=True)
    corner = tuple(i - MARGIN_VOXELS for i in low)
    shape = tuple(i - c + 1 + MARGIN_VOXELS for i, c in zip(high, corner, strict=True))
    return _Box((corner[0], corner[1], corner[2]), (shape[0], shape[1], shape[2]), edge)


def _batches(n: int) -> Iterator[slice]:
    return (slice(first, first + AT_ONCE) for first in range(0, n, AT_ONCE))


def _by_line(parts: Sequence[str]) -> list[list[str]]:
    """Names of stretches, a list for each flightline, in the order of names."""
    lines: dict[str, list[str]] = {}
    for part in sorted(parts):
        lines.setdefault(part.rpartition("/")[0], []).append(part)
    return list(lines.values())


def adding(part: VoxelPart) -> Adder:
    """What adds a part that is held in memory."""

    def add(corner: tuple[int, int, int], totals: Mapping[str, NDArray[Any]]) -> None:
        for name, total in totals.items():
            values = getattr(part, name)
            of_part, of_box = shared_box(part.corner, values.shape, corner, total.shape)
            total[of_box] += values[of_part].astype(total.dtype, copy=False)

    return add
