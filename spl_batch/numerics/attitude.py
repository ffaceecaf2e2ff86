"""Attitude of an aircraft as rotation matrices."""

import numpy as np
from numpy.typing import NDArray


def rotations(
    heading: NDArray[np.float64], roll: NDArray[np.float64], pitch: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Body frame to east, north, up.

    Parameters
    ----------
    heading, roll, pitch : (n,) float64
        Clockwise from north, starboard wing down, nose up [rad].

    Returns
    -------
    (n, 3, 3) float64
        Matrices that take a column vector of the body frame to the local frame [W17 Eq. 2.8].
    """
    ch, sh = np.cos(heading), np.sin(heading)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    zero, one = np.zeros_like(ch), np.ones_like(ch)

    def stack(*rows: tuple[NDArray[np.float64], ...]) -> NDArray[np.float64]:
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    yaw = stack((ch, sh, zero), (-sh, ch, zero), (zero, zero, one))
    nose = stack((one, zero, zero), (zero, cp, -sp), (zero, sp, cp))
    wing = stack((cr, zero, sr), (zero, one, zero), (-sr, zero, cr))
    product: NDArray[np.float64] = yaw @ nose @ wing
    return product
