"""Labels of an array, the noise that was expected, and where that is from."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NOISE_AFTERPULSE, NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.errors import counted, grouped

Basis = Literal["given", "beams", "intersection", "vertical", "cloud"]

_BASES: Final[Mapping[Basis, str]] = MappingProxyType(
    {
        "given": "as given",
        "beams": "from shots and their lines of sight",
        "intersection": "from shots, with the sensor where lines of sight meet",
        "vertical": "from shots, taken as vertical",
        "cloud": "measured where the cloud is empty",
    }
)
"""Where the expected noise is from, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Labels of n points, in the caller's order.

    Parameters
    ----------
    noise_class : (n,) uint8
        0 signal, 1 background noise, 2 afterpulse, 255 not assessed: its beam is not known.
    p_value : (n,) float32
        Share of pure noise with as much evidence of being a surface; NaN where there is none.
    noise_density : (n,) float32
        Expected background noise [1/m3].
    wire : (n,) bool
        What is surely a conductor.
    afterpulse : (n,) float32
        Probability of being an afterpulse by its own shot [0..1]; 0 where beams are not known.
    range_sigma : (n,) float32
        Ranging spread of its flightline, one sigma [m]; 0 where shots do not show it.
    basis : str
        Where the expected noise is from: ``given`` by the caller; ``beams`` by the sensor's
        positions; ``intersection`` where lines of sight meet; ``vertical`` beams; ``cloud``, the
        empty space of the cloud itself, without any beams.
    warnings : tuple of str
        What the caller should know: what it is about, its place and what follows.
    """

    noise_class: NDArray[np.uint8]
    p_value: NDArray[np.float32]
    noise_density: NDArray[np.float32]
    wire: NDArray[np.bool_]
    afterpulse: NDArray[np.float32]
    range_sigma: NDArray[np.float32]
    basis: Basis
    warnings: tuple[str, ...] = ()

    @property
    def signal(self) -> NDArray[np.bool_]:
        """Which points are signal: (n,) bool, as a mask for the caller's arrays."""
        found: NDArray[np.bool_] = self.noise_class == NOISE_SIGNAL
        return found

    def __len__(self) -> int:
        return len(self.noise_class)

    def __repr__(self) -> str:
        kinds = {"signal": NOISE_SIGNAL, "background noise": NOISE_BACKGROUND}
        kinds["afterpulses"] = NOISE_AFTERPULSE
        counts = [int(np.count_nonzero(self.noise_class == value)) for value in kinds.values()]
        parts = [f"{grouped(n)} {name}" for n, name in zip(counts, kinds, strict=True)]
        if not self.range_sigma.any():  # no shots
            parts[-1] = "afterpulses not looked for without gps_time and channel"
        parts += [f"{grouped(left)} not assessed"] if (left := len(self) - sum(counts)) else []
        parts += [f"noise density {_BASES[self.basis]}"]
        whole = f"Labels({counted(len(self), 'points')}: {', '.join(parts)})"
        return "\n".join([whole, *(f"warning: {text}" for text in self.warnings)])


class ExpectedNoise(NamedTuple):
    """Noise that is expected at places.

    Parameters
    ----------
    density : (m,) float64
        Of the part of a voxel that is listened to: what a filter should test a point with [1/m3].
    mean : (m,) float64
        Of the whole voxel around the place, silence beyond the gate included [1/m3].
    basis : str
        As in :class:`Labels`.
    warnings : tuple of str
        As in :class:`Labels`.
    """

    density: NDArray[np.float64]
    mean: NDArray[np.float64]
    basis: Basis
    warnings: tuple[str, ...]
