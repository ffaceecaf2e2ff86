"""Line noise density of each beamlet, rho_l [1/m].

Sources: [W17] Eq. 5.1, [W18] 2.2.1.

| symbol | name |
|---|---|
| N | ``outside``: noise returns of an interval |
| 6000 | shots fired x ``beamlets`` |
| R | slant length of gate that was counted |
| rho_l | ``rate`` x ``gain`` of the channel x ``ground`` of the cell that is looked at |

Deviations: silent shots count as fired; R is what the gate really leaves, as a slant length; the
buffer shrinks where the gate is short; the ground has a gain. Rates of intervals and gains of the
ground are shrunk towards their neighbours and gains of channels towards one (empirical Bayes, gamma
prior). Where the buffer has shrunk, intervals
far above those around hold signal, if their two sides differ or the signal's height varies as much
as the buffer; they are left out.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.background_region import choose_region, offered_lengths, profile_rate
from spl_batch.airborne.noise.gains import active_channels, channel_gains, ground, prior_weight
from spl_batch.airborne.noise.gate import fit_gate
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.noise.line_statistics import BUFFER_LADDER, merge, observe
from spl_batch.airborne.noise.noise_intervals import SUMMARY
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.engine.findings import Finding
from spl_batch.lattice.tables import BeamTable, PointTable

__all__ = ["LineModel", "fit", "gate_of", "line_density", "merge", "observe"]

DOMAIN: Final = "time"
COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "shot")
COLUMNS_ADDED: Final = ("line_density",)

SEEN_TARGET: Final = 15.0
"""Seen beamlets that a window of shots should have; exp(-15) of the windows are empty."""

RETURNS_MIN: Final = 20.0
"""Least seen beamlets per interval: with fewer, the median is one of the noise returns."""

CLIP_SIGMA: Final = 4.0
"""Poisson deviations above its neighbourhood from which on an interval's count holds signal."""

SIDES_SIGMA: Final = 3.0
"""Poisson deviations between an interval's counts above and below the signal, if one side holds
some: a brighter sky or ground adds to both alike."""

SPREAD: Final = 0.25
"""Standard deviation of an interval's signal height over the buffer, from which on there may be
signal beyond it on both sides: a fifteenth of the interval is then a buffer higher."""

CLIP_ROUNDS: Final = 5
"""Times that the neighbourhood is counted again without such intervals."""


