"""Heights that are added to flightlines so that those that overlap fit together.

Each pair has a height of its second flightline above the first. The shifts make all pairs fit
best, by least squares; pairs that do not fit the others count less (Huber's weights). Overlaps do
not show where all flightlines lie together: of those that are connected one keeps its heights, that
to which the others, weighted by their returns, come by the shortest way. So where most fit, they
stay, and one that is off does not draw them along, as it would with a mean of zero.

A flightline also stays where nothing compares it with another, where its shift is less than
:data:`SURE` of its standard deviations, and where it is more than :data:`MOST_M`, which is a fault
of another kind; the others are then solved without it.
"""

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.sparse import csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from spl_batch.airborne.lines.pair_table import HUBER, OWN_M, ROUNDS, StripPair
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.report.parts import STRICT, Measured, Number

SURE: Final = 2.0
"""Standard deviations of a shift from which on it is applied."""

MOST_M: Final = 2.0
"""Longest shift that is applied [m]."""

KEPT: Final = "kept"
ALONE: Final = "not compared"
UNSURE: Final = "not sure"
TOO_FAR: Final = "too far"
"""Why a flightline stays."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class AlignedLine:
    """What was added to the heights of a flightline, and how sure it is."""

    name: str = Field(description="The flightline.")
    up_m: Measured = Field(description="Added to its heights [m].")
    found_m: Number = Field(description="The shift as found; null without a pair [m].")
    sd_m: Number = Field(default=None, description="Standard deviation of it [m].")
    stays: Literal["", "kept", "not compared", "not sure", "too far"] = Field(
        description="Why nothing was added: the others are shifted against it; too few planar "
        "patches with others; less than two standard deviations; more than 2 m. Empty where "
        "something was."
    )


def align_lines(
    names: Sequence[str], pairs: Sequence[StripPair], returns: Mapping[str, float]
) -> list[AlignedLine]:
    """Shifts of flightlines, by name, from :func:`~spl_batch.airborne.lines.pair_table.pair_table`.

    ``names``: all that were flown; ``returns``: signal returns of each, their weights [count].
    """
    names = sorted(names)
    weight = np.array([max(returns.get(name, 0), 1) for name in names], np.float64)
    far: dict[str, float] = {}
    while True:
        left = [one for one in pairs if one.first not in far and one.second not in far]
        up, sd = _solve(names, left, weight)
        length = np.abs(np.nan_to_num(up))
        if length.max(initial=0.0) <= MOST_M:
            break
        worst = int(length.argmax())
        far[names[worst]] = float(up[worst])
    return [
        AlignedLine(name=name, up_m=0.0, found_m=far[name], stays=TOO_FAR)
        if name in far
        else _decided(name, *found)
        for name, *found in zip(names, up.tolist(), sd.tolist(), strict=True)
    ]


def _decided(name: str, up_m: float, sd_m: float) -> AlignedLine:
    """What is applied to a flightline."""
    if np.isnan(up_m):
        return AlignedLine(name=name, up_m=0.0, found_m=None, stays=ALONE)
    shift = round(up_m * QUANTA_PER_M) / QUANTA_PER_M if abs(up_m) >= SURE * sd_m else 0.0
    return AlignedLine(
        name=name,
        up_m=shift,
        found_m=up_m,
        sd_m=sd_m,
        stays="" if shift else UNSURE if sd_m else KEPT,
    )


def _solve(
    names: Sequence[str], pairs: Sequence[StripPair], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shift of each flightline and its standard deviation [m]; NaN without a pair."""
    number = {name: k for k, name in enumerate(names)}
    ends = np.array([(number[p.first], number[p.second]) for p in pairs], np.intp).reshape(-1, 2)
    away = np.array([pair.up_m for pair in pairs], np.float64)
    sd = np.array([np.hypot(pair.up_sd_m, OWN_M) for pair in pairs], np.float64)
    joined = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (len(names), len(names)))
    _, group = connected_components(joined, directed=False)
    up, up_sd = np.full((2, len(names)), np.nan)
    for one in np.unique(group[ends[:, 0]]):
        lines, mine = np.flatnonzero(group == one), group[ends[:, 0]] == one
        local = np.searchsorted(lines, ends[mine])
        up[lines], up_sd[lines] = _solve_group(local, away[mine], sd[mine], weight[lines])
    return up, up_sd


def _solve_group(
    ends: NDArray[np.intp],
    away: NDArray[np.float64],
    sd: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shifts of flightlines that are connected, and their standard deviations [m]."""
    count, freedom = len(weight), len(away) - len(weight) + 1
    signs = np.tile([-1.0, 1.0], len(ends))
    design = csr_array((signs, (np.arange(len(ends)).repeat(2), ends.ravel())), (len(ends), count))
    factor, shift = np.ones(len(ends)), np.zeros(count)
    for _ in range(ROUNDS if freedom else 1):
        precision = factor / sd**2
        towards = design.T @ (precision * -away)
        shift[1:] = splu(_normal(design, precision, 0)).solve(towards[1:])
        ratio = (away + design @ shift) / sd
        factor = 1 / np.maximum(np.abs(ratio) / HUBER, 1.0)
    keeper = int(np.argmin([weight @ np.abs(shift - one) for one in shift]))
    # Where pairs contradict each other, none is as sure as it seems.
    misfit = float(factor @ ratio**2) / freedom if freedom else 1.0
    normal = _normal(design, factor / sd**2 / max(misfit, 1.0), keeper)
    variance = splu(normal).solve(np.eye(count - 1)).diagonal()
    return shift - shift[keeper], np.sqrt(np.insert(np.maximum(variance, 0.0), keeper, 0.0))


def _normal(design: csr_array, precision: NDArray[np.float64], keeper: int) -> csc_array:
    """Normal matrix of the shifts of all flightlines but one."""
    free = design[:, np.flatnonzero(np.arange(design.shape[1]) != keeper)]
    return csc_array(free.T @ (free * precision[:, None]))
