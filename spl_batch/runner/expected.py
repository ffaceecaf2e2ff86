"""Noise expected at points: the sum of all stretches' shares of the voxels around them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.io.store import Store
from spl_batch.io.voxels import add_voxels
from spl_batch.settings import NoiseSettings
from spl_batch.stages import voxel_noise
from spl_batch.stages.local_noise import MARGIN_VOXELS, SQUARES, listened_density
from spl_batch.tiling import cell_index, quanta


class Expected(NamedTuple):
    """Noise density at n points [1/m3].

    Parameters
    ----------
    mean : (n,) float64
        Of each point's whole voxel: what is delivered.
    local : (n,) float64
        Of the part of it that is listened to: what points are tested with.
    """

    mean: NDArray[np.float64]
    local: NDArray[np.float64]


class _Box(NamedTuple):
    """Voxels of points with those around: whether an edge lies here does not show in one."""

    corner: tuple[int, int, int]
    shape: tuple[int, int, int]
    voxel: tuple[NDArray[np.int64], ...]
    square: tuple[NDArray[np.int64], ...]


def expected_noise(
    xyz: Sequence[NDArray[np.integer[Any]]],
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
    parts : sequence of str
        ``LINE/K`` of every stretch with voxels within two voxels of the points'.
    beamlets : int
        Beamlets of a shot, for the published correction.
    store : Store
        Holds the parts.
    settings : NoiseSettings
        Voxel and correction.
    """
    if not len(xyz[0]) or not parts:
        return Expected(np.zeros(len(xyz[0])), np.zeros(len(xyz[0])))
    box = _box(xyz, quanta(settings.voxel_m))
    published = settings.correction == "published"
    names = ("amount", "shots", "beamlets") if published else ("amount",)
    totals = {name: np.zeros(box.shape, dtype=np.int64) for name in names}
    local = np.zeros(len(xyz[0]))
    for line in _by_line(parts):
        sums: dict[str, NDArray[Any]] = {k: np.zeros(box.shape, dtype=np.int64) for k in names}
        if not published:
            sums["squares"] = np.zeros((*box.shape, SQUARES**2), dtype=np.uint32)
        for part in line:
            add_voxels(store.path("voxels", f"{part}.zarr"), box.corner, sums)
        for name in names:
            totals[name] += sums[name]
        if not published:
            local += listened_density(
                sums["amount"], sums["squares"], box.voxel, box.square, settings.voxel_m
            )
    density = voxel_noise.density(
        totals["amount"],
        settings,
        shots=totals.get("shots"),
        beamlets=totals.get("beamlets"),
        beamlets_per_shot=beamlets,
    )
    # published, or beside all that any beamlet crosses
    within = voxel_noise.within_gate(density)[box.voxel]
    return Expected(density[box.voxel], np.where(local > 0.0, local, within))


def _box(xyz: Sequence[NDArray[np.integer[Any]]], edge: int) -> _Box:
    points = [axis.astype(np.int64) for axis in xyz]
    index = [cell_index(p, edge) for p in points]
    low = [int(i.min()) - MARGIN_VOXELS for i in index]
    size = [int(i.max()) - c + 1 + MARGIN_VOXELS for i, c in zip(index, low, strict=True)]
    voxel = tuple(i - c for i, c in zip(index, low, strict=True))
    square = tuple((points[k] - low[k] * edge) * SQUARES // edge for k in (0, 1))
    return _Box((low[0], low[1], low[2]), (size[0], size[1], size[2]), voxel, square)


def _by_line(parts: Sequence[str]) -> list[list[str]]:
    """Names of stretches, a list for each flightline, in the order of names."""
    lines: dict[str, list[str]] = {}
    for part in sorted(parts):
        lines.setdefault(part.rpartition("/")[0], []).append(part)
    return list(lines.values())
