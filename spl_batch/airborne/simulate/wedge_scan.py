r"""Rotating-wedge scan with a square array of beamlets [W17 Eq. 2.8-2.15].

Body frame: x to starboard, y to the nose, z up. The scan angle is zero at the nose and grows
clockwise seen from above.

Deviations. Eq. 2.11 as printed turns the array by :math:`+\alpha`, Eq. 2.12 the beam by
:math:`-\alpha`; here both turn the same way, so the array keeps its attitude to the scanned circle.
The :math:`z` of the pixel vector in Eq. 2.14, not defined there, is zero. Boresight angles and
lever arm of Eq. 2.8 are zero: delivered data is calibrated.
"""

import numpy as np
from numpy.typing import NDArray


def pixel_offsets(
    columns: int, pitch_rad: float, rotation_rad: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angular places x, y of beamlets in a turned array, by channel [W17 Eq. 2.9, 2.10] [rad].

    Channel = columns * (i - 1) + j, from 1, is row i and column j.
    """
    centre = (columns + 1) / 2
    i, j = np.divmod(np.arange(columns * columns), columns)
    x = -(i + 1 - centre) * pitch_rad
    y = (j + 1 - centre) * pitch_rad
    c, s = np.cos(rotation_rad), np.sin(rotation_rad)
    return c * x - s * y, s * x + c * y


def central_vectors(angle: NDArray[np.float64], half_cone_rad: float) -> NDArray[np.float64]:
    """Unit vectors of the array's centre in the body frame [W17 Eq. 2.13]: (n, 3) float64.

    ``angle``: (n,) float64, scan angle [rad].
    """
    s = np.sin(half_cone_rad)
    z = np.full(len(angle), -np.cos(half_cone_rad))
    return np.column_stack([s * np.sin(angle), s * np.cos(angle), z])
