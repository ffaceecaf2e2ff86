"""Noise of a block as the model has it, and as it is where haze or cloud fills the air."""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.filter.expected_noise import Expected, NoiseModel
from spl_batch.airborne.noise.haze import (
    CUBE_M,
    Air,
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
    """What a block sees of its noise: air that holds more, and how the model fits elsewhere."""

    air: Air | None = None
    layers: Layers | None = None


def look_at_air(
    table: PointTable, model: NoiseModel | None, workflow: Workflow, core: Bounds
) -> Look:
    """Air of a block and its halo that holds more noise than the model expects.

    Parameters
    ----------
    table : PointTable
        Points with :data:`COLUMNS_NEEDED`.
    model : NoiseModel or None
        What is expected.
    workflow : Workflow
        Whether it is looked for.
    core : Bounds
        What the block owns.
    """
    if model is None or not denoising.asks_for_air(workflow.filter, workflow.noise):
        return Look()
    counted = ~table.has(EXCLUDED | PointFlag.NO_BEAM) & ~dependents(table)
    x, y, z = (table[axis].astype(np.int64, copy=False) for axis in "xyz")
    counts = count_cubes((x, y, z), counted)
    if counts is None:
        return Look()
    air = find_air(counts, model.local)
    return Look(air, noise_by_layer(counts, air, model.local, core))


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


def facts_of(look: Look, core: Bounds) -> dict[str, Any]:
    """What a report says of it: ``air`` of :func:`_summary`, and ``layers``.

    Returns
    -------
    dict
        ``layers``: index, returns and expected returns of each; empty where nothing was looked at.
    """
    told = [] if look.layers is None else zip(*look.layers, strict=True)
    layers = [
        [int(layer), int(returns), float(expected)]
        for layer, returns, expected in told
        if returns or expected
    ]
    return {"air": _summary(look.air, core), "layers": layers}


def _summary(air: Air | None, core: Bounds) -> dict[str, Any] | None:
    """What a report says of the air over what a block owns; None where there is none.

    Returns
    -------
    dict or None
        ``squares``, seen from above, and ``cubes`` [count]; ``returns`` in them [count];
        ``expected`` by the model [count]; ``low`` and ``high``, heights between which nine tenths
        of the returns lie [quanta]; ``box`` around them [quanta].
    """
    if air is None:
        return None
    edge = quanta(CUBE_M)
    centre = air.cube * edge + edge // 2
    mine = air.held & inside(centre[:, 0], centre[:, 1], core)
    if not mine.any():
        return None
    cube, count = air.cube[mine], air.returns[mine]
    order = np.argsort(cube[:, 2], kind="stable")
    share = np.cumsum(count[order]) / count.sum()
    low, high = (cube[order[np.searchsorted(share, at)], 2] for at in (0.05, 0.95))
    (west, south), (east, north) = (cube[:, :2].min(axis=0), cube[:, :2].max(axis=0) + 1)
    return {
        "squares": len(np.unique(cube[:, :2], axis=0)),
        "cubes": len(cube),
        "returns": int(count.sum()),
        "expected": float(air.expected[mine].sum() * CUBE_M**3),
        "low": int(low) * edge,
        "high": (int(high) + 1) * edge,
        "box": [int(side) * edge for side in (west, south, east, north)],
    }
