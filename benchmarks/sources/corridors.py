"""The wire metric of [W18] Tables 1-3 with point truth in place of hand-made classes.

Detection: wire returns kept / wire returns, in a region of 7 m x 7 m (height x width) around the
line. False alarm: noise kept / (wire + noise) kept in it. Returns of poles and trees that reach
into the region count as neither: a human would have left them out, and the filter is right to
keep them.
"""

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.sources.methods import WIRE, Columns, is_noise

REGION_M = 7.0
"""Height and width of the region around a line [m]."""


@dataclass(frozen=True, slots=True)
class Span:
    """A span between two towers: where it runs and which wires hang in it.

    Parameters
    ----------
    start_m : (2,) float64
        First tower, in the survey's coordinates [m].
    along : (2,) float64
        Unit vector to the next tower.
    length_m : float
        Distance of the towers [m].
    strands : (s, 4) float64
        For each wire: offset to the right of the towers [m], and a, vertex, offset of its
        catenary z(s) = offset + a cosh((s - vertex) / a) [m].
    """

    start_m: NDArray[np.float64]
    along: NDArray[np.float64]
    length_m: float
    strands: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Counts:
    """What a region holds and what a filter keeps of it [count]."""

    wire: int
    wire_kept: int
    noise: int
    noise_kept: int

    def __add__(self, other: "Counts") -> "Counts":
        return Counts(
            self.wire + other.wire,
            self.wire_kept + other.wire_kept,
            self.noise + other.noise,
            self.noise_kept + other.noise_kept,
        )

    @property
    def detection(self) -> float:
        """Share of wire returns kept [%]."""
        return 100.0 * self.wire_kept / max(self.wire, 1)

    @property
    def false_alarm(self) -> float:
        """Share of noise among what is kept [%]."""
        return 100.0 * self.noise_kept / max(self.wire_kept + self.noise_kept, 1)


def lines(survey: Path) -> list[tuple[str, list[Span]]]:
    """Lines of a simulated survey: kind, and spans; cables on the same towers are one line."""
    truth = json.loads((survey / "truth" / "scene.json").read_text(encoding="utf-8"))
    origin = np.array(truth["scene"]["origin_m"][:2])
    rows = iter(truth["wires"])
    found: dict[tuple[tuple[float, float], ...], tuple[str, list[list[NDArray[np.float64]]]]] = {}
    for entry in truth["scene"]["wires"]:
        towers = tuple((x, y) for x, y in entry["points_m"])
        spans = len(towers) - 1
        _, strands = found.setdefault(towers, (entry["kind"], [[] for _ in range(spans)]))
        for k, (start, _) in enumerate(pairwise(towers)):
            for _ in range(entry["conductors"] + entry["shield"]):
                strands[k].append(_strand(np.array(next(rows)), np.array(start)))
    return [
        (kind, [_span(*ends, origin, part) for ends, part in zip(pairwise(at), parts, strict=True)])
        for at, (kind, parts) in found.items()
    ]


def _strand(row: NDArray[np.float64], tower: NDArray[np.float64]) -> NDArray[np.float64]:
    east, north = row[:2] - tower
    across = east * row[3] - north * row[2]
    return np.array([across, *row[5:8]])


def _span(
    start: tuple[float, float],
    end: tuple[float, float],
    origin: NDArray[np.float64],
    strands: list[NDArray[np.float64]],
) -> Span:
    step = np.array(end) - np.array(start)
    length = float(np.hypot(*step))
    return Span(np.array(start) + origin, step / length, length, np.array(strands))


def inside(span: Span, points: Columns) -> NDArray[np.bool_]:
    """Which points lie in the region around a span: (n,) bool."""
    east, north = points["x"] - span.start_m[0], points["y"] - span.start_m[1]
    s = east * span.along[0] + north * span.along[1]
    across = east * span.along[1] - north * span.along[0]
    out: NDArray[np.bool_] = (s >= 0) & (s < span.length_m)
    middle = 0.5 * (span.strands[:, 0].min() + span.strands[:, 0].max())
    out &= np.abs(across - middle) <= REGION_M / 2
    rows = np.flatnonzero(out)
    a, vertex, offset = (span.strands[:, k, None] for k in (1, 2, 3))
    heights = offset + a * np.cosh((s[rows] - vertex) / a)
    centre = 0.5 * (heights.min(axis=0) + heights.max(axis=0))
    out[rows] = np.abs(points["z"][rows] - centre) <= REGION_M / 2
    return out


def distance_m(span: Span, points: Columns) -> NDArray[np.float64]:
    """Distance to the nearest wire of a span, at right angles to the span: (n,) float64 [m].

    Infinite beside the span. Wires are so nearly level that the height difference at the foot of
    the perpendicular is the distance.
    """
    east, north = points["x"] - span.start_m[0], points["y"] - span.start_m[1]
    s = east * span.along[0] + north * span.along[1]
    across = east * span.along[1] - north * span.along[0]
    out = np.full(len(s), np.inf)
    rows = np.flatnonzero((s >= 0) & (s < span.length_m))
    for offset_m, a, vertex, low in span.strands:
        height = low + a * np.cosh((s[rows] - vertex) / a)
        away = np.hypot(across[rows] - offset_m, points["z"][rows] - height)
        out[rows] = np.minimum(out[rows], away)
    return out


def region(spans: list[Span], points: Columns) -> NDArray[np.bool_]:
    """Which points lie in the region around a line: (n,) bool."""
    out = np.zeros(len(points["x"]), dtype=np.bool_)
    for span in spans:
        out |= inside(span, points)
    return out


def nearest_m(spans: list[Span], points: Columns) -> NDArray[np.float64]:
    """Distance to the nearest wire of a line, :func:`distance_m` over its spans [m]."""
    out = np.full(len(points["x"]), np.inf)
    for span in spans:
        out = np.minimum(out, distance_m(span, points))
    return out


def count(points: Columns, kept: NDArray[np.bool_], within: NDArray[np.bool_]) -> Counts:
    """Wire and noise returns of a region, all and kept."""
    wire = within & (points["kind"] == WIRE)
    noise = within & is_noise(points["kind"])
    return Counts(
        int(wire.sum()), int((wire & kept).sum()), int(noise.sum()), int((noise & kept).sum())
    )
