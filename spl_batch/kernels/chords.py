"""Lengths of beamlets inside the spheres of a voxel lattice [W17 Eq. 5.2, 6.1; W18 Eq. 1].

Every beamlet is reckoned relative to the voxel that holds its own return, so its chords
come out the same to the last bit whatever else is deposited along with it.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(nogil=True, cache=True)
def chord_length(
    px: float, py: float, pz: float,
    ux: float, uy: float, uz: float,
    near: float, far: float, radius: float,
) -> float:  # fmt: skip
    """Length of a piece of a line inside a sphere around zero.

    Parameters
    ----------
    px, py, pz : float
        Point of the line, relative to the sphere's centre.
    ux, uy, uz : float
        Unit vector along the line.
    near, far : float
        Ends of the piece, along the line from the point.
    radius : float
        Radius of the sphere.
    """
    middle = -(px * ux + py * uy + pz * uz)
    square = radius * radius - (px * px + py * py + pz * pz - middle * middle)
    if square <= 0.0:
        return 0.0
    half = math.sqrt(square)
    return max(0.0, min(middle + half, far) - max(middle - half, near))


@njit(nogil=True, cache=True)
def deposit_beamlet(
    voxel: NDArray[np.int64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: float,
    far: float,
    weight: float,
    edge: float,
    radius: float,
    ordinal: int,
    amount: NDArray[np.int64],
    shots: NDArray[np.int64],
    beamlets: NDArray[np.int64],
    last_shot: NDArray[np.int64],
) -> None:
    """Add one beamlet's chords to every sphere that it crosses.

    Only spheres near the line are looked at: layer by layer along the axis that the line
    follows most, those whose centre lies within ``radius / |u|`` of the line's place there.

    Parameters
    ----------
    voxel : (3,) int64
        Voxel of the return, relative to the corner of ``amount``.
    point : (3,) float64
        The return, relative to that voxel's centre [m].
    direction : (3,) float64
        Unit vector along the beam.
    near, far : float
        Ends of the gate along the beam, from the return [m].
    weight : float
        Fixed-point amount per metre of chord.
    edge, radius : float
        Edge of a voxel and radius of its sphere [m].
    ordinal : int
        Number of the beamlet's shot.
    amount : (nx, ny, nz) int64
        Added to.
    shots, beamlets, last_shot : (nx, ny, nz) int64, or empty
        Added to where not empty: shots and beamlets that touch each sphere.
    """
    axis = 2
    for k in range(2):
        if abs(direction[k]) > abs(direction[axis]):
            axis = k
    p, q = (axis + 1) % 3, (axis + 2) % 3
    along = direction[axis]
    reach = radius / abs(along)
    ends = (point[axis] + near * along, point[axis] + far * along)
    index = np.empty(3, dtype=np.int64)
    for layer in range(
        math.ceil((min(ends) - radius) / edge), math.floor((max(ends) + radius) / edge) + 1
    ):
        t = (layer * edge - point[axis]) / along
        at_p, at_q = point[p] + t * direction[p], point[q] + t * direction[q]
        index[axis] = voxel[axis] + layer
        for i in range(math.ceil((at_p - reach) / edge), math.floor((at_p + reach) / edge) + 1):
            index[p] = voxel[p] + i
            for j in range(math.ceil((at_q - reach) / edge), math.floor((at_q + reach) / edge) + 1):
                index[q] = voxel[q] + j
                chord = chord_length(
                    at_p - i * edge, at_q - j * edge, 0.0,
                    direction[p], direction[q], along, near - t, far - t, radius,
                )  # fmt: skip
                if chord > 0.0:
                    x, y, z = index[0], index[1], index[2]
                    amount[x, y, z] += int(np.rint(weight * chord))
                    if beamlets.size:
                        beamlets[x, y, z] += 1
                        if last_shot[x, y, z] != ordinal:
                            last_shot[x, y, z] = ordinal
                            shots[x, y, z] += 1


@njit(nogil=True, cache=True)
def deposit_beamlets(
    voxel: NDArray[np.int64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    weight: NDArray[np.float64],
    edge: float,
    radius: float,
    ordinal: NDArray[np.int64],
    amount: NDArray[np.int64],
    shots: NDArray[np.int64],
    beamlets: NDArray[np.int64],
) -> None:
    """Add every beamlet; rows as the arguments of :func:`deposit_beamlet`."""
    last_shot = np.full(beamlets.shape, -1, dtype=np.int64)
    for i in range(len(weight)):
        deposit_beamlet(
            voxel[i], point[i], direction[i], near[i], far[i], weight[i], edge, radius,
            ordinal[i], amount, shots, beamlets, last_shot,
        )  # fmt: skip
