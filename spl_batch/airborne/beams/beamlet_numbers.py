"""Numbers of beamlets by their directions, shot by shot.

See :mod:`spl_batch.airborne.beams.told_apart`.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def number_beamlets(
    starts: NDArray[np.int64], direction: NDArray[np.float64], apart_rad: float,
    number: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Number the different directions of each shot from 1 on, in the order of its rows.

    Parameters
    ----------
    starts : (s + 1,) int64
        Rows where shots start, then n.
    direction : (n, 3) float64
        Unit vectors along the beams.
    apart_rad : float
        Directions that differ by less are one [rad].
    number : (n,) uint8
        Filled; a return is of the nearest direction that came before it; 255 are told apart.
    """
    seen = np.empty((255, 3))
    for shot in range(len(starts) - 1):
        count = 0
        for i in range(starts[shot], starts[shot + 1]):
            best, nearest = -1, apart_rad * apart_rad
            for k in range(count):
                off = 0.0
                for axis in range(3):
                    off += (direction[i, axis] - seen[k, axis]) ** 2
                if off < nearest:
                    best, nearest = k, off
            if best < 0 and count < 255:
                best = count
                seen[count] = direction[i]
                count += 1
            number[i] = best + 1
