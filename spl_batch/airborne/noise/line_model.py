"""Line noise model of one flightline as a value, and its way to disk and back."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import interval_rows
from spl_batch.airborne.noise.gate import Basis, Kind
from spl_batch.engine.findings import Finding


@dataclass(frozen=True, slots=True)
class LineModel:
    """Noise and gate of each interval of a flightline."""

    interval: NDArray[np.int64]  #: (m,): interval numbers, ascending.
    rate: NDArray[np.float64]  #: (m,): noise per metre of beamlet, mean over the channels [1/m].
    #: (m,): first and last shot that was fired, within the interval.
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    #: (m,): gate: slant ranges, or upper and lower height [m].
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    gain: NDArray[np.float64]  #: (256,): rate of each channel over the mean; 0 for a dead one.
    signal: NDArray[np.float64]  #: (g,): height of the signal in groups of shots [m].
    first_group: NDArray[np.int64]  #: (m,): first group of each interval.
    groups: NDArray[np.int64]  #: (m,): groups of each interval.
    cell: NDArray[np.int64]  #: (c,): cells of the ground that were looked at, ascending.
    ground: NDArray[np.float64]  #: (c,): rate over each of them, over the rate of the interval.
    seen_fraction: NDArray[np.float64]  #: (m,): beamlets with a return over beamlets fired.
    kind: Kind  #: "range" or "height": what ``near`` and ``far`` are.
    gate_m: float  #: Median slant length of the gate [m].
    mean_rate: float  #: Mean of ``rate`` over the beamlets fired [1/m].
    beamlets: int
    interval_shots: int
    seen_shots: int  #: Shots over which beamlets that are seen stand in for silent ones.
    gate_basis: Basis  #: "stated", "estimated" or "assumed": where ``gate_m`` comes from.
    #: What the report warns of; a model from disk has none, its task's receipt has them.
    findings: tuple[Finding, ...] = ()

    def row(self, shot: NDArray[np.int64]) -> NDArray[np.int64]:
        """Row of each shot's interval, or of the nearest one before it: (n,) int64; 0 for none."""
        return interval_rows(shot, self.interval_shots, self.interval)

    def signal_at(self, shot: NDArray[np.int64]) -> NDArray[np.float64]:
        """Height of the signal of each shot, of a model that is not empty: (n,) float64 [m]."""
        row = self.row(shot)
        group = shot % self.interval_shots * self.groups.take(row) // self.interval_shots
        height: NDArray[np.float64] = self.signal.take(self.first_group.take(row) + group)
        return height

    def beyond_gate(
        self,
        shot: NDArray[np.int64],
        range_m: NDArray[np.float64],
        height_m: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Which returns lie farther outside the gate that is stated than this is long: (n,)."""
        if self.gate_basis != "stated" or not len(self.interval):
            return np.zeros(len(shot), np.bool_)
        row = self.row(shot)
        ends = np.stack([self.near[row], self.far[row]])
        at = range_m if self.kind == "range" else height_m
        found: NDArray[np.bool_] = (ends.min(axis=0) - at > self.gate_m) | (
            at - ends.max(axis=0) > self.gate_m
        )
        return found

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays without Python objects, as npz files hold them."""
        kept = (f.name for f in fields(self) if f.name != "findings")
        return {name: np.asarray(getattr(self, name)) for name in kept}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "LineModel":
        """Model that :meth:`to_arrays` gave."""
        content: dict[str, Any] = {
            f.name: arrays[f.name] if arrays[f.name].ndim else arrays[f.name].item()
            for f in fields(cls)
            if f.name != "findings"
        }
        return cls(**content)
