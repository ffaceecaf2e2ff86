"""Errors counted by size: what any number of places find, in little memory.

Medians cannot be merged, counts can: a survey may have more reference points than memory holds
errors.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from spl_batch.engine.report.parts import Count, Number, Part, Statistics
from spl_batch.numerics.error_statistics import quantile, statistics

STEPS_PER_M: Final = 10_000
"""Errors are counted by tenths of a millimetre [1/m]."""


@dataclass(frozen=True, slots=True)
class Tally:
    """How often errors of each size occur."""

    #: (n,): sizes that occur, increasing [0.1 mm].
    steps: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    #: (n,): how often.
    counts: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))

    @classmethod
    def of(cls, errors_m: NDArray[np.floating[Any]]) -> "Tally":
        """Count errors, (n,) float [m]; those that are not finite are left out."""
        finite = np.asarray(errors_m, np.float64)
        finite = finite[np.isfinite(finite)]
        steps, counts = np.unique(
            np.rint(finite * STEPS_PER_M).astype(np.int64), return_counts=True
        )
        return cls(steps, counts.astype(np.int64))

    @property
    def errors_m(self) -> NDArray[np.float64]:
        """Sizes that occur, (n,) float64 [m]."""
        return self.steps / STEPS_PER_M

    @property
    def n(self) -> int:
        """Errors counted [count]."""
        return int(self.counts.sum())

    def sample_m(self, most: int) -> NDArray[np.float32]:
        """Every so many-th error by size, no more than ``most``: (n,) float32 [m]."""
        ranks = np.arange(0, self.n, max(1, -(-self.n // most)))
        place = np.searchsorted(np.cumsum(self.counts), ranks, side="right")
        return self.errors_m[place].astype(np.float32)


Tallies = dict[str, Tally]
"""Errors by class of surface; ``all`` holds every one."""


def tallies(differences: Mapping[str, NDArray[np.floating[Any]]]) -> Tallies:
    """Count the differences of each class of surface [m]."""
    return {name: Tally.of(values) for name, values in differences.items()}


def add_up(parts: Iterable[Mapping[str, Tally]]) -> Tallies:
    """Errors of several places together; a class that one place lacks is empty there."""
    waiting: dict[str, list[Tally]] = {}
    more = dict[str, int]()
    for part in parts:
        for name, found in part.items():
            listed = waiting.setdefault(name, [found])
            if listed[0] is found or not len(found.steps):
                continue
            listed.append(found)
            more[name] = more.get(name, 0) + len(found.steps)
            # Added up where those that wait hold as much: in memory are twice as many at most.
            if more[name] >= len(listed[0].steps):
                listed[:], more[name] = [_together(listed)], 0
    return {name: _together(listed) for name, listed in waiting.items()}


def _together(listed: Sequence[Tally]) -> Tally:
    steps, place = np.unique(np.concatenate([t.steps for t in listed]), return_inverse=True)
    counts = np.zeros(len(steps), np.int64)
    np.add.at(counts, place, np.concatenate([t.counts for t in listed]))
    return Tally(steps, counts)


class Accuracy(Part):
    """Comparison with reference linear-mode lidar, by class of surface; ``all`` is overall."""

    dtm: dict[str, Statistics] = Field({}, description="Terrain model minus reference ground.")
    dsm: dict[str, Statistics] = Field({}, description="Surface model minus reference surface.")
    returns: dict[str, Statistics] = Field(
        {},
        description="Returns that the filter keeps minus the reference's nearest ground or roof, "
        "within 0.5 m; one in eight.",
    )
    reference_points: Count | None = Field(None, description="Reference points read [count].")
    bias_m: Number = Field(None, description="Median difference between the sensors [m].")
    bias_removed: bool = Field(
        False, description="Whether the bias was subtracted before the statistics."
    )
    own_points: bool = Field(False, description="Whether the reference is the survey itself.")


def accuracy_report(
    dtm: Mapping[str, Tally],
    dsm: Mapping[str, Tally],
    returns: Mapping[str, Tally] | None = None,
    *,
    remove_bias: bool = False,
    **known: Any,
) -> Accuracy:
    """Accuracy of all places together; ``known``: further values of :class:`Accuracy`.

    ``all`` is always among the classes of DTM and DSM. The bias is the median of the DTM on open
    ground, else of all of it, else of the DSM on ground.
    """
    bias = _bias(dtm, dsm)
    removed = bias if remove_bias and bias is not None else 0.0
    counted = {
        "dtm": {"all": Tally(), **dtm},
        "dsm": {"all": Tally(), **dsm},
        "returns": {name: found for name, found in (returns or {}).items() if found.n},
    }
    found = {
        product: {
            name: Statistics(**statistics(one.errors_m - removed, one.counts))
            for name, one in by_class.items()
        }
        for product, by_class in counted.items()
    }
    return Accuracy(**found, bias_m=bias, bias_removed=bool(removed), **known)


def _bias(dtm: Mapping[str, Tally], dsm: Mapping[str, Tally]) -> float | None:
    for found in (dtm.get("open_ground"), dtm.get("all"), dsm.get("ground")):
        if found is not None and found.n:
            return quantile(found.errors_m, found.counts, 0.5)
    return None
