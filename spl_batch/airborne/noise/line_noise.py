"""Line noise density of each beamlet, rho_l [1/m].

Sources: [W17] Eq. 5.1, [W18] 2.2.1.

| symbol | name |
|---|---|
| N | ``outside``: noise returns of an interval |
| 6000 | shots fired x ``beamlets`` |
| R | slant length of gate that was counted |
| rho_l | ``rate`` x ``gain`` of the channel x ``ground`` of the cell that is looked at |

Deviations: silent shots count as fired; R is what the gate really leaves, as a slant length; the
ground has a gain. The buffer around the signal is the largest of a ladder that leaves a fifth of
the gate, or the narrowest, and a side of the signal that disagrees, as signal reaches into it, is
left out. Rates of intervals are shrunk towards their neighbours (empirical Bayes, gamma prior).
"""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from spl_batch.airborne.noise.gains import (
    SURE_SIGMA,
    active_channels,
    channel_gains,
    ground,
    prior_weight,
)
from spl_batch.airborne.noise.gate import Gate, fit_gate
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.noise.line_statistics import BUFFER_LADDER, HALF, SUPPORT
from spl_batch.airborne.noise.noise_intervals import SUMMARY
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.engine.findings import Finding
from spl_batch.lattice.tables import BeamTable, PointTable

REGION_MIN: Final = 0.2
"""Least share of the gate in a noise region. Half moves nothing, twice 497 + 0 labels."""


def fit(
    merged: dict[str, NDArray[Any]],
    settings: NoiseSettings,
    sensor: Sensor,
) -> LineModel:
    """Line noise model of one flightline.

    Parameters
    ----------
    merged : dict
        Statistics of all its stretches, from
        :func:`~spl_batch.airborne.noise.line_statistics.merge`.
    sensor : Sensor
        Beamlets per shot, and the gate's length where it is known.
    """
    if len(merged["interval"]) == 0:
        return _nothing(settings, sensor)
    interval, rows, first, last = _fired(merged, settings.interval_shots)
    summary = merged["summary"][rows]
    present = np.diff(rows, prepend=-1) > 0
    outside = np.where(present[:, None, None], merged["outside"][rows], 0)
    beamlets, gain_active, warnings = active_channels(merged["seen_channel"], sensor.beamlets)
    gate = fit_gate(interval, summary, outside, settings.buffer_m, sensor.gate_m)
    fired = (last - first + 1).astype(np.float64) * beamlets
    length = offered_lengths(gate, summary, settings.buffer_m)
    region = choose_region(outside, fired[:, None, None] * length, fired, gate, summary)
    sides = np.array(region.sides)
    counted = (outside[:, :, region.buffer] @ sides).astype(np.int64)
    nearer = max(region.buffer, HALF)
    blinded = np.where(present[:, None, None], merged["blinded"][rows], 0.0)
    listened = np.maximum(sides @ (fired[:, None, None] * length - blinded), 0.0)
    heard = listened[:, region.buffer]
    rate = _smooth(interval, counted, heard, settings.smooth_intervals)
    expected = rate * listened[:, [region.buffer, nearer]].T
    cell, of_cell = ground(merged, interval, expected, (region.buffer, nearer), sides)
    by_channel = sides.astype(np.int64) @ merged["by_channel"][:, region.buffer]
    seen = np.where(present, merged["beamlets"][rows], 0)
    # Where channels are not distinguished, each return counts as a beamlet.
    looks = seen if beamlets > 1 else np.where(present, merged["returns"][rows], 0)
    return LineModel(
        interval=interval,
        rate=rate,
        first=first,
        last=last,
        near=gate.near,
        far=gate.far,
        gain=channel_gains(by_channel, gain_active),
        seen_fraction=np.minimum(seen / fired, 1.0),
        kind=gate.kind,
        gate_m=gate.length_m,
        mean_rate=float(np.average(rate, weights=fired)),
        signal=merged["signal"],
        first_group=(np.cumsum(merged["groups"]) - merged["groups"])[rows],
        groups=merged["groups"][rows],
        cell=cell,
        ground=of_cell,
        beamlets=beamlets,
        interval_shots=settings.interval_shots,
        seen_shots=_seen_window(looks, last - first + 1, settings.interval_shots),
        gate_basis=gate.basis,
        findings=(*warnings, *gate.warnings, *region.warnings, *_remarks(merged)),
    )


class Region(NamedTuple):
    """Buffer and sides of the signal that are counted."""

    buffer: int
    sides: tuple[float, float]  #: Weights of what lies above and below the signal.
    warnings: tuple[Finding, ...]


