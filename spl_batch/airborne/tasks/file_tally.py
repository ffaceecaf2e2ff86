"""What is in an input file, counted chunk by chunk; counts of its parts add up to those of all."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.geometry import (
    STEP_BINS,
    estimate_prf,
    merge_track,
    observe_track,
    ordered_times,
    shot_steps,
)
from spl_batch.formats.gps_clock import TimeStandard, time_standard, usable_times
from spl_batch.lattice.row_order import in_order, lexicographic_order
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable, rows_of

Track = dict[str, NDArray[np.int64]]

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

LONE_SPANS: Final = 1000
"""Of more spans of a chunk with next to no points nothing is kept in memory [count]."""

FLOWN_S: Final = 50 * YEAR_S
"""Nobody has flown so long before or after the middle of a file's times, with any points [s]."""

_TIMED: Final = ("gps_time", "point_source_id", "x", "y", "scan_angle")
"""Columns that say when and whereto a flightline was flown."""


BINS_PER_S: Final = 256
"""Bins of a second that points are counted in [1/s]."""

_FAR_BINS: Final = 2.0**60

_MERGE_AT: Final = 64
"""Parts that are kept before they are joined [count]."""


class _Spans(NamedTuple):
    """Spans of time ``[first, last, points]`` of a file."""

    near: dict[int, list[list[float]]]  #: Of flightlines, by point source id.
    astray: list[list[float]]  #: Years from the others.
    scattered: list[list[float]]  #: Too many for the few points that they hold.


