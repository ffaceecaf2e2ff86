"""A slice of a photon file, as any of the layouts gives it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Slice:
    """Consecutive photons.

    Parameters
    ----------
    start : int
        Position of the first one in the file.
    along_m, height_m : (n,) float64
        Along-track distance and height [m]; not finite where unknown.
    latitude, longitude : (n,) float64
        Where [deg]; NaN where unknown.
    """

    start: int
    along_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
