"""Lines of sight from where the sensor was to what it saw."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(nogil=True, cache=True)
def look(
    starts: NDArray[np.int64],
    sensor: NDArray[np.float64],
    place: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]],
    step_m: float,
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    range_m: NDArray[np.float64],
) -> None:
    """Line of sight of each return, shot by shot.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where shots start, then n.
    sensor : (m, 3) float64
        Sensor at each shot [m]; NaN where it is not known.
    place : three (n,) integer arrays
        Easting, northing and height of each return [steps].
    step_m : float
        A step [m].
    origin, direction : (n, 3) float64
        Filled with the sensor's place [m] and the unit vector from it to the return; the vector
        is not finite where there is none.
    range_m : (n,) float64
        Filled with the distance [m]; 0 or NaN where there is no line.
    """
    x, y, z = place
    for shot in range(len(starts) - 1):
        ox, oy, oz = sensor[shot, 0], sensor[shot, 1], sensor[shot, 2]
        for i in range(starts[shot], starts[shot + 1]):
            dx, dy, dz = x[i] * step_m - ox, y[i] * step_m - oy, z[i] * step_m - oz
            length = math.sqrt(dx * dx + dz * dz + dy * dy)
            scale = length if length > 0.0 else np.nan
            origin[i, 0], origin[i, 1], origin[i, 2] = ox, oy, oz
            direction[i, 0], direction[i, 1], direction[i, 2] = dx / scale, dy / scale, dz / scale
            range_m[i] = length
