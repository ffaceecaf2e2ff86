"""The line noise model of one flightline as a value, and its way to disk and back."""

from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import interval_rows
from spl_batch.airborne.noise.gate import Basis, Kind
from spl_batch.errors import Remark


@dataclass(frozen=True, slots=True)
class LineModel:
    """Noise and gate of each interval of a flightline.

    Parameters
    ----------
    interval : (m,) int64
        Interval numbers, ascending.
    rate : (m,) float64
        Noise per metre of beamlet, mean over the channels [1/m].
    first, last : (m,) int64
        First and last shot that was fired, within the interval.
    near, far : (m,) float64
        Gate: slant ranges, or upper and lower height [m].
    gain : (256,) float64
        Rate of each channel over the mean; 0 for a dead one.
    seen_fraction : (m,) float64
        Beamlets with a return over beamlets fired.
    kind : str
        "range" or "height": what ``near`` and ``far`` are.
    gate_m : float
        Median slant length of the gate [m].
    mean_rate : float
        Mean of ``rate`` over the beamlets fired [1/m].
    beamlets : int
        Beamlets per shot.
    interval_shots : int
        Shots per interval.
    seen_shots : int
        Shots over which beamlets that are seen stand in for silent ones.
    gate_basis : str
        "stated", "estimated" or "assumed": where ``gate_m`` comes from.
    warnings : tuple of Remark
        What the report has to say; the way to disk keeps their texts only.
    """

    interval: NDArray[np.int64]
    rate: NDArray[np.float64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    gain: NDArray[np.float64]
    seen_fraction: NDArray[np.float64]
    kind: Kind
    gate_m: float
    mean_rate: float
    beamlets: int
    interval_shots: int
    seen_shots: int
    gate_basis: Basis
    warnings: tuple[Remark, ...]

    def row(self, shot: NDArray[np.int64]) -> NDArray[np.int64]:
        """Row of each shot's interval, or of the nearest one before it: (n,) int64; 0 for none."""
        row = np.zeros(len(shot), np.int64)
        if len(self.interval):
            interval_rows(shot, self.interval_shots, self.interval, row)
        return row

    def at(
        self, row: NDArray[np.int64], values: NDArray[np.float64], missing: float
    ) -> NDArray[np.float64]:
        """Value by :meth:`row`; ``missing`` where the model is empty: (n,) float64."""
        if len(values) == 0:
            return np.full(len(row), missing)
        taken: NDArray[np.float64] = values.take(row)
        return taken

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays without Python objects, as npz files hold them."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)} | {
            "warnings": np.array([one.text for one in self.warnings], dtype=np.str_)
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "LineModel":
        """Model that :meth:`to_arrays` gave."""
        content: dict[str, Any] = {
            f.name: arrays[f.name] if arrays[f.name].ndim else arrays[f.name].item()
            for f in fields(cls)
        }
        content["warnings"] = tuple(Remark(str(text)) for text in np.atleast_1d(arrays["warnings"]))
        content["kind"] = cast("Kind", content["kind"])
        content["gate_basis"] = cast("Basis", content["gate_basis"])
        return cls(**content)