class Tally:
    """Running totals over the chunks of a file, or of a part of it.

    A pause of more than ``gap_s`` ends a span of time [s].
    """

    def __init__(self, gap_s: float) -> None:
        self.gap_s = gap_s
        self.counts: dict[str, int] = dict.fromkeys(_COUNTED, 0)
        self.tracks: dict[int, Track] = {}
        self._spans: dict[int, list[list[float]]] = {}
        self._steps: dict[int, NDArray[np.int64]] = {}
        self._rates: dict[int, Rate] = {}
        self._low = np.full(3, np.iinfo(np.int64).max)
        self._high = np.full(3, np.iinfo(np.int64).min)
        self._channels: set[int] = set()
        self.boxes: list[list[int]] = []  #: West, south, east, north of each chunk [quanta].

    def add(self, table: PointTable) -> None:
        """Count one chunk in."""
        time = table["gps_time"]
        valid = usable_times(time)
        excluded = table.has(EXCLUDED)
        self.counts["points"] += len(table)
        self.counts["timeless"] += int(np.count_nonzero(~valid & ~excluded))
        withheld = table.has(PointFlag.WITHHELD)
        unclassified = withheld & (table["input_class"] == 0)
        self.counts["withheld"] += int(np.count_nonzero(withheld))
        self.counts["withheld_unclassified"] += int(np.count_nonzero(unclassified))
        self.counts["vendor_noise"] += int(np.count_nonzero(table.has(PointFlag.VENDOR_NOISE)))
        self.counts["excluded"] += int(np.count_nonzero(excluded))
        low = np.array([table[name].min() for name in "xyz"], np.int64)
        high = np.array([table[name].max() for name in "xyz"], np.int64)
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        self.boxes.append([*low[:2].tolist(), *high[:2].tolist()])
        self._channels.update(np.flatnonzero(np.bincount(table["channel"])).tolist())
        timed = table.select(_TIMED).take(rows_of(valid & ~excluded))
        self._add_times(self._without_lone(timed))

    def _without_lone(self, table: PointTable) -> PointTable:
        """Points without those of scattered times, of which a file may have as many as points."""
        time, line = table["gps_time"], table["point_source_id"]
        keys = [line, time]
        order = np.arange(len(time)) if in_order(keys) else lexicographic_order(keys)
        opens = (np.diff(line[order]) != 0) | (np.diff(time[order]) > self.gap_s)
        span = np.concatenate([np.zeros(min(len(order), 1), np.intp), np.cumsum(opens)])
        lone = np.bincount(span) < SEASON_POINTS
        if np.count_nonzero(lone) <= LONE_SPANS:
            return table
        left_out = order[lone[span]]
        self.counts["lone"] += len(left_out)
        keep = np.ones(len(table), np.bool_)
        keep[left_out] = False
        return table.take(rows_of(keep))

    def _add_times(self, table: PointTable) -> None:
        time = table["gps_time"]
        if not len(time):
            return
        line = table["point_source_id"]
        for psid in np.flatnonzero(np.bincount(line)).tolist():
            mine = table.take(rows_of(line == psid))
            ordered = ordered_times(mine["gps_time"])
            cuts = np.flatnonzero(np.diff(ordered) > self.gap_s) + 1
            for piece in np.split(ordered, cuts):
                self._spans.setdefault(psid, []).append(
                    [float(piece[0]), float(piece[-1]), len(piece)]
                )
            self._rates.setdefault(psid, Rate()).add(ordered)
            self._add_steps(psid, shot_steps(ordered))
            self._add_track(psid, observe_track(mine))

    def _add_steps(self, psid: int, steps: NDArray[np.int64]) -> None:
        if psid in self._steps:
            bins, counts = self._steps[psid]
            steps[bins] += counts
        some = np.flatnonzero(steps)  # all bins of all flightlines could fill the memory
        self._steps[psid] = np.array([some, steps[some]])

    def _add_track(self, psid: int, track: Track) -> None:
        earlier = [self.tracks[psid]] if psid in self.tracks else []
        self.tracks[psid] = merge_track([*earlier, track])

    @property
    def standard(self) -> TimeStandard:
        """How the times are counted, as :func:`~spl_batch.formats.gps_clock.time_standard` says."""
        near = self._near_and_astray().near
        return time_standard(np.array([span[:2] for spans in near.values() for span in spans]))

    def _near_and_astray(self) -> _Spans:
        """Time spans of each flightline, and those of times that none of them can have."""
        merged = {k: merge_spans(v, self.gap_s) for k, v in sorted(self._spans.items())}
        spans = np.array([span for listed in merged.values() for span in listed]).reshape(-1, 3)
        found = _Spans({}, [], [])
        if not len(spans):
            return found
        order = np.argsort(spans[:, 0], kind="stable")
        total = np.cumsum(spans[order, 2])
        middle = float(spans[order[np.searchsorted(total, total[-1] / 2)], 0])
        for psid, listed in merged.items():
            for span in listed:
                apart_s = max(span[0] - middle, middle - span[1])
                few = span[2] < SEASON_POINTS
                unset = span[0] == span[1] == 0.0
                far = unset or apart_s > FLOWN_S or (few and apart_s > YEAR_S)
                (found.astray if far else found.near.setdefault(psid, [])).append(span)
        return _without_scattered(found, 0 if self.counts["lone"] else SPANS_FEW)

    def facts(self) -> dict[str, Any]:
        """What later phases and the report read of it."""
        near, astray, scattered = self._near_and_astray()
        lone = self.counts["lone"] + sum(int(points) for *_, points in scattered)
        far = sum(int(points) for *_, points in astray)
        return {
            **self.counts,
            "timeless": self.counts["timeless"] + far + lone,
            "astray_s": [first for first, *_ in astray[:1]],
            "lone": lone,
            "bounds": [*self._low.tolist(), *self._high.tolist()]
            if self.counts["points"]
            else None,
            "channels_seen": f"{sum(1 << channel for channel in self._channels):x}",
            "spans": {str(psid): spans for psid, spans in near.items()},
            "fullest": {str(k): v.fullest() for k, v in sorted(self._rates.items())},
            "prf_hz": {str(k): estimate_prf(_all_bins(v)) for k, v in sorted(self._steps.items())},
        }

    @property
    def chunk_boxes(self) -> NDArray[np.int64]:
        """West, south, east, north of each chunk, (m, 4) [quanta]."""
        return np.array(self.boxes, np.int64).reshape(-1, 4)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All of it as arrays by name, to be stored."""
        arrays: dict[str, NDArray[Any]] = {
            "counts": np.array(list(self.counts.values())),
            "bounds": np.array([self._low, self._high]),
            "channels": np.array(sorted(self._channels), np.int64),
            "boxes": self.chunk_boxes,
            "lines": np.array(sorted(self._rates), np.int64),
        }
        for psid, rate in self._rates.items():
            arrays[f"{psid}/spans"] = np.array(self._spans[psid])
            arrays[f"{psid}/steps"] = self._steps[psid]
            arrays[f"{psid}/rate"] = np.array(rate.counted())
            arrays |= {f"{psid}/track/{k}": v for k, v in self.tracks[psid].items()}
        return arrays

    def join(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Add what the :meth:`to_arrays` of another part gave."""
        for name, count in zip(_COUNTED, arrays["counts"].tolist(), strict=True):
            self.counts[name] += count
        self._low = np.minimum(self._low, arrays["bounds"][0])
        self._high = np.maximum(self._high, arrays["bounds"][1])
        self._channels.update(arrays["channels"].tolist())
        self.boxes += arrays["boxes"].tolist()
        for psid in arrays["lines"].tolist():
            spans = arrays[f"{psid}/spans"].tolist()
            self._spans.setdefault(psid, []).extend([a, b, int(n)] for a, b, n in spans)
            self._rates.setdefault(psid, Rate()).join(*arrays[f"{psid}/rate"])
            self._add_steps(psid, _all_bins(arrays[f"{psid}/steps"]))
            prefix = f"{psid}/track/"
            names = [name for name in arrays if name.startswith(prefix)]
            self._add_track(psid, {k.removeprefix(prefix): arrays[k] for k in names})


