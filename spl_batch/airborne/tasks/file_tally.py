"""What is in an input file, counted chunk by chunk; counts of its parts add up to those of all."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.geometry import (
    STEP_BINS,
    estimate_prf,
    ordered_times,
    shot_steps,
)
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.formats.gps_clock import time_standard, usable_times
from spl_batch.lattice.row_order import in_order, lexicographic_order
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable, rows_of

Counted = dict[str, NDArray[Any]]
"""What was counted, by the names of :func:`observe`."""

S = TypeVar("S", bound=Sequence[Any])

_COUNTED: Final = (
    "points", "timeless", "withheld", "withheld_unclassified", "vendor_noise", "excluded",
    "lone",
)  # fmt: skip

YEAR_S: Final = 365.25 * 86_400
"""A few times that are farther from the middle of a file's times are none of them [s]."""

SEASON_POINTS: Final = 100
"""From so many points within a gap on they are another season's of the same tile [count]."""

SPANS_FEW: Final = 100
"""So many spans with next to no points are kept: a tile cuts corners of flightlines [count]."""

FLOWN_S: Final = 50 * YEAR_S
"""Nobody has flown so long before or after the middle of a file's times, with any points [s]."""

BINS_PER_S: Final = 256
"""Bins of a second that points are counted in [1/s]."""

_NOTHING: Final[Counted] = {
    "counts": np.zeros(len(_COUNTED), np.int64),
    "low": np.full(3, np.iinfo(np.int64).max),
    "high": np.full(3, np.iinfo(np.int64).min),
    "boxes": np.empty((0, 4), np.int64),
    "channels": np.empty(0, np.int64),
}
"""What is counted of no points."""


def observe(table: PointTable, gap_s: float) -> Counted:
    """Count what a chunk of a file holds, at least one point; chunks add up by :func:`merge`.

    Parameters
    ----------
    gap_s : float
        A longer pause ends a span of time [s].

    Returns
    -------
    dict of str to ndarray
        ``counts`` (7,), ``low, high`` (3,) and ``boxes`` (1, 4), west, south, east, north [quanta];
        ``channels``, the beamlet numbers that are there; of each point source id ``ID/spans``
        (k, 3), first and last time [s] and points; ``ID/steps`` and ``ID/rate`` (m, 2), bins of
        :func:`.shot_steps` and of :data:`BINS_PER_S` that hold some, and how many.
    """
    valid, excluded = usable_times(table["gps_time"]), table.has(EXCLUDED)
    timed = table.select(("gps_time", "point_source_id")).take(rows_of(valid & ~excluded))
    kept = _without_lone(timed, gap_s)
    withheld = table.has(PointFlag.WITHHELD)
    held = (
        *(~valid & ~excluded, withheld, withheld & (table["input_class"] == 0)),
        *(table.has(PointFlag.VENDOR_NOISE), excluded),
    )
    counts = [len(table), *(int(np.count_nonzero(some)) for some in held), len(timed) - len(kept)]
    low, high = ([int(end(table[name])) for name in "xyz"] for end in (np.min, np.max))
    found = {
        "counts": np.array(counts),
        "low": np.array(low),
        "high": np.array(high),
        "boxes": np.array([[*low[:2], *high[:2]]]),
        "channels": np.flatnonzero(np.bincount(table["channel"])),
    }
    for psid in np.flatnonzero(np.bincount(kept["point_source_id"])).tolist():
        time = ordered_times(kept["gps_time"][rows_of(kept["point_source_id"] == psid)])
        pieces = np.split(time, np.flatnonzero(np.diff(time) > gap_s) + 1)
        steps = shot_steps(time)
        some = np.flatnonzero(steps)  # all bins of all flightlines could fill the memory
        found[f"{psid}/spans"] = np.array([[one[0], one[-1], len(one)] for one in pieces])
        found[f"{psid}/steps"] = np.stack([some, steps[some]], axis=1)
        found[f"{psid}/rate"] = rate_of(time)
    return found


