"""A slice of a photon file, as any of the layouts gives it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Slice:
    """Consecutive photons."""

    start: int  #: Position of the first one in the file.
    #: (n,): along-track distance and height [m]; not finite where unknown.
    along_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    #: (n,): where [deg]; NaN where unknown.
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
