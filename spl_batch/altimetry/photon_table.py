"""Columns of a photon table, and photons as their files have them."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

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
NOT_ASSESSED: Final = 255
"""Values of a photon's label; 0 is noise."""


class Slice(NamedTuple):
    """Consecutive photons as their file has them."""

    #: (n,): along-track distance and height [m]; not finite where unknown.
    along_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    #: (n,): where [deg]; NaN where unknown.
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]


def joined(
    parts: Sequence[Mapping[str, NDArray[Any]]], dtypes: Mapping[str, type]
) -> dict[str, NDArray[Any]]:
    """Rows of tables with some columns in one, in the order given."""
    return {
        name: np.concatenate([np.empty(0, dtype), *(part[name] for part in parts)]).astype(dtype)
        for name, dtype in dtypes.items()
    }
