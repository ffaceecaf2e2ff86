"""Where a photon from below water comes from (C. Parrish et al., Remote Sens. 11, 1634, 2019).

A product places photons as if light went through air all the way. In water it is slower and bends:
a floor seems deeper than it is, by a third at nadir. The correction is that paper's, for a level
surface: S = D / cos(t1) is the slant range in air, R = S n1 / n2 that in water, and their
difference as vectors is what a photon is moved by.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

AIR: Final = 1.00029
WATER: Final = 1.34116
"""Refractive indices that the paper gives, for sea water and 532 nm."""


def refracted(
    depth_m: NDArray[np.float64], off_nadir_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What photons below a surface are moved by, (n,) float64 each [m].

    Parameters
    ----------
    depth_m : (n,) float64
        Depth below the surface as the product has it; nothing moves at 0 and above [m].
    off_nadir_deg : float
        Angle of the ray in air from the vertical [deg].

    Returns
    -------
    across : (n,) float64
        Horizontally, against the way that the ray is inclined [m].
    up : (n,) float64
        Upwards [m].
    """
    depth = np.maximum(depth_m, 0.0)
    air = np.radians(off_nadir_deg)
    water = np.arcsin(AIR * np.sin(air) / WATER)
    apparent = depth / np.cos(air)
    true = apparent * AIR / WATER
    return (
        apparent * np.sin(air) - true * np.sin(water),
        true * -np.cos(water) + apparent * np.cos(air),
    )