def _without_lone(table: PointTable, gap_s: float) -> PointTable:
    """Points without those of scattered times, of which a file may have as many as points."""
    time, line = table["gps_time"], table["point_source_id"]
    keys = [line, time]
    order = np.arange(len(time)) if in_order(keys) else lexicographic_order(keys)
    opens = (np.diff(line[order]) != 0) | (np.diff(time[order]) > gap_s)
    span = np.concatenate([np.zeros(min(len(order), 1), np.intp), np.cumsum(opens)])
    lone = np.bincount(span) < SEASON_POINTS
    if np.count_nonzero(lone) <= SPANS_FEW:
        return table
    keep = np.ones(len(table), np.bool_)
    keep[order[lone[span]]] = False
    return table.take(rows_of(keep))


def rate_of(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Bins that hold points, by usable times in order [s], and how many [count]: (m, 2)."""
    bins = np.floor(time_s * BINS_PER_S).astype(np.int64)
    starts = run_starts(bins)
    return np.stack([bins[starts[:-1]], np.diff(starts)], axis=1)


def sum_of_bins(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Bins that hold some in any of some parts, in order, and how many [count]: (m, 2)."""
    bins, counts = np.concatenate(parts).T
    different, which = np.unique(bins, return_inverse=True)
    total = np.bincount(which, counts, len(different)).astype(np.int64)
    return np.stack([different, total], axis=1)


_ADD_UP: Final[Mapping[str, Callable[[Sequence[NDArray[Any]]], NDArray[Any]]]] = {
    **dict.fromkeys(("counts", "returns"), partial(np.sum, axis=0)),
    **dict.fromkeys(("steps", "rate"), sum_of_bins),
    "low": partial(np.min, axis=0),
    "high": partial(np.max, axis=0),
}
"""How parts of an array are put together, by the end of its name; others follow each other."""


def merge(parts: Iterable[Counted]) -> Counted:
    """What :func:`observe` has counted of parts of a file, added up.

    Likewise of what was added up already, and what :meth:`.Extent.to_arrays` gives.
    """
    held: dict[str, list[NDArray[Any]]] = {name: [values] for name, values in _NOTHING.items()}
    for part in parts:
        for name, values in part.items():
            held.setdefault(name, []).append(values)
    return {
        name: _ADD_UP.get(name.rpartition("/")[2], np.concatenate)(values)
        for name, values in held.items()
    }


def _lines(counted: Counted) -> list[int]:
    """Point source ids of the points that were counted."""
    return sorted(int(k.partition("/")[0]) for k in counted if k.endswith("/spans"))


Spans = NDArray[np.float64]
"""Rows of point source id, first and last time [s], and points: (k, 4)."""


def _spans(counted: Counted, gap_s: float, left: int) -> tuple[Spans, Spans, Spans]:
    """Spans of time of flightlines, those years from the others, and those of scattered times.

    Each flightline costs a run some tasks, so a file's must be worth them: the k-th largest span
    holds at least k points, and :data:`SEASON_POINTS`. Where more spans do not than are ``left``,
    :data:`SPANS_FEW`, the times of their points are scattered: none of these spans is a flightline.
    A file of n points makes no more than ``sqrt(n) + SPANS_FEW`` flightlines, whatever its times
    are.
    """
    spans = np.array(
        [(k, *span) for k in _lines(counted) for span in merge_spans(counted[f"{k}/spans"], gap_s)]
    ).reshape(-1, 4)
    _, first, last, points = spans.T
    order = np.argsort(first, kind="stable")
    total = np.cumsum(points[order])
    middle = first[order[np.searchsorted(total, total[-1:] / 2)]]
    apart_s = np.maximum(first - middle, middle - last)
    far = (apart_s > FLOWN_S) | ((points < SEASON_POINTS) & (apart_s > YEAR_S))
    far |= (first == 0.0) & (last == 0.0)
    near = spans[~far]
    largest = np.sort(near[:, 3])[::-1]
    small = largest < np.maximum(np.arange(1, len(largest) + 1), SEASON_POINTS)
    most = largest[small][0] if np.count_nonzero(small) > left else 0.0
    scattered = near[:, 3] <= most  # all of this size go: which comes first means nothing
    return near[~scattered], spans[far], near[scattered]


def facts_of(counted: Counted, gap_s: float) -> dict[str, Any]:
    """What later phases and the report read of a file; ``gap_s`` as of :func:`observe`."""
    counts = dict(zip(_COUNTED, counted["counts"].tolist(), strict=True))
    near, astray, scattered = _spans(counted, gap_s, 0 if counts["lone"] else SPANS_FEW)
    lone = counts["lone"] + int(scattered[:, 3].sum())
    flown: dict[str, list[list[float]]] = {}
    for psid, first_s, last_s, points in near.tolist():
        flown.setdefault(f"{psid:.0f}", []).append([first_s, last_s, int(points)])
    lines, channels = _lines(counted), np.unique(counted["channels"])
    ends = [*counted["low"].tolist(), *counted["high"].tolist()]
    return {
        **counts,
        "timeless": counts["timeless"] + int(astray[:, 3].sum()) + lone,
        "astray_s": astray[:1, 1].tolist(),
        "lone": lone,
        "bounds": ends if counts["points"] else None,
        "channels_seen": f"{sum(1 << channel for channel in channels.tolist()):x}",
        "standard": time_standard(near[:, 1:3]),
        "spans": flown,
        "fullest": {str(k): fullest(counted[f"{k}/rate"]) for k in lines},
        "prf_hz": {str(k): estimate_prf(_all_bins(counted[f"{k}/steps"])) for k in lines},
    }


def _all_bins(steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Histogram of steps, of its bins that hold some and their counts."""
    found = np.zeros(STEP_BINS, np.int64)
    found[steps[:, 0]] = steps[:, 1]
    return found


def spans_of(counted: Counted) -> dict[str, list[float]]:
    """First and last time of each flightline in what was counted [s]."""
    spans = {psid: counted[f"{psid}/spans"] for psid in _lines(counted)}
    return {str(k): [float(v[:, 0].min()), float(v[:, 1].max())] for k, v in spans.items()}


def merge_spans(spans: NDArray[np.float64], gap_s: float) -> list[list[float]]:
    """Join time spans, (k, 3) of first, last and points, no farther apart than a gap [s]."""
    joined = (zip(*chain, strict=True) for chain in chained(sorted(spans.tolist()), gap_s))
    return [[first[0], max(last), int(sum(points))] for first, last, points in joined]


def chained(spans: Iterable[S], gap_s: float) -> list[list[S]]:
    """Spans ``(first, last, ...)``, sorted, together where they lie no farther apart than a gap."""
    chains: list[list[S]] = []
    end = -math.inf
    for span in spans:
        if span[0] - end > gap_s:
            chains.append([])
        chains[-1].append(span)
        end = max(end, span[1])
    return chains


def fullest(rate: NDArray[np.int64]) -> list[int]:
    """Most points within 1, 2, 4, ... bins wherever they begin, up to all points [count].

    ``rate``: (m, 2), from :func:`rate_of`, or added up.
    """
    bins, counts = rate.T
    before = np.concatenate([[0], np.cumsum(counts)])
    found: list[int] = []
    while not found or found[-1] < before[-1]:
        after = np.searchsorted(bins, bins + 2 ** len(found))
        found.append(int((before[after] - before[:-1]).max()))
    return found


def most_points(fullest: Sequence[int], span_s: float) -> int:
    """Points that a span of time holds at the most [count]."""
    bins = math.floor(span_s * BINS_PER_S) + 2  # it begins and ends within one
    if bins >= 2 ** (len(fullest) - 1):
        return fullest[-1]
    # Windows side by side make up the span; a longer one has it within.
    parts = sum(most for k, most in enumerate(fullest) if bins >> k & 1)
    return min(parts, fullest[(bins - 1).bit_length()])
