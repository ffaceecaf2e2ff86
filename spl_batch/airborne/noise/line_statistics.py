"""Statistics of line noise: the first pass, which adds up over stretches.

Source: [W17] 5.2.1. Everything is keyed on absolute interval numbers, ``shot // interval_shots``,
or is an integer count, so parts merge in any order.

Deviations: because of relief, the peak is sought in pieces of an interval as short as its returns
allow, in a sliding window instead of 1 m bins. Several buffers are counted side by side: how much
the gate leaves is known only at the end. A return that follows another of its own beamlet within
:data:`FOLLOWER_M` may be its afterpulse and is not counted; the length that returns blind is taken
off the exposure. It counts where this would blind more than half of the gate, as where much noise
comes without channel numbers.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import blind_behind, lag_behind, run_starts
from spl_batch.airborne.noise.ground_cells import look_through, signal_of
from spl_batch.airborne.noise.noise_intervals import count_noise
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointTable, rows_of

BUFFER_LADDER: Final = (1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Buffers that are counted, as shares of ``noise.buffer_m``."""

FOLLOWER_M: Final = 5.0
"""Reach of afterpulses; [W17] ch. 7 finds nearly all within 2-3 m [m]."""

BLIND_MOST: Final = 0.5
"""Blinded share of an interval's gate from which on followers count as noise too: what is left is
the difference of two large lengths, and may be nothing."""

PROFILE_BINS: Final = 2048
"""1 m bins of the histogram of heights below the signal."""

SUPPORT: Final = 20
"""Returns away from the surface from which on a window tells where its gate ends [count]."""

LONE_MOST: Final = 2
"""Returns of an interval, or intervals of a window, that may be no end of the gate [count]."""

LONE_SPACINGS: Final = 12.0
"""They lie farther beyond the next one than so many mean spacings, both of the noise on their side
and of the extremes that follow: fewer than six of a million ends of uniform noise do [count]."""

STRAY_SHARE: Final = 0.1
"""Share of the noise on a side of the signal that may lie beyond the gate."""

LONE_GAPS: Final = (3, 8)
"""Gaps between the extremes that follow which tell their spacing, at least and at most [count]."""

_BY_INTERVAL: Final = (
    "interval", "summary", "outside", "blinded", "returns", "beamlets", "shots", "first", "last",
)  # fmt: skip

_BY_LOOK: Final = ("look_interval", "look_cell", "look_number", "look_outside")


def observe(
    table: PointTable, beams: BeamTable, settings: NoiseSettings, gate_m: float | None = None
) -> dict[str, NDArray[Any]]:
    """Statistics of one stretch.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...).
    beams : BeamTable
        Their beams; rows without a known beam take no part.
    gate_m : float, optional
        Slant length of the gate where it is stated [m].

    Returns
    -------
    dict
        ``interval`` (m,) int64; ``summary`` (m, 10) float64, see :data:`SUMMARY`;
        ``outside`` (m, 2, b) int32, noise returns above and below each buffer, and
        ``blinded`` (m, 2, b) float64 [m], the length in which none would have counted;
        ``returns``, ``beamlets``, ``shots`` (m,) int64 seen; ``first``, ``last`` (m,) int64, shots
        within the interval; ``by_channel`` (2, b, 256), ``seen_channel`` (256,) and
        ``profile`` (:data:`PROFILE_BINS`,) and ``strays`` (1,) int64, left out as none of the gate.
    """
    found, lone = _observed(table, beams, settings, beams.known, gate_m)
    if not lone.any():
        return found
    rest, _ = _observed(table, beams, settings, beams.known & ~lone, gate_m)
    return {**rest, "strays": found["strays"]}


