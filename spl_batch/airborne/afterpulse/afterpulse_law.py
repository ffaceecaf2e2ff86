r"""Law of a flightline's afterpulses: how many follow a detection, and how far behind it.

Domain: time. [W17] 7.5 finds 10-20 afterpulses for 80-100 signal returns of a shot, in a band of
2-3 m, and gives no law. Here it is a table, :math:`p f(l)`: afterpulses per detection and metre at
lag l. It counts what follows returns of hard planes that are alone in their shot, less the
background (:func:`~spl_batch.airborne.afterpulse.candidates.observe`).

A lag is that of the *next* return of the beamlet, so the counts give a hazard: of :math:`A` returns
without a follower before a bin of width w, n have one in it, and b A w of those are background:

.. math:: h = \max(n - b A w, 0) / (A w), \quad p f = h\, e^{-\int h}

The sensor's own law, an exponential from the dead time to its longest lag, counts as :data:`PRIOR`
afterpulses. The table goes on beyond the longest lag where more follow than chance and background
explain, beginning right behind that lag, and enough in all. The same planes give the ranging
spread.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import SHARP, STEP_M
from spl_batch.airborne.afterpulse.lag_counts import (
    LAG_EDGES_M,
    PLANES_LEAST,
    SPREAD_STEP_M,
    SPREADS,
    Counts,
    no_counts,
    ranging_spread,
)
from spl_batch.airborne.noise.gains import SURE_SIGMA
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.simd import LANES

PRIOR: Final = 100.0
"""Afterpulses that the sensor's own figures are worth [count]. Half and twice move 17 + 14 and 34 +
20 labels."""

COARSE: Final = (0.1, 0.15)
"""Least width of a bin of the fit [m], and least share of the lag behind the dead time. Half and
twice move 86 + 87 and 55 + 93 labels."""

TAIL_LEAST: Final = 0.01
"""Least followers of a tail beyond background, per return: fewer are seen where a bright point
lights whole shots, whose few other returns are the ground behind it. Without, those are a tail."""


class AfterpulseLaw(NamedTuple):
    """Afterpulses of a flightline."""

    probability: float
    #: dead_m, longest_m: dead time as range, and the longest lag [m].
    dead_m: float
    longest_m: float
    sigma_m: float
    #: (k,): afterpulses per detection and metre, from the dead time on, every
    #: :data:`~spl_batch.airborne.afterpulse.hard_surfaces.STEP_M` [1/m].
    density: NDArray[np.float64]

    @property
    def least_m(self) -> float:
        """Shortest lag that can be measured: both returns carry the ranging spread [m]."""
        return max(self.dead_m - 5.0 * self.sigma_m, 1e-3)

    def later_than(self, lag_m: float) -> float:
        """Share of the afterpulses whose lag is longer, 0..1."""
        late = _nodes(self.dead_m, self.longest_m) > lag_m
        total = self.density.sum()
        return float(self.density[late].sum() / total) if total > 0 else 0.0

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The law as arrays for a file."""
        return {
            "afterpulse_law": np.array(self[:-1], dtype=np.float64),
            "afterpulse_density": self.density,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "AfterpulseLaw":
        """What :meth:`to_arrays` has made."""
        numbers = map(float, arrays["afterpulse_law"])
        named = dict(zip(cls._fields, numbers, strict=False))
        return cls(**named, density=arrays["afterpulse_density"])


def sensor_law(sensor: Sensor) -> AfterpulseLaw:
    """The law that the sensor's facts give."""
    dead, longest, scale = sensor.dead_m, sensor.afterpulse_lag_max_m, sensor.afterpulse_scale_m
    behind = _nodes(dead, longest) - dead
    density = np.exp(-behind / scale) / scale / -np.expm1(-(longest - dead) / scale)
    return AfterpulseLaw(
        sensor.afterpulse_probability, dead, longest, sensor.range_sigma_m,
        sensor.afterpulse_probability * density,
    )  # fmt: skip


def _nodes(dead_m: float, longest_m: float) -> NDArray[np.float64]:
    """Lags at which a law is tabled [m]; the last one is the longest, or just beyond it."""
    steps = math.ceil((longest_m - dead_m) / STEP_M - 1e-9)
    return dead_m + STEP_M * np.arange(steps + 1, dtype=np.float64)


def across_beams(
    table: PointTable, shots: NDArray[np.int64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Two coordinates of points across the first beam of their shot: (2, n + 8) [m].

    They count from the shot's first point; the axes are arbitrary, but depend on the beam alone.
    """
    first, size = shots[:-1], np.diff(shots)
    dx, dy, dz = direction[first].T
    none = np.zeros(len(first))
    ux, uy, uz = np.where(np.abs(dx) < 0.7, (none, dz, -dy), (-dz, none, dx))
    norm = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / norm, uy / norm, uz / norm
    other = (dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux)
    out = np.zeros((2, len(table) + LANES))
    for name, one, two in zip("xyz", (ux, uy, uz), other, strict=True):
        place = table[name].astype(np.int64, copy=False)
        offset = (place - np.repeat(place[first], size)) * QUANTUM_M
        for found, axis in zip(out, (one, two), strict=True):
            found[: len(table)] += np.repeat(axis, size) * offset
    return out


def several(channel: NDArray[np.uint8], shots: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Shots that know channels: without them, who follows whom is not known."""
    low = np.minimum.reduceat(channel, shots[:-1])
    several: NDArray[np.bool_] = np.maximum.reduceat(channel, shots[:-1]) > low
    return several


def fit(
    parts: Sequence[dict[str, NDArray[Any]]], noise_per_m: float, sensor: Sensor
) -> AfterpulseLaw:
    """Law of a flightline.

    Parameters
    ----------
    parts : sequence of dict
        Results of :func:`~spl_batch.airborne.afterpulse.candidates.observe`, in any order.
    noise_per_m : float
        Background per metre of beamlet, which follows a return as well [1/m].
    sensor : Sensor
        Dead time, and what is expected beforehand.
    """
    counts = added(parts)
    sigma_m = ranging_spread(counts.planes, sensor)
    entries, followers, left = of_hard_planes(counts, sigma_m)
    prior = sensor_law(sensor)
    edges, bins = _coarse_bins(prior.dead_m, prior.longest_m)
    width = np.diff(edges)
    n = np.add.reduceat(followers[bins[0] : bins[-1]], bins[:-1] - bins[0]).astype(np.float64)
    fine = np.diff(np.maximum(LAG_EDGES_M[bins[0] : bins[-1] + 1], prior.dead_m))
    looked = np.add.reduceat(left[bins[0] : bins[-1]] * fine, bins[:-1] - bins[0])
    background = looked * noise_per_m
    stated_end = float(LAG_EDGES_M[_stated_edge(prior.dead_m, prior.longest_m)])
    planes = int(counts.planes[spread_as_hard(sigma_m)].sum())
    least = TAIL_LEAST * float(entries.sum()) if planes >= PLANES_LEAST else math.inf
    reach = _reach(n, background, edges, stated_end, least)
    longest = reach if reach > stated_end else prior.longest_m
    within = edges[1:] <= reach
    excess = np.where(within, np.maximum(n - background, 0.0), 0.0)
    stated = prior.probability * _share_before(edges, sensor)
    lent = PRIOR / max(prior.probability, 1e-6)
    # Exactly the hazard that gives the stated share where nothing is seen.
    due = lent * -np.diff(np.log1p(-stated))
    hazard = (excess + due) / (looked + lent * width)
    passed = np.exp(-np.insert(np.cumsum(hazard * width), 0, 0.0))
    return _tabled(
        edges[: within.sum() + 1], np.minimum(-np.diff(passed), 0.95)[within], longest,
        prior._replace(sigma_m=sigma_m),
    )  # fmt: skip


def added(parts: Sequence[Mapping[str, NDArray[Any]]]) -> Counts:
    """Sums of what the stretches of a flightline show."""
    total = no_counts()
    for part in parts:
        for name, sums in total._asdict().items():
            np.add(sums, part[f"afterpulse_{name}"], out=sums)
    return total


def of_hard_planes(
    counts: Counts, sigma_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Entries, followers and returns without one so far, of planes that spread as hard ones do."""
    hard = spread_as_hard(sigma_m)
    entries, followers = counts.entries[hard].sum(axis=0), counts.followers[hard].sum(axis=0)
    return entries, followers, np.cumsum(entries) - np.cumsum(followers) + 0.5 * followers


def spread_as_hard(sigma_m: float) -> NDArray[np.bool_]:
    """Which steps of spread are those of hard planes."""
    hard: NDArray[np.bool_] = np.arange(SPREADS) * SPREAD_STEP_M < SHARP * sigma_m
    return hard


def _coarse_bins(dead_m: float, stated_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Edges of the bins of a law [m], all of them fine edges; the first is at the dead time.

    One is the stated longest lag, or the next fine edge behind it.
    """
    stated = _stated_edge(dead_m, stated_m)
    at = int(np.searchsorted(LAG_EDGES_M, dead_m, side="right")) - 1
    chosen, last = [at], len(LAG_EDGES_M) - 1
    while at < last:
        low = max(float(LAG_EDGES_M[at]), dead_m)
        wide = low + max(COARSE[0], COARSE[1] * (low - dead_m)) - 1e-9
        end = stated if at < stated else last
        at = min(int(np.searchsorted(LAG_EDGES_M, wide)), end)
        chosen.append(at)
    edges = LAG_EDGES_M[chosen].copy()
    edges[0] = dead_m
    return edges, np.array(chosen, dtype=np.int64)


def _stated_edge(dead_m: float, stated_m: float) -> int:
    """Fine edge at the stated longest lag or next behind it, with a bin before it at least."""
    at = int(np.searchsorted(LAG_EDGES_M, dead_m, side="right"))
    last = len(LAG_EDGES_M) - 1
    return min(max(int(np.searchsorted(LAG_EDGES_M, stated_m - 1e-9)), at), last)


def _reach(
    n: NDArray[np.float64], background: NDArray[np.float64], edges: NDArray[np.float64],
    stated_m: float, least: float,
) -> float:  # fmt: skip
    """Longest lag at which more follow than background and chance explain, or the stated one [m].

    Also that of a tail which goes on from the stated lag with more followers than ``least``.
    """
    beyond = edges[:-1] >= stated_m
    more = np.where(beyond, n - background, 0.0)
    due = np.where(beyond, background, 0.0)
    first = np.flatnonzero(beyond)[:3]
    # Noise that falls along the gate lets more follow near than deep: up to twice as many.
    if more[first].sum() <= due[first].sum():
        return stated_m
    # Three bins together, as each holds few far behind.
    three, due_three = (np.convolve(values, np.ones(3), "same") for values in (more, due))
    shows = three > SURE_SIGMA * np.sqrt(due_three + 1.0)
    own = more > 0.5 * SURE_SIGMA * np.sqrt(due + 1.0)
    last = np.flatnonzero(own & np.convolve(shows, np.ones(3), "same").astype(np.bool_))
    if not len(last) or more[: last[-1] + 1].sum() <= least:
        return stated_m
    return max(stated_m, float(edges[last[-1] + 1]))


def _share_before(edges: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Share of the sensor's afterpulses before some lags, 0..1."""
    scale, window = sensor.afterpulse_scale_m, sensor.afterpulse_lag_max_m - sensor.dead_m
    behind = np.clip(edges - sensor.dead_m, 0.0, window)
    share: NDArray[np.float64] = np.expm1(-behind / scale) / np.expm1(-window / scale)
    return share


def _tabled(
    edges: NDArray[np.float64], share: NDArray[np.float64], longest_m: float, law: AfterpulseLaw
) -> AfterpulseLaw:
    """A law of so many afterpulses per detection in each bin, as a table."""
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    # Between the middles of bins the law is as exponential as their contents are.
    level = np.log(np.maximum(share / width, 1e-12))
    nodes = _nodes(law.dead_m, longest_m)
    found = np.interp(nodes, middle, level)
    several = len(level) > 1
    slope = min((level[1] - level[0]) / (middle[1] - middle[0]), 0.0) if several else 0.0
    found += np.where(nodes < middle[0], slope * (nodes - middle[0]), 0.0)
    density = np.exp(found)
    probability = float(share.sum())
    density *= probability / max(float(np.trapezoid(density, nodes)), 1e-12)
    return law._replace(probability=probability, longest_m=longest_m, density=density)