def offered_lengths(
    gate: Gate, summary: NDArray[np.float64], buffer_m: float
) -> NDArray[np.float64]:
    """Slant length of gate above and below each buffer: (m, 2, b) float64 [m].

    The signal's height varies within an interval: it is the mean of the positive part, for a normal
    spread.
    """
    column = dict(zip(SUMMARY, summary.T, strict=True))
    cosine = column["cosine"][:, None]
    buffers = buffer_m * np.array(BUFFER_LADDER) / cosine
    above, below = _around_signal(gate, summary)
    both = np.stack([above[:, None] - buffers, below[:, None] - buffers], axis=1)
    spread = np.maximum(column["signal_sd"] / column["cosine"], 1e-6)[:, None, None]
    ratio = both / spread
    density = np.exp(-0.5 * np.minimum(ratio**2, 1400.0)) / np.sqrt(2 * np.pi)
    length: NDArray[np.float64] = both * ndtr(ratio) + spread * density
    return np.maximum(length, 0.0)


def _around_signal(
    gate: Gate, summary: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant length of gate in front of and behind the signal: two (m,) float64 [m]."""
    column = dict(zip(SUMMARY, summary.T, strict=True))
    if gate.kind == "height":
        z, cosine = column["signal_z"], column["cosine"]
        return (gate.near - z) / cosine, (z - gate.far) / cosine
    return column["signal_range"] - gate.near, gate.far - column["signal_range"]


def choose_region(
    outside: NDArray[np.int32],
    exposure: NDArray[np.float64],
    fired: NDArray[np.float64],
    gate: Gate,
    summary: NDArray[np.float64],
) -> Region:
    """Largest buffer that leaves a noise region, and the sides of it that agree."""
    counts = outside.sum(axis=0, dtype=np.int64)
    offered = exposure.sum(axis=0)
    above, below = _around_signal(gate, summary)
    whole = float(np.sum(fired * np.maximum(above + below, 0.0)))
    wide = np.flatnonzero(offered.sum(axis=0) >= REGION_MIN * whole)
    if whole <= 0 or len(wide) == 0:
        return Region(len(BUFFER_LADDER) - 1, (1.0, 1.0), (Finding("N01", {"kind": "full"}),))
    b = int(wide[0])
    share = BUFFER_LADDER[b]
    # The part of the gate taken for signal had to shrink.
    short = Finding("N01", {"kind": "short", "share": share}, badness=-share)
    notes = (short,) if b else ()
    (n_up, n_down), (e_up, e_down) = counts[:, b], offered[:, b]
    if min(e_up, e_down) < 0.25 * REGION_MIN * whole:
        return Region(b, (1.0, 1.0), notes)
    up, down = n_up / e_up, n_down / e_down
    spread = np.sqrt((n_up + 1) / e_up**2 + (n_down + 1) / e_down**2)
    if abs(up - down) <= max(0.15 * min(up, down), SURE_SIGMA * spread):
        return Region(b, (1.0, 1.0), notes)
    more, side = ("above", "below") if up > down else ("below", "above")
    times = float(max(up, down) / min(up, down))
    values = {"kind": "side", "times": times, "more": more, "side": side}
    used = (0.0, 1.0) if up > down else (1.0, 0.0)
    return Region(b, used, (*notes, Finding("N01", values, badness=times)))


def _remarks(merged: dict[str, NDArray[Any]]) -> Iterator[Finding]:
    """Findings on intervals whose returns are so few that noise passes for signal, and on strays.

    Strays lie far beyond the gate.
    """
    per_interval = float(merged["beamlets"].mean())
    if per_interval < SUPPORT:
        low = 1.0 / max(per_interval, 1.0)
        values = {"kind": "few", "per_interval": per_interval, "low": low}
        yield Finding("N01", values, badness=-per_interval)
    if count := int(merged["strays"][0]):
        yield Finding("N01", {"kind": "strays", "count": count}, badness=count)


def _nothing(settings: NoiseSettings, sensor: Sensor) -> LineModel:
    none, empty = np.empty(0, dtype=np.int64), np.empty(0)
    return LineModel(
        none, empty, none, none, empty, empty, np.ones(256), empty, none, none, none,
        empty, empty, "range",
        sensor.gate_m or 0.0, 0.0, sensor.beamlets, settings.interval_shots, 1,
        "stated" if sensor.gate_m else "assumed",
        (Finding("N01", {"kind": "none"}),),
    )  # fmt: skip


def _fired(
    merged: dict[str, NDArray[Any]], interval_shots: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Which shots were fired: silent intervals are put in, edges of the data cut off.

    ``interval``, ``rows``, ``first``, ``last``, each (k,): intervals, with those that chance can
    have left empty; row of ``merged`` for each, where a silent one repeats the one before it; first
    and last shot fired within it.
    """
    interval = merged["interval"]
    step = np.diff(interval)
    # Lengths of empty runs are geometric. A run that not one in a thousand such flightlines would
    # show is no chance: the laser was off, or points were cut out.
    empty = max(_empty_share(merged, step, interval_shots), 1e-300)
    longest = np.log(1e3 * len(interval)) / -np.log(empty) if empty < 1.0 else 0.0
    bridged = step - 1 <= longest
    repeat = np.ones(len(interval), dtype=np.int64)
    repeat[:-1] += np.where(bridged, step - 1, 0)
    rows = np.repeat(np.arange(len(interval)), repeat)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    starts_run = np.concatenate([[True], ~bridged])
    ends_run = np.concatenate([~bridged, [True]])
    first = np.where(starts_run, merged["first"], 0)[rows] * (within == 0)
    last = np.where(ends_run[rows], merged["last"][rows], interval_shots - 1)
    return interval[rows] + within, rows, first, last


def _empty_share(
    merged: dict[str, NDArray[Any]], step: NDArray[np.int64], interval_shots: int
) -> float:
    """Probability that chance leaves an interval without a return."""
    missing = 1.0 - float(np.mean(step == 1)) if len(step) else 0.0
    between = int(np.sum(merged["last"] - merged["first"]))
    if between == 0:
        return missing
    silent = max(1.0 - float(np.sum(merged["shots"] - 1)) / between, 0.0)
    return min(missing, silent**interval_shots)


def _moving(interval: NDArray[np.int64], value: NDArray[Any], half: int) -> NDArray[np.float64]:
    """Sum over the intervals within ``half`` of each: (m,) float64."""
    total = np.concatenate([[0], np.cumsum(value)])
    low = np.searchsorted(interval, interval - half, side="left")
    high = np.searchsorted(interval, interval + half, side="right")
    moved: NDArray[np.float64] = (total[high] - total[low]).astype(np.float64)
    return moved


def _smooth(
    interval: NDArray[np.int64],
    counted: NDArray[np.int64],
    exposure: NDArray[np.float64],
    half: int,
) -> NDArray[np.float64]:
    """Rate of each interval [1/m], shrunk towards that of its wider neighbourhood."""
    if exposure.sum() <= 1.0:  # a metre in all shows nothing
        return np.zeros(len(interval))
    total = (counted.sum() + 0.5) / exposure.sum()
    wide_n, wide_e = (_moving(interval, v, half) for v in (counted, exposure))
    wide = (wide_n + 1.0) / (wide_e + 1.0 / total)
    near = half // 8
    near_n, near_e = (_moving(interval, v, near) for v in (counted, exposure))
    block = interval // (2 * near + 1)
    starts = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    n = np.add.reduceat(counted, starts)
    weight = prior_weight(n, np.add.reduceat(wide * exposure, starts))
    rate: NDArray[np.float64] = (near_n + weight) / (near_e + weight / wide)
    return rate


def _seen_window(seen: NDArray[np.int64], fired: NDArray[np.int64], interval_shots: int) -> int:
    """Shots over which seen beamlets stand in for silent ones: a divisor of the interval.

    A window has :data:`~spl_batch.airborne.noise.line_statistics.SUPPORT` of them.
    """
    per_shot = float(seen.sum()) / float(fired.sum())
    for shots in range(1, interval_shots + 1):
        if interval_shots % shots == 0 and shots * per_shot >= SUPPORT:
            return shots
    return interval_shots


def line_density(table: PointTable, model: LineModel) -> NDArray[np.float64]:
    """Noise of each point's beamlet over ground of gain 1 [W17 Eq. 5.1]: (n,) float64 [1/m]."""
    density: NDArray[np.float64] = model.rate.take(model.row(table["shot"]))
    density *= model.gain.take(table["channel"])
    return density


def gate_of(
    table: PointTable, beams: BeamTable, model: LineModel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant ranges between which each point's beamlet was listened to: two (n,) float64 [m]."""
    row = model.row(table["shot"])
    near, far = model.near.take(row), model.far.take(row)
    if model.kind == "range":
        return near, far
    z = beams.origin_m[:, 2]
    cosine = np.maximum(-beams.direction[:, 2], 0.1)
    return (z - near) / cosine, (z - far) / cosine
