"""Range gate along the beams of a flightline.

Source: [W17] 5.2.1 ("data from all the beamlets are truncated with the same range gate") does not
cover how to find it. Here its ends are the extreme returns of absolute windows of intervals, moved
out by one mean spacing of the noise: the expected shortfall of a uniform sample. An end that one or
two returns alone claim, many spacings beyond all others, is none. A gate may be
constant in slant range, follow the surface, or be cut at a height: the shortest one that explains
the same returns is taken.
"""

import math
from collections.abc import Iterator
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.line_statistics import (
    BUFFER_LADDER,
    HALF,
    LONE_MOST,
    LONE_SPACINGS,
    SUPPORT,
)
from spl_batch.airborne.noise.noise_intervals import SUMMARY
from spl_batch.engine.findings import Finding

WINDOW_INTERVALS: Final = 64
"""Intervals whose extremes are read together [count]. Half and twice move 9 + 0 and 10 + 0
labels."""

TOLERANCE: Final = 0.1
"""Part of a gate's stated length by which the returns may fill more or less."""

GATE_MIN_M: Final = 60.0
"""Least length of a gate that is not stated: a shorter one is a scene without noise [m]."""

GATE_ASSUMED_M: Final = 300.0
"""Gate where neither the workflow states nor the points show one [m]."""

LONE_GAPS: Final = (3, 8)
"""Gaps between the extremes that follow which show their spacing, at least and at most [count].
Without this rule returns 1000 m below a stated gate, one of forty, lengthen it in thin noise."""

Kind = Literal["range", "height"]
Basis = Literal["stated", "estimated", "assumed"]


class Gate(NamedTuple):
    """Gate of each interval."""

    #: What ``near`` and ``far`` are: "range", slant ranges; "height", upper and lower height.
    kind: Kind
    #: near, far (m,): edges [m].
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    length_m: float
    warnings: tuple[Finding, ...]  #: Findings for the report.
    #: Source of its length: ``stated``, ``estimated`` from the returns, or ``assumed``.
    basis: Basis


class _Edges(NamedTuple):
    """Edges in one of the three representations, increasing along the beam.

    ``scale`` is its measure of a metre of slant range; ``extent`` is slant.
    """

    name: str
    scale: float
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    extent: float
    supported: bool


