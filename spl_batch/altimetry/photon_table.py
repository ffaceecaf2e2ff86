"""Columns of a photon table, and the values that travel between the altimetry stages."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

PHOTONS: Final[Mapping[str, type]] = {"row": np.int64, "along": np.int64, "height": np.int32}
"""Position in the file; along-track distance and height [quanta of 1 mm]."""

LABELS: Final[Mapping[str, type]] = {
    **PHOTONS,
    "score": np.float32,
    "signal": np.uint8,
    "ground": np.uint8,
    "level": np.int32,
    "baseline": np.uint8,
}
"""Score: mean ln P(noise); signal; photons that the ground is sought among; water surface at the
photon [quanta], the least int32 for none; signal by mDBSCAN."""

SIGNAL: Final = 1
NOISE: Final = 0
NOT_ASSESSED: Final = 255
"""Values of a photon's label."""


@dataclass(frozen=True, slots=True)
class Background:
    """Noise rate that a product states."""

    along_m: NDArray[np.float64]  #: (m,): where, increasing [m].
    #: (m,): noise photons per metre of track and metre of height [1/m2].
    per_m2: NDArray[np.float64]
