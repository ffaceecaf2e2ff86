"""Flightlines over hills and roofs, one of them shifted."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(10_000_000, 20_000_000, 10_080_000, 20_080_000)
"""What is looked at [quanta]."""

Heights = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


class Shift(NamedTuple):
    """Where a flightline lies [m]."""

    east: float = 0.0
    north: float = 0.0
    up: float = 0.0


def hills(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ground with slopes in all directions, up to a fifth."""
    return 2.0 * np.sin(x / 14) + 2.0 * np.cos(y / 17) + 0.02 * x


class Returns(NamedTuple):
    """Returns of a flightline [m]."""

    psid: int
    xyz: NDArray[np.float64]


def ground(
    psid: int,
    shift: Shift,
    *,
    per_m2: float = 3.0,
    noise_m: float = 0.05,
    heights: Heights = hills,
    edge_m: float = 80.0,
    seed: int = 0,
) -> Returns:
    """Returns of a flightline from everywhere in the core."""
    rng = np.random.default_rng((seed, psid))
    count = round(per_m2 * edge_m**2)
    x, y = rng.uniform(0, edge_m, (2, count))
    z = heights(x - shift.east, y - shift.north) + shift.up + rng.normal(0, noise_m, count)
    return Returns(psid, np.stack([x + 10_000, y + 20_000, z], axis=1))


def table(lines: Sequence[Returns]) -> PointTable:
    """Points of several flightlines."""
    xyz = np.rint(1000 * np.concatenate([line.xyz for line in lines])).astype(np.int64)
    psid = np.concatenate([np.full(len(line.xyz), line.psid) for line in lines])
    return PointTable(
        {
            "x": xyz[:, 0],
            "y": xyz[:, 1],
            "z": xyz[:, 2].astype(np.int32),
            "line": psid.astype(np.uint16),
        }
    )


def two_strips(
    shift: Shift,
    *,
    per_m2: float = 3.0,
    noise_m: float = 0.05,
    heights: Heights = hills,
    edge_m: float = 80.0,
    seed: int = 0,
) -> PointTable:
    """Two flightlines, the second shifted."""
    alike = {"per_m2": per_m2, "noise_m": noise_m, "edge_m": edge_m}
    return table(
        [
            ground(1, Shift(), heights=heights, seed=seed, **alike),  # type: ignore[arg-type]
            ground(2, shift, heights=heights, seed=seed, **alike),  # type: ignore[arg-type]
        ]
    )


NAMES = {1: "one", 2: "two"}
