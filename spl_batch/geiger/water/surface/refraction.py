"""The way of a beam into the water [G15 2.5.2, Eq. 2-27].

The normal points out of the water, as in the source; k is its dot product with the beam, reversed.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def refracted(beam: Floats, normal: Floats, index_water: float) -> Floats:
    """Direction of a beam behind the surface [G15 Eq. 2-27]: (..., 3) float64, unit vectors.

    ``beam`` points towards the water, ``normal`` out of it; ``index_water``: that of air being 1.
    """
    eta = 1.0 / index_water
    k = -(beam * normal).sum(axis=-1, keepdims=True)
    root = np.sqrt(1.0 + eta**2 * (k**2 - 1.0))
    behind: Floats = eta * beam + (eta * k - root) * normal
    return behind


def floor_points(surface: Floats, direction: Floats, in_water_m: float | Floats) -> Floats:
    """Where rays end after a path in water: (..., 3) float64 [m]."""
    ends: Floats = surface + np.asarray(in_water_m)[..., None] * direction
    return ends
