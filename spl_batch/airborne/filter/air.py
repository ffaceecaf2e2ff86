"""Noise of a block: as the model has it, and as it is where haze or cloud fills the air."""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.filter.expected_noise import Expected, NoiseModel
from spl_batch.airborne.noise import haze
from spl_batch.airborne.noise.haze import (
    CUBE_M,
    REACH_M,
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

CUBES_MOST: Final = 2_000_000
"""Cubes that are counted at once [count], 60 bytes each: those of a wide block with few points take
more than the points do."""

MARGIN: Final = round(REACH_M / CUBE_M)
"""What a strip reads on each side [cubes]."""

COLUMNS_NEEDED: Final = ("x", "y", "z", "flags", "afterpulse")


class Look(NamedTuple):
    """What a part of a block sees of its noise."""

    core: Bounds  #: The part [quanta].
    #: Air that holds more noise than the model expects, in the part and around it.
    air: Air | None = None
    layers: Layers | None = None  #: How the model fits elsewhere.


def look_at_air(
    table: PointTable, model: NoiseModel | None, workflow: Workflow, core: Bounds
) -> Look:
    """Air of a block and its halo that holds more noise than the model expects.

    ``table``: points with :data:`COLUMNS_NEEDED`.
    """
    if model is None or not denoising.asks_for_air(workflow.filter, workflow.noise):
        return Look(core)
    counted = ~table.has(EXCLUDED | PointFlag.NO_BEAM) & ~dependents(table)
    x, y, z = (table[axis] for axis in "xyz")
    looks = [_look_at(span, (x, y, z), counted, model, core) for span in _strips((x, y, z))]
    airs = [look.air for look in looks if look.air is not None]
    layers = [look.layers for look in looks if look.layers is not None]
    return Look(core, _beside(airs) if airs else None, _added(layers) if layers else None)


def _strips(xyz: Axes) -> Iterator[tuple[int, int]]:
    """Spans of x, whole cubes, that hold no more than :data:`CUBES_MOST` each [quanta]."""
    if not len(xyz[0]):
        return
    edge = quanta(CUBE_M)
    (west, east), (south, north), (low, _) = (
        (int(axis.min()) // edge, int(axis.max()) // edge + 1) for axis in xyz
    )
    layers = int(np.count_nonzero(np.bincount(xyz[2] // edge - low)))
    wide = max(CUBES_MOST // ((north - south) * layers) - 2 * MARGIN, MARGIN)
    for first in range(west, east, wide):
        yield first * edge, min(first + wide, east) * edge


def _look_at(
    span: tuple[int, int], xyz: Axes, counted: NDArray[np.bool_], model: NoiseModel, core: Bounds
) -> Look:
    """Air of a strip, and noise by layer of the squares with their middles in it."""
    (low, high), margin = span, quanta(REACH_M)
    counts = count_cubes(xyz, counted & (xyz[0] >= low - margin) & (xyz[0] < high + margin))
    if counts is None:
        return Look(core)
    air = find_air(counts, model.local)
    mine = (max(core.xmin, low), core.ymin, min(core.xmax, high), core.ymax)
    layers = noise_by_layer(counts, air, model.local, mine, _heard(model))
    if air is None:
        return Look(core, None, layers)
    west = air.cube[:, 0] * quanta(CUBE_M)
    own = np.flatnonzero((west >= low) & (west < high))
    return Look(core, _beside([air], own) if len(own) else None, layers)


def _heard(model: NoiseModel) -> haze.Expected | None:
    """Where flightlines listen; None where none tells, as without its noise by squares."""
    return model.listened if model.heard else None


def _beside(parts: Sequence[Air], rows: NDArray[np.intp] | slice = slice(None)) -> Air:
    """Air of strips side by side, or some of its rows."""
    return Air(
        np.concatenate([part.cube for part in parts])[rows],
        np.concatenate([part.density for part in parts])[rows],
        np.concatenate([part.held for part in parts])[rows],
        np.concatenate([part.returns for part in parts])[rows],
        np.concatenate([part.expected for part in parts])[rows],
    )


def _added(parts: Sequence[Layers]) -> Layers:
    """Noise by layer of all strips."""
    layer, at = np.unique(np.concatenate([part.layer for part in parts]), return_inverse=True)
    returns = np.bincount(at, np.concatenate([part.returns for part in parts]), len(layer))
    expected = np.bincount(at, np.concatenate([part.expected for part in parts]), len(layer))
    return Layers(layer, returns.astype(np.int64), expected.astype(np.float64))


def noise_in_air(
    table: PointTable, told: NDArray[np.bool_], model: NoiseModel | None, air: Air | None
) -> Expected:
    """Noise expected at points, the larger of the model's and the air's.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z``.
    told : (n,) bool
        Points whose voxels' mean is wanted.
    model, air
        From :func:`~spl_batch.airborne.filter.expected_noise.noise_model` and :func:`look_at_air`.
    """
    if model is None:
        return Expected(np.zeros(np.count_nonzero(told)), np.zeros(len(table)))
    xyz = [table[axis] for axis in "xyz"]
    mean, local = model.mean(xyz, told), model.local(xyz)
    if air is not None:
        x, y, z = (axis.astype(np.int64, copy=False) for axis in xyz)
        local = noise_with_air((x, y, z), local, air)
        mean = noise_with_air((x[told], y[told], z[told]), mean, air)
    return Expected(mean, local)


def facts_of(looks: Sequence[Look]) -> dict[str, Any]:
    """Report entries of a block from those of its parts: ``air`` of :func:`_listed`, ``layers``.

    ``layers`` has index, returns and expected returns of each; none where nothing was looked at.
    """
    layers: dict[int, tuple[int, float]] = {}
    for told in (look.layers for look in looks if look.layers is not None):
        for layer, returns, expected in zip(*(v.tolist() for v in told), strict=True):
            before = layers.get(layer, (0, 0.0))
            layers[layer] = before[0] + returns, before[1] + expected
    listed = [[layer, *both] for layer, both in sorted(layers.items()) if any(both)]
    return {"air": _listed(looks), "layers": listed}


def _listed(looks: Sequence[Look]) -> list[list[float]]:
    """Air over what a block owns, by :func:`_places`."""
    edge = quanta(CUBE_M)
    own = []
    for core, air, _ in looks:
        if air is not None:
            centre = air.cube * edge + edge // 2
            mine = air.held & inside(centre[:, 0], centre[:, 1], core)
            own.append((air.cube[mine], air.returns[mine], air.expected[mine]))
    if not sum(len(cube) for cube, _, _ in own):
        return []
    cube, count, expected = (np.concatenate(some) for some in zip(*own, strict=True))
    order = np.lexsort(cube.T[::-1])  # the same sums, however many parts
    return list(_places(cube[order], count[order], expected[order]))


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
