"""A test of single detections: noise, or one of several from a surface.

In the manner of Maximum A Posteriori Coincidence Processing, which [M20 ch. 2] describes without
formulas, after Stevens, Lopez & Burton, "Quantitative data quality metrics for 3D laser radar
systems", Proc. SPIE 8037, 2011. This is the plain Bayesian test of that description: a baseline,
not their algorithm.

In a cube of w voxels' edge around a detection there are k others among n interrogations. Noise
alone gives a Poisson number of mean ``a = n q``, q being the noise detections per voxel's edge of a
look. A surface adds ``b = p n / w``, p being its detections per look: each look crosses w layers.
With prior share s of neighbourhoods that hold a surface the detection stays when

    log(s / (1 - s)) + k log((a + b) / a) - b > 0.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.geiger.coincidence.surface.voxel_raster import UNIT
from spl_batch.numerics.compiled import njit


@njit()
def log_odds(
    detections: NDArray[np.int64], looks: NDArray[np.int64], window: int,
    noise_share: float, surface_share: float, prior: float, out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Log of the odds that each detection is of a surface.

    Parameters
    ----------
    detections, looks : (n,) int64
        Sums over each detection's neighbourhood, itself included,
        :data:`~.raster.UNIT` for one.
    window : int
        Edge of the neighbourhood [voxel edges].
    noise_share, surface_share : float
        Noise detections per interrogation; detections per look from the faintest surface.
    prior : float
        Share of neighbourhoods that hold a surface.
    out : (n,) float64
        Receives the log odds; without a look, those of the prior.
    """
    # n interrogations of a surface's neighbourhood are n / w looks: the ratio of the two means
    # depends on neither.
    gain = math.log1p(surface_share / (window * noise_share))
    start = math.log(prior / (1.0 - prior))
    for row in range(len(out)):
        others = max(detections[row] - UNIT, 0) / UNIT
        out[row] = start + others * gain - surface_share * looks[row] / (window * UNIT)