def _observed(
    table: PointTable,
    beams: BeamTable,
    settings: NoiseSettings,
    chosen: NDArray[np.bool_],
    gate_m: float | None,
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    """Statistics of some rows, (n,) bool, and which of these are far beyond their interval."""
    rows, lone = rows_of(chosen), np.zeros(len(chosen), np.bool_)
    table, beams = table.take(rows), beams.take(rows)
    shot, time, channel = table["shot"], table["gps_time"], table["channel"]
    offset = shot - np.floor_divide(shot, settings.interval_shots) * settings.interval_shots
    beamlet = run_starts(time, channel)
    seen = signal_of(table, beams, settings)
    starts = seen.starts
    m, b = len(starts) - 1, len(BUFFER_LADDER)
    lag = np.empty(len(table), dtype=np.float32)
    blind = np.empty(len(table), dtype=np.float64)
    lag_behind(beamlet, beams.range_m, 0.0, FOLLOWER_M, lag)
    blind_behind(beamlet, beams.range_m, FOLLOWER_M, blind)
    crowded = _crowded(beamlet, starts, beams.range_m, blind)
    lag[crowded], blind[crowded] = 0.0, 0.0
    looks = look_through(table, beams, seen)
    out: dict[str, NDArray[Any]] = {
        "interval": np.floor_divide(shot[starts[:-1]], settings.interval_shots),
        "summary": seen.summary,
        "blinded": np.zeros((m, 2, b)),
        "returns": np.diff(starts),
        "by_channel": np.zeros((2, b, 256), dtype=np.int64),
        "profile": np.zeros(PROFILE_BINS, dtype=np.int64),
        "seen_channel": np.bincount(channel[beamlet[:-1]], minlength=256).astype(np.int64),
        "beamlets": _runs_per_interval(beamlet, starts),
        "shots": _runs_per_interval(run_starts(time), starts),
        "first": offset[starts[:-1]],
        "last": offset[starts[1:] - 1] if m else offset[:0],
        "look_cell": looks.cell,
        "look_number": looks.number,
        "look_outside": np.zeros((len(looks.cell), 2, b), dtype=np.int32),
    }
    count_noise(
        starts, seen.below, np.maximum(-beams.direction[:, 2], 0.1), channel, looks.row,
        lag == 0, blind, settings.buffer_m * np.array(BUFFER_LADDER), out["look_outside"],
        out["blinded"], out["by_channel"], out["profile"],
    )  # fmt: skip
    look_starts = np.searchsorted(looks.first, starts[:-1])
    out["look_interval"] = np.repeat(
        out["interval"], np.diff(np.append(look_starts, len(looks.cell)))
    )
    out["outside"] = np.add.reduceat(out["look_outside"], look_starts) if m else out["look_outside"]
    order = seen.order
    far = _far_beyond(
        table["z"][order] * QUANTUM_M, starts, out["outside"][:, :, 3],
        settings.buffer_m * BUFFER_LADDER[3],
    )  # fmt: skip
    stray = _behind_gaps(
        table["z"][order] * QUANTUM_M, starts, out["outside"][:, :, 3], out["summary"][:, 0],
        settings.buffer_m * BUFFER_LADDER[3], gate_m or np.inf,
    )  # fmt: skip
    out["strays"] = np.array([len(stray)])
    lone[np.flatnonzero(chosen)[order[np.append(far, stray)]]] = True
    return out, lone


def _behind_gaps(
    z: NDArray[np.float64],
    starts: NDArray[np.int64],
    noise: NDArray[np.int32],
    signal_z: NDArray[np.float64],
    half_m: float,
    gate_m: float,
) -> NDArray[np.intp]:
    """Returns that noise within a gate does not reach, few of it: as of :func:`_far_beyond`.

    Those which are more than :data:`LONE_MOST`, up to :data:`STRAY_SHARE`, and behind the widest
    gap of their interval, where this is one of more than :data:`LONE_SPACINGS`. However many they
    are where they lie farther from the signal than the gate that is stated is long.
    """
    n = len(z)
    above = _above_gaps(z, starts, noise[:, 0], signal_z + half_m, gate_m)
    flipped = _above_gaps(
        -z[::-1], n - starts[::-1], noise[::-1, 1], half_m - signal_z[::-1], gate_m
    )
    return np.append(above, n - 1 - flipped)


def _above_gaps(
    z: NDArray[np.float64],
    starts: NDArray[np.int64],
    noise: NDArray[np.int32],
    from_m: NDArray[np.float64],
    gate_m: float,
) -> NDArray[np.intp]:
    """Those of one side, whose ``noise`` lies above ``from_m``, (m,)."""
    if not len(noise):
        return np.zeros(0, np.intp)
    size = np.diff(starts)
    gap = np.diff(z, prepend=z[0])
    gap[starts[:-1]] = 0.0
    gap[z <= np.repeat(from_m, size)] = 0.0
    widest = np.maximum.reduceat(gap, starts[:-1])
    at = np.flatnonzero(gap == np.repeat(widest, size))
    at = at[np.searchsorted(at, starts[:-1])]
    beyond = starts[1:] - at
    within = noise - beyond
    spacing = (z[at - 1] - from_m) / np.maximum(within, 1)
    # The widest of many gaps of uniform noise is wider than any one of them by their logarithm.
    chance = np.log(np.maximum(STRAY_SHARE * within, 1.0))
    stray = (widest > (LONE_SPACINGS + chance) * spacing) & (within >= SUPPORT) & (spacing > 0)
    few = (beyond <= STRAY_SHARE * within) | (z[at] - from_m > gate_m)
    stray &= (beyond > LONE_MOST) & few
    found: NDArray[np.intp] = np.flatnonzero(
        np.arange(len(z)) >= np.repeat(np.where(stray, at, starts[1:]), size)
    )
    return found


def _far_beyond(
    z: NDArray[np.float64], starts: NDArray[np.int64], noise: NDArray[np.int32], half_m: float
) -> NDArray[np.intp]:
    """Which returns lie alone, far above or below all others of their interval.

    Parameters
    ----------
    z : (n,) float64
        Heights by interval, rising in each [m].
    starts : (m + 1,) int64
        Where intervals start, then n.
    noise : (m, 2) int32
        Returns more than ``half_m`` above and below the signal [count].
    """
    rank = np.arange(1 + LONE_MOST + LONE_GAPS[1])
    known = rank < np.diff(starts)[:, None]
    from_below, from_above = starts[:-1, None] + rank, starts[1:, None] - 1 - rank
    lowest = np.where(known, z[np.where(known, from_below, 0)], np.nan)
    highest = np.where(known, z[np.where(known, from_above, 0)], np.nan)
    within = highest[:, LONE_MOST] - lowest[:, LONE_MOST]
    above, below = (np.where(side >= SUPPORT, spacing_m(within, side, half_m), np.nan)
                    for side in noise.T)  # fmt: skip
    longer = np.full(lowest.shape, np.inf)
    low, high = without_lone(lowest, longer, below), -without_lone(-highest, longer, above)
    # Those alone are among the outermost.
    under, over = lowest < low[:, None], highest > high[:, None]
    return np.concatenate([from_below[under], from_above[over]])


def spacing_m(
    extent: NDArray[np.float64], noise: NDArray[np.int64], half_m: float
) -> NDArray[np.float64]:
    """Mean spacing of the noise of each window, by the returns farther than half_m from the signal.

    ``extent``: (w,) [m]; NaN where it is not known.
    """
    density = noise / np.maximum(extent - 2 * half_m, 0.2 * np.maximum(extent, 1.0))
    return 1.0 / np.maximum(density, 1e-9)


def without_lone(
    ends: NDArray[np.float64], longer: NDArray[np.float64], spacing: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Lowest value of each window that is not far below all others: (w,).

    Where the gate of an interval lies elsewhere as a whole, the interval is no longer for that.

    Parameters
    ----------
    ends : (w, k) float64
        Lowest values of each window, rising; NaN where there are no more [m].
    longer : (w, k) float64
        By how much the intervals that they are of are longer than the window without them [m].
    spacing : (w,) float64
        Mean spacing of the noise [m]; NaN where too little tells it.
    """
    gap, out = np.diff(ends, axis=1), ends[:, 0]
    least, most = LONE_GAPS
    for lone in range(1, LONE_MOST + 1):
        follow = gap[:, lone : lone + most]
        known = np.count_nonzero(~np.isnan(follow), axis=1)
        mean = np.nansum(follow, axis=1) / np.maximum(known, 1)
        far = gap[:, lone - 1] > LONE_SPACINGS * np.maximum(spacing, mean)
        far &= (longer[:, :lone] > 0.5 * gap[:, lone - 1 : lone]).all(axis=1)
        out = np.where(far & (known >= least), ends[:, lone], out)
    return out


def _crowded(
    beamlet: NDArray[np.int64],
    starts: NDArray[np.int64],
    range_m: NDArray[np.float64],
    blind_m: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Returns of intervals whose followers blind too much of their own gate: (n,) bool."""
    if len(starts) < 2:
        return np.zeros(len(range_m), dtype=np.bool_)
    first = starts[:-1]
    gate_m = np.maximum.reduceat(range_m, first) - np.minimum.reduceat(range_m, first)
    heard_m = gate_m * _runs_per_interval(beamlet, starts)
    crowded = np.add.reduceat(blind_m, first) > BLIND_MOST * heard_m
    found: NDArray[np.bool_] = np.repeat(crowded, np.diff(starts))
    return found


def _runs_per_interval(runs: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Runs that begin in each interval; none spans two: (m,) int64."""
    count: NDArray[np.int64] = np.diff(np.searchsorted(runs, starts)).astype(np.int64)
    return count


def merge(
    parts: Sequence[dict[str, NDArray[Any]]],
) -> dict[str, NDArray[Any]]:
    """Join the statistics of a flightline's stretches, in any order.

    ``parts``: results of :func:`observe` or of :func:`merge`, one at least.

    Raises
    ------
    ValueError
        If an interval is in two parts: a stretch was not cut between intervals.
    """
    interval = np.concatenate([p["interval"] for p in parts])
    order = np.argsort(interval, kind="stable")
    if np.any(np.diff(interval[order]) == 0):
        raise ValueError("stretches of a flightline share an interval of shots")
    merged = {k: np.concatenate([p[k] for p in parts])[order] for k in _BY_INTERVAL}
    of_look = np.argsort(np.concatenate([p["look_interval"] for p in parts]), kind="stable")
    merged |= {k: np.concatenate([p[k] for p in parts])[of_look] for k in _BY_LOOK}
    for name in ("by_channel", "seen_channel", "profile", "strays"):
        merged[name] = np.sum([p[name] for p in parts], axis=0)
    return merged
