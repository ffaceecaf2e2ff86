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
    rows = (
        (ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr),
        (-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr),
        (-cp * sr, sp, cp * cr),
    )
    turn = np.empty((len(ch), 3, 3))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            turn[:, i, j] = entry
    return turn