def fit(
    merged: dict[str, NDArray[Any]],
    settings: NoiseSettings,
    sensor: Sensor,
) -> LineModel:
    """Line noise model of one flightline.

    Parameters
    ----------
    merged : dict
        Statistics of all its stretches, from :func:`merge`.
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
    use = {"both": [1.0, 1.0], "above": [1.0, 0.0], "below": [0.0, 1.0]}
    if region.side == "none":
        flat = profile_rate(merged["profile"], gate, summary, fired)
        rate, gain = np.full(len(interval), flat), gain_active
        cell, of_cell = np.empty(0, np.int64), np.empty(0)
    else:
        sides = np.array(use[region.side])
        counted = (outside[:, :, region.buffer] @ sides).astype(np.int64)
        exposure = fired * (length[:, :, region.buffer] @ sides)
        blinded = np.where(present, merged["blinded"][rows, :, region.buffer] @ sides, 0.0)
        heard = np.maximum(exposure - blinded, 0.0)
        if region.buffer > 0:
            buffer_m = settings.buffer_m * BUFFER_LADDER[region.buffer]
            sided = fired[:, None] * length[:, :, region.buffer]
            torn = _torn(outside[:, :, region.buffer], sided, summary, buffer_m)
            quiet = _quiet(interval, counted, heard, settings.smooth_intervals, torn)
            counted, heard = counted * quiet, heard * quiet
        rate = _smooth(interval, counted, heard, settings.smooth_intervals)
        cell, of_cell = ground(merged, interval, rate * heard, region.buffer, sides)
        by_channel = sides.astype(np.int64) @ merged["by_channel"][:, region.buffer]
        gain = channel_gains(by_channel, gain_active)
    seen = np.where(present, merged["beamlets"][rows], 0)
    # Where channels are not told apart, each return counts as a beamlet.
    looks = seen if beamlets > 1 else np.where(present, merged["returns"][rows], 0)
    return LineModel(
        interval=interval,
        rate=rate,
        first=first,
        last=last,
        near=gate.near,
        far=gate.far,
        gain=gain,
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
        findings=(*warnings, *gate.warnings, *region.warnings, *_few(merged), *_strays(merged)),
    )


def _strays(merged: dict[str, NDArray[Any]]) -> Iterator[Finding]:
    """Warn of returns that are far beyond the gate."""
    if count := int(merged["strays"][0]):
        yield Finding("N01", {"kind": "strays", "count": count}, badness=count)


def _few(merged: dict[str, NDArray[Any]]) -> tuple[Finding, ...]:
    """Warn of intervals with so few returns that noise is taken for signal."""
    per_interval = float(merged["beamlets"].mean())
    if per_interval >= RETURNS_MIN:
        return ()
    values = {
        "kind": "few", "per_interval": per_interval, "low": 1.0 / max(per_interval, 1.0)
    }  # fmt: skip
    return (Finding("N01", values, badness=-per_interval),)


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
    total = (counted.sum() + 0.5) / max(exposure.sum(), 1.0)
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


def _quiet(
    interval: NDArray[np.int64],
    counted: NDArray[np.int64],
    exposure: NDArray[np.float64],
    half: int,
    torn: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Intervals whose count can be background alone: (m,) bool.

    A shrunk buffer is lower than towers are tall: where an interval sees roof and ground, one of
    them lies in its noise region. Signal only adds.
    """
    quiet = np.ones(len(interval), dtype=np.bool_)
    for _ in range(CLIP_ROUNDS):
        near_n, near_e = (_moving(interval, v * quiet, half) for v in (counted, exposure))
        expected = near_n / np.maximum(near_e, 1.0) * exposure
        quiet = ~torn | (counted <= expected + CLIP_SIGMA * np.sqrt(expected + 1.0))
    return quiet


def _torn(
    counted: NDArray[np.integer[Any]],
    exposure: NDArray[np.float64],
    summary: NDArray[np.float64],
    buffer_m: float,
) -> NDArray[np.bool_]:
    """Intervals in which there may be signal beyond the buffer: (m,) bool.

    ``counted``, ``exposure``: (m, 2), noise returns above and below the signal, and the length that
    was listened to there, over all beamlets [m].
    """
    # One side may hear more all along, as where returns blind what is behind them.
    usual = counted.sum(axis=0) / np.maximum(exposure.sum(axis=0), 1.0)
    (up, down), (e_up, e_down) = counted.T.astype(np.float64), (exposure * usual).T
    # With one sky, up e_down - down e_up is 0 but for chance, with this variance.
    chance = (up + down) * e_up * e_down
    differ = np.abs(up * e_down - down * e_up) > SIDES_SIGMA * np.sqrt(chance)
    torn: NDArray[np.bool_] = differ | (summary[:, SUMMARY.index("signal_sd")] > SPREAD * buffer_m)
    return torn


def _seen_window(seen: NDArray[np.int64], fired: NDArray[np.int64], interval_shots: int) -> int:
    """Shots over which seen beamlets stand in for silent ones: a divisor of the interval."""
    per_shot = float(seen.sum()) / float(fired.sum())
    for shots in range(1, interval_shots + 1):
        if interval_shots % shots == 0 and shots * per_shot >= SEEN_TARGET:
            return shots
    return interval_shots


def line_density(table: PointTable, model: LineModel) -> NDArray[np.float64]:
    """Noise of each point's beamlet over ground of gain 1 [W17 Eq. 5.1]: (n,) float64 [1/m]."""
    density = model.at(model.row(table["shot"]), model.rate, model.mean_rate)
    density *= model.gain.take(table["channel"])
    return density


def gate_of(
    table: PointTable, beams: BeamTable, model: LineModel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant ranges between which each point's beamlet was listened to: two (n,) float64 [m]."""
    row = model.row(table["shot"])
    near, far = model.at(row, model.near, 0.0), model.at(row, model.far, 0.0)
    if model.kind == "range":
        return near, far
    z = beams.origin_m[:, 2]
    cosine = np.maximum(-beams.direction[:, 2], 0.1)
    return (z - near) / cosine, (z - far) / cosine
