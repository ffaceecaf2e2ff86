"""Lines of sight from where the sensor was to what it saw, and what they pass through."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
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


def reach(
    place: Sequence[NDArray[np.integer[Any]]],
    step_m: float,
    direction: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Box around pieces of lines: lowest and highest coordinates, two (3,) float64 [m].

    Parameters
    ----------
    place : three (n,) integer arrays
        Point of each line [steps].
    direction : (n, 3) float64
        Unit vectors along the lines.
    near, far : (n,) float64
        Ends of each piece, along the line from the point [m].
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for axis, steps in enumerate(place):
        for along in (near, far):
            end = steps * step_m + along * direction[:, axis]
            low[axis] = min(low[axis], end.min(initial=np.inf))
            high[axis] = max(high[axis], end.max(initial=-np.inf))
    return low, high


def in_voxels(
    place: Sequence[NDArray[np.integer[Any]]],
    edge: int,
    corner: NDArray[np.int64],
    half_step_m: float,
    voxel: NDArray[np.int64],
    point: NDArray[np.float64],
) -> None:
    """Voxel of each point, and where in it.

    Parameters
    ----------
    place : three (n,) integer arrays
        Points [steps].
    edge : int
        Edge of a voxel [steps].
    corner : (3,) int64
        Voxel that others are counted from.
    voxel : (n, 3) int64
        Filled.
    point : (n, 3) float64
        Filled with the place relative to the voxel's centre [m].
    """
    for axis, at in enumerate(place):
        inside = at.astype(np.int64, copy=False) // edge
        voxel[:, axis] = inside - corner[axis]
        point[:, axis] = (2 * (at - inside * edge) - edge) * half_step_m


def meet_planes(
    start: NDArray[np.int64],
    z: NDArray[np.int32],
    step_m: float,
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where beams meet the plane at the median height of their block's returns.

    Parameters
    ----------
    start : (m + 1,) int64
        First row of each block, none empty, and the number of rows.
    z : (n,) int32
        Heights of the returns [steps].
    origin, direction : (n, 3) float64
        Beams; none is horizontal.

    Returns
    -------
    place : (n, 2) float64
        Easting and northing relative to the block's anchor [m].
    anchor : (m, 3) float64
        Place of the block's first beam in whole metres, and of the plane [m].
    """
    size, anchor = np.diff(start), np.empty((len(start) - 1, 3))
    anchor[:, 2] = [np.median(z[low:high] * step_m) for low, high in pairwise(start)]
    away = (np.repeat(anchor[:, 2], size) - origin[:, 2]) / direction[:, 2]
    place = np.empty((len(z), 2))
    for axis in range(2):
        met = origin[:, axis] + away * direction[:, axis]
        anchor[:, axis] = np.rint(met[start[:-1]])
        np.subtract(met, np.repeat(anchor[:, axis], size), out=place[:, axis])
    return place, anchor
