r"""Range walk of a Geiger-mode pixel: how much too early the first of several photons is.

A pixel that expects n photo-electrons of an echo fires at the first of them. Their times spread by
a normal law with standard deviation s; :math:`I = 1 - e^{-n}` is the share of frames with a hit.
The hit's mean is early by :math:`s\,g(I)`,

.. math:: g = -\frac{1}{I} \int z\, n\, \varphi(z)\, e^{-n \Phi(z)}\, dz .

This follows from the Poisson law of detection alone; [G15 3.4.4] instead fits an exponential to its
measurements, and puts it down to faster avalanches.
"""

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

MOST: Final = 10.0
"""Photo-electrons up to which the law is tabulated: I = 0.99995."""

_STEP: Final = 0.02


@cache
def _table() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    expected = np.arange(0.0, MOST + _STEP / 2, _STEP)
    z = np.linspace(-9.0, 9.0, 3601)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    n = expected[1:, None]
    early = -np.trapezoid(z * n * density * np.exp(-n * ndtr(z)), z, axis=1) / -np.expm1(-n[:, 0])
    return expected, np.concatenate([[0.0], early])


def first_photon(intensity: NDArray[np.float64]) -> NDArray[np.float64]:
    """How early hits are, in standard deviations of the echo, by their share of frames: g, >= 0."""
    expected, early = _table()
    n = -np.log1p(-np.minimum(intensity, -np.expm1(-MOST)))
    walk: NDArray[np.float64] = np.interp(n, expected, early)
    return walk


def exponential(
    intensity: NDArray[np.float64], amplitude: float, exponent: float
) -> NDArray[np.float64]:
    """``A exp(B I)`` [G15 Eq. 3-5]: (...) float64, in the unit of A."""
    walk: NDArray[np.float64] = amplitude * np.exp(exponent * intensity)
    return walk