def fit_gate(
    interval: NDArray[np.int64],
    summary: NDArray[np.float64],
    outside: NDArray[np.int32],
    buffer_m: float,
    gate_m: float | None,
) -> Gate:
    """Gate of each interval, (m,) ascending, from the merged statistics of a flightline.

    ``gate_m``: slant length of the gate where it is known [m].
    """
    starts = np.flatnonzero(np.diff(interval // WINDOW_INTERVALS, prepend=interval[0] - 10**6))
    column = dict(zip(SUMMARY, summary.T, strict=True))
    tilt = float(np.mean(column["cosine"]))
    half = buffer_m * BUFFER_LADDER[HALF]
    noise = np.add.reduceat(outside[:, :, HALF], starts)
    offered = (
        ("range", 1.0, column["range_min"], column["range_max"]),
        ("height", tilt, -column["z_max"], -column["z_min"]),
        ("surface", 1.0, column["behind_min"], column["behind_max"]),
    )
    candidates = [
        _edges((name, scale), starts, noise, half, (low, high))
        for name, scale, low, high in offered
    ]
    # Of lengths equal within chance the physical one, slant range, wins.
    best = candidates[0]
    for other in candidates[1:]:
        if other.extent < best.extent - max(2.0, 0.02 * best.extent):
            best = other
    size = np.diff(np.append(starts, len(interval)))
    filled = _length_m(best, best.low, best.high, size)
    if gate_m is None:
        # Points whose noise somebody has removed fill no gate. Their extent is the scene's: taken
        # for a gate, it would call trees noise.
        seen = best.supported and filled >= GATE_MIN_M
    else:
        seen = best.supported and _differ(filled, gate_m)
    low, high = (best.low, best.high) if seen else _of_length(best, gate_m or GATE_ASSUMED_M)
    length = _length_m(best, low, high, size)
    basis: Basis = "assumed" if gate_m is None and not seen else "estimated"
    if gate_m is not None and math.isclose(length, gate_m, rel_tol=1e-6):
        basis = "stated"
    warnings = tuple(_remarks(length, gate_m, basis))
    low, high = np.repeat(low, size), np.repeat(high, size)
    if best.name == "height":
        return Gate("height", -low, -high, length, warnings, basis)
    if best.name == "surface":
        low, high = low + column["signal_range"], high + column["signal_range"]
    return Gate("range", low, high, length, warnings, basis)


def _edges(
    named: tuple[str, float],
    starts: NDArray[np.int64],
    noise: NDArray[np.int64],
    half_m: float,
    extremes: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> _Edges:
    """Edges of each window; windows with little noise borrow from the flightline.

    ``noise``: (w, 2), returns above and below the signal [count].
    """
    lowest, highest = (np.split(values, starts[1:]) for values in extremes)
    windows = zip(lowest, highest, noise, strict=True)
    low, high = np.array([_ends(*window, half_m) for window in windows]).T
    extent = high - low
    total = noise.sum(axis=1)
    shortfall = _spacing_m(extent, total, half_m)
    supported = (total >= SUPPORT) & (shortfall < 0.1 * extent)
    if supported.any():
        low, high = low - shortfall, high + shortfall
        low[~supported] = np.median(low[supported])
        high[~supported] = np.median(high[supported])
    length = (high - low)[supported] if supported.any() else extent
    slant = float(np.median(length)) / named[1]
    return _Edges(*named, low, high, slant, supported=bool(supported.any()))


def _spacing_m(extent: Any, noise: Any, half_m: float) -> Any:
    """Mean spacing of the noise in an extent, by returns farther than half_m from the signal."""
    density = noise / np.maximum(extent - 2 * half_m, 0.2 * np.maximum(extent, 1.0))
    return 1.0 / np.maximum(density, 1e-9)


def _ends(
    low: NDArray[np.float64], high: NDArray[np.float64], noise: NDArray[np.int64], half_m: float
) -> tuple[float, float]:
    """Lowest and highest end of a window's intervals that is not far beyond all others."""
    # Distinct ones: an interval without returns repeats the ends of the one before.
    sides = [np.unique(ends, return_index=True) for ends in (low, -high)]
    if min(len(ends) for ends, _ in sides) <= LONE_MOST:
        return float(low.min()), float(high.max())
    within = -sum(ends[LONE_MOST] for ends, _ in sides)
    # Of one side alone: behind the surface there may be less noise.
    first, last = (
        _without_lone(
            ends,
            (high - low - within)[row],
            _spacing_m(within, count, half_m) if count >= SUPPORT else np.inf,
        )
        for (ends, row), count in zip(sides, noise, strict=True)
    )
    return first, -last


def _without_lone(
    ends: NDArray[np.float64], longer: NDArray[np.float64], spacing_m: float
) -> float:
    """Lowest of rising ends that is not far below all others.

    Where the gate of an interval lies elsewhere as a whole, the interval is no longer for that.

    ``longer``: by how much the interval of each is longer than the window without them [m].
    """
    gap, lone = np.diff(ends), 0
    for k in range(1, LONE_MOST + 1):
        follow = gap[k : k + LONE_GAPS[1]]
        if len(follow) < LONE_GAPS[0]:
            break
        far = gap[k - 1] > LONE_SPACINGS * max(spacing_m, follow.mean())
        if far and (longer[:k] > 0.5 * gap[k - 1]).all():
            lone = k
    return float(ends[lone])


def _length_m(
    edges: _Edges, low: NDArray[np.float64], high: NDArray[np.float64], size: NDArray[np.int64]
) -> float:
    """Median slant length over intervals, of which each window has ``size`` [m]."""
    return float(np.median(np.repeat(high - low, size))) / edges.scale


def _differ(length_m: float, stated_m: float) -> bool:
    return abs(length_m - stated_m) > TOLERANCE * stated_m


def _of_length(edges: _Edges, gate_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Edges of a gate of this length, longer where returns alone show edges."""
    middle = 0.5 * (edges.low + edges.high)
    extent = edges.high - edges.low
    half = np.maximum(0.5 * gate_m * edges.scale, 0.0 if edges.supported else 0.5 * extent)
    return middle - half, middle + half


def _remarks(length_m: float, stated_m: float | None, basis: Basis) -> Iterator[Finding]:
    """Findings on a gate, by the one length that everything else uses."""
    if basis == "assumed":
        yield Finding("N01", {"kind": "assumed", "gate_m": length_m}, badness=length_m)
    elif stated_m is not None and _differ(length_m, stated_m):
        values = {"kind": "gate", "gate_m": length_m, "stated_m": stated_m}
        yield Finding("N01", values, badness=abs(length_m - stated_m))
