"""Detections and looks on a voxel raster, with trilinear weights [M20 4.1].

The lattice is absolute: voxel i of an axis covers ``[i, i + 1)`` edges from coordinate zero, its
value is that of its centre. A position is rounded to :data:`STEPS` parts of an edge, so its weights
in the eight voxels around are whole numbers that add up to :data:`UNIT`: sums are exact, whatever a
raster is cut from. Samples of looks are computed from the sensor's position in the survey's
coordinates, and round alike in each raster.

A look is sampled at whole multiples plus a half of a voxel's edge from the sensor; a sample is one
interrogation. After its detection a detector is blind (blocking loss): its samples end at the one
that holds the detection.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from spl_batch.numerics.compiled import njit

STEPS: Final = 32
"""Parts of a voxel's edge that positions are rounded to [count]."""

UNIT: Final = STEPS**3
"""What one detection, or one interrogation, adds to a raster in all."""

_HALF: Final = 0.5 * (STEPS - 1)
"""A voxel's centre lies half an edge from its corner, and positions are rounded [steps]."""

_SHIFT: Final = 5
_MASK: Final = STEPS - 1


@njit()
def deposit(u: int, v: int, w: int, corner: NDArray[np.int64], raster: NDArray[np.int64]) -> None:
    """Add one point, :data:`UNIT` in all, to a raster from a voxel of the absolute lattice on.

    ``u``, ``v``, ``w``: steps from that lattice's first voxel's centre [count]. What lies at a
    raster's rim is left out: its outermost voxels have not all that is theirs.
    """
    i, j, k = (u >> _SHIFT) - corner[0], (v >> _SHIFT) - corner[1], (w >> _SHIFT) - corner[2]
    nx, ny, nz = raster.shape
    if i < 0 or j < 0 or k < 0 or i + 1 >= nx or j + 1 >= ny or k + 1 >= nz:
        return
    fx, fy, fz = u & _MASK, v & _MASK, w & _MASK
    a, b = (STEPS - fx) * (STEPS - fy), (STEPS - fx) * fy
    c, d = fx * (STEPS - fy), fx * fy
    raster[i, j, k] += a * (STEPS - fz)
    raster[i, j, k + 1] += a * fz
    raster[i, j + 1, k] += b * (STEPS - fz)
    raster[i, j + 1, k + 1] += b * fz
    raster[i + 1, j, k] += c * (STEPS - fz)
    raster[i + 1, j, k + 1] += c * fz
    raster[i + 1, j + 1, k] += d * (STEPS - fz)
    raster[i + 1, j + 1, k + 1] += d * fz


@njit()
def deposit_all(
    xyz: NDArray[np.int64], edge: int, corner: NDArray[np.int64], raster: NDArray[np.int64]
) -> None:
    """Add points, (n, 3) [quanta], to a raster of voxels of this edge [quanta], exactly.

    A point counts in the step that it is rounded to, ``floor(STEPS x / edge - (STEPS - 1) / 2)``.
    """
    for row in range(len(xyz)):
        u = (2 * STEPS * xyz[row, 0] - (STEPS - 1) * edge) // (2 * edge)
        v = (2 * STEPS * xyz[row, 1] - (STEPS - 1) * edge) // (2 * edge)
        w = (2 * STEPS * xyz[row, 2] - (STEPS - 1) * edge) // (2 * edge)
        deposit(u, v, w, corner, raster)


@njit()
def look_direction(
    turn: NDArray[np.float64], across: float, along: float, out: NDArray[np.float64]
) -> None:
    """Unit vector of a line of sight: east, north, up into ``out``.

    Parameters
    ----------
    turn : (3, 3) float64
        Starboard, nose, up of the array as columns: east, north, up of each.
    across, along : float
        Tangents of the detector's angles off the array's axis, to starboard and to the nose.
    out : (3,) float64
        Filled.
    """
    scale = 1.0 / math.sqrt(1.0 + across * across + along * along)
    for axis in range(3):
        out[axis] = (turn[axis, 0] * across + turn[axis, 1] * along - turn[axis, 2]) * scale


@njit()
def between(
    origin: NDArray[np.float64], way: NDArray[np.float64],
    low: NDArray[np.float64], high: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Ranges between which a line lies in a box; the first is larger where it misses."""
    near, far = -1e30, 1e30
    for axis in range(3):
        if abs(way[axis]) < 1e-15:
            if origin[axis] < low[axis] or origin[axis] > high[axis]:
                return 1.0, 0.0
            continue
        a = (low[axis] - origin[axis]) / way[axis]
        b = (high[axis] - origin[axis]) / way[axis]
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far


@njit()
def interrogate(
    origin: NDArray[np.float64], turn: NDArray[np.float64], seen: NDArray[np.float32],
    tangent: float, gate: NDArray[np.float64], edge: float,
    corner: NDArray[np.int64], raster: NDArray[np.int64],
) -> None:  # fmt: skip
    """Add the interrogations of all looks of some frames, a sample for each voxel's edge [m].

    ``origin``, ``turn``: (f, 3), positions of the sensor [m]; (f, 3, 3), as :func:`look_direction`
    takes them. ``seen``: (f, rows, columns), slant range of each detector's detection, infinite
    where it made none [m]. ``tangent``: of a detector's field of view. ``gate``: slant ranges
    between which detectors are armed [m].
    """
    _, rows, columns = seen.shape
    scale = STEPS / edge
    low, high, way = np.empty(3), np.empty(3), np.empty(3)
    for axis in range(3):
        low[axis] = (corner[axis] - 1) * edge
        high[axis] = (corner[axis] + raster.shape[axis] + 1) * edge
    for frame in range(len(origin)):
        for row in range(rows):
            across = (row - 0.5 * (rows - 1)) * tangent
            for column in range(columns):
                along = (column - 0.5 * (columns - 1)) * tangent
                look_direction(turn[frame], across, along, way)
                near, far = between(origin[frame], way, low, high)
                far = min(far, seen[frame, row, column] + edge)
                if near > far:
                    continue
                first = max(math.floor(near / edge), math.ceil(gate[0] / edge - 0.5))
                last = min(math.floor(far / edge) + 1, math.ceil(gate[1] / edge - 0.5) - 1)
                stop = float(seen[frame, row, column])
                for k in range(int(first), int(last) + 1):
                    if k * edge > stop:
                        break
                    s = (k + 0.5) * edge
                    u = math.floor((origin[frame, 0] + s * way[0]) * scale - _HALF)
                    v = math.floor((origin[frame, 1] + s * way[1]) * scale - _HALF)
                    w = math.floor((origin[frame, 2] + s * way[2]) * scale - _HALF)
                    deposit(u, v, w, corner, raster)


def box_sum(raster: NDArray[np.int64], half: int) -> NDArray[np.int64]:
    """Sum over the cube of ``2 half + 1`` voxels around each; beside the raster is nothing."""
    for axis in range(3):
        # Sums in float64 are exact below 2**53, far above those of any raster.
        raster = convolve1d(raster, np.ones(2 * half + 1), axis, mode="constant")
    return raster
