"""Clouds in metres for the ground filters, of the types that a run gives them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


def places(n: int, edge_m: float, seed: int = 1) -> Float:
    """Places spread evenly over a square: (2, n) [m]."""
    return np.random.default_rng(seed).uniform(0, edge_m, (2, n))


def table(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> PointTable:
    """Points in the order given."""
    xq, yq, zq = (np.rint(np.asarray(v, float) * 1000).astype(np.int64) for v in (x, y, z))
    return PointTable({"x": xq, "y": yq, "z": zq.astype(np.int32)})


def ground_of(points: PointTable, method: str = "multiscale") -> Mask:
    """Ground among points that are all usable, by a method with its defaults."""
    settings = GroundSettings.model_validate({"method": method})
    return ground_mask(points, np.ones(len(points), np.bool_), settings)
