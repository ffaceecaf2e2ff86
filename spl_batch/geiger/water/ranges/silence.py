"""Silence: whether chance explains the frames of a file in which no pixel has a hit.

Hits of a frame are Poisson with a mean L, so a frame is empty with probability exp(-L). Missing
frames are empty too and would lower L, so it is taken from the frames that have hits: their mean
number of hits is L / (1 - exp(-L)) [Johnson, Kemp, Kotz, *Univariate Discrete Distributions*,
zero-truncated Poisson]. The number of empty frames is then binomial.
"""

from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import binom

CHANCE_MIN: Final = 1e-4
"""Empty frames that chance brings less often than this are warned of: one file in ten thousand."""


def empty_share(hits: int, frames_with_hits: int) -> float:
    """Share of frames that chance leaves without a hit, 0..1.

    ``frames_with_hits``: frames with one hit at least [count].
    """
    if hits <= frames_with_hits:
        return 1.0  # never two hits in a frame: empty frames are the rule
    mean = hits / frames_with_hits
    # L < mean, and L > mean - 1, as L / (1 - exp(-L)) < 1 + L.
    rate = brentq(lambda x: x / -np.expm1(-x) - mean, max(mean - 1.0, 1e-12), mean)
    return float(np.exp(-rate))


def too_many_empty(empty: int, frames: int, hits: int) -> bool:
    """Whether more frames are empty than chance explains.

    Parameters
    ----------
    empty, frames : int
        Frames without a hit, and all frames [count].
    """
    if empty == 0:
        return False
    share = empty_share(hits, frames - empty)
    return bool(binom.sf(empty - 1, frames, share) < CHANCE_MIN)
