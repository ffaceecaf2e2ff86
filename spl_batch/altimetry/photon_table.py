"""Columns of a photon table."""

from collections.abc import Mapping
from typing import Final

import numpy as np

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
