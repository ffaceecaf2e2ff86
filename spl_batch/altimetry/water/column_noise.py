"""Noise below a water surface: it never grows with depth.

What lies below a bright surface is light that came back late (scattering in the water,
afterpulses of the detector): there is the less of it the deeper one looks. The density that
counts fit best under that condition is the isotonic regression, found by pooling adjacent
violators (M. Ayer et al., Ann. Math. Stat. 26, 1955); for Poisson counts over areas it is the
maximum-likelihood estimate too (R. Barlow et al., Statistical Inference under Order Restrictions,
1972).
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def falling_density(
    count: NDArray[np.float64], area: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Densities that do not grow along a row and fit the counts best.

    Parameters
    ----------
    count : (r, d) float64
        Photons of each depth [count].
    area : (r, d) float64
        Where they were counted [m2].
    out : (r, d) float64
        Receives count over area, pooled where it would grow [1/m2]; 0 without any area.
    """
    rows, depths = count.shape
    pooled, over, first = np.empty(depths), np.empty(depths), np.empty(depths, np.int64)
    for r in range(rows):
        blocks = 0
        for d in range(depths):
            pooled[blocks], over[blocks], first[blocks] = count[r, d], area[r, d], d
            blocks += 1
            # A depth without any area joins the one above it.
            while blocks > 1 and (
                over[blocks - 1] <= 0.0
                or pooled[blocks - 1] * over[blocks - 2] >= pooled[blocks - 2] * over[blocks - 1]
            ):
                pooled[blocks - 2] += pooled[blocks - 1]
                over[blocks - 2] += over[blocks - 1]
                blocks -= 1
        for b in range(blocks):
            stop = first[b + 1] if b + 1 < blocks else depths
            for d in range(first[b], stop):
                out[r, d] = pooled[b] / over[b] if over[b] > 0.0 else 0.0