def _all_bins(steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Histogram of steps, of its bins that hold some and their counts."""
    found = np.zeros(STEP_BINS, np.int64)
    found[steps[0]] = steps[1]
    return found


def spans_of(arrays: Mapping[str, NDArray[Any]]) -> dict[str, list[float]]:
    """First and last time of each flightline in what :meth:`Tally.to_arrays` gave [s]."""
    spans = {psid: arrays[f"{psid}/spans"] for psid in arrays["lines"].tolist()}
    return {str(k): [float(v[:, 0].min()), float(v[:, 1].max())] for k, v in spans.items()}


def _without_scattered(found: _Spans, left: int) -> _Spans:
    """Part spans that are flightlines from scattered times, which none has.

    Each flightline costs a run some tasks, so a file's must be worth them: the k-th largest span
    holds at least k points, and :data:`SEASON_POINTS`. Where more than :data:`SPANS_FEW` spans do
    not, the times of their points are scattered: none of these spans is a flightline. A file of n
    points makes no more than ``sqrt(n) + SPANS_FEW`` flightlines, whatever its times are. ``left``
    in place of :data:`SPANS_FEW`.
    """
    points = np.array([span[2] for listed in found.near.values() for span in listed])
    largest = np.sort(points)[::-1]
    small = largest < np.maximum(np.arange(1, len(largest) + 1), SEASON_POINTS)
    if np.count_nonzero(small) <= left:
        return found
    most = float(largest[small][0])  # all of this size go: which comes first says nothing
    near = {k: [s for s in listed if s[2] > most] for k, listed in found.near.items()}
    scattered = [span for listed in found.near.values() for span in listed if span[2] <= most]
    return found._replace(near={k: v for k, v in near.items() if v}, scattered=scattered)


def merge_spans(spans: list[list[float]], gap_s: float) -> list[list[float]]:
    """Join time spans ``[first, last, points]`` that lie no farther apart than a gap [s]."""
    joined = (zip(*chain, strict=True) for chain in chained(sorted(spans), gap_s))
    return [[first[0], max(last), sum(points)] for first, last, points in joined]


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


class Rate:
    """Points of a flightline in one file, counted by time."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []

    def add(self, time_s: NDArray[np.float64]) -> None:
        """Count points in; times are finite [s]."""
        # Times that are none may be anything; they are far from all others, wherever that is.
        bins = np.clip(np.floor(time_s * BINS_PER_S), -_FAR_BINS, _FAR_BINS).astype(np.int64)
        self._parts.append(np.unique(bins, return_counts=True))
        if len(self._parts) > _MERGE_AT:
            self._parts = [self.counted()]

    def join(self, bins: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        """Add what :meth:`counted` gave of another part of the file."""
        self._parts.append((bins, counts))

    def fullest(self) -> list[int]:
        """Most points within 1, 2, 4, ... bins wherever they begin, up to all points [count]."""
        bins, counts = self.counted()
        before = np.concatenate([[0], np.cumsum(counts)])
        found: list[int] = []
        while not found or found[-1] < before[-1]:
            after = np.searchsorted(bins, bins + 2 ** len(found))
            found.append(int((before[after] - before[:-1]).max()))
        return found

    def counted(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Bins that hold points, in order, and how many [count]."""
        bins, counts = (np.concatenate(columns) for columns in zip(*self._parts, strict=True))
        different, which = np.unique(bins, return_inverse=True)
        return different, np.bincount(which, counts, len(different)).astype(np.int64)


def most_points(fullest: Sequence[int], span_s: float) -> int:
    """Points that a span of time holds at the most [count]."""
    bins = math.floor(span_s * BINS_PER_S) + 2  # it begins and ends within one
    if bins >= 2 ** (len(fullest) - 1):
        return fullest[-1]
    # Windows side by side make up the span; a longer one has it within.
    parts = sum(most for k, most in enumerate(fullest) if bins >> k & 1)
    return min(parts, fullest[(bins - 1).bit_length()])
