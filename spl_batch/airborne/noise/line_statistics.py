"""Statistics of line noise: the first pass, which adds up over stretches.

Source: [W17] 5.2.1. Everything is keyed on absolute interval numbers, ``shot // interval_shots``,
or is an integer count, so parts merge in any order.

Deviations: because of relief, the peak is sought in pieces of an interval as short as its returns
allow, in a sliding window instead of 1 m bins. Several buffers are counted side by side: how much
the gate leaves is known only at the end. A return that follows another of its own beamlet within
:data:`LAG_M` may be its afterpulse and is not counted; the length that returns blind is taken off
the exposure. It counts where this would blind more than half of the gate, as where much noise comes
without channel numbers.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import LAG_M
from spl_batch.airborne.beams.shot_runs import blind_behind, lag_behind, run_starts
from spl_batch.airborne.noise.ground_cells import look_through, signal_of
from spl_batch.airborne.noise.noise_intervals import count_noise, far_beyond
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointTable, rows_of

BUFFER_LADDER: Final = (1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Buffers that are counted, as shares of ``noise.buffer_m``. Half and twice move 699 + 54 and 248 +
33 labels."""

HALF: Final = BUFFER_LADDER.index(0.5)
"""Rung of half the widest buffer: only a third of a gate of 150 m lies beyond the widest one."""

SUPPORT: Final = 20
"""Returns that a rate, a spacing or the end of a gate is believed by: chance leaves an error of a
fifth [count]."""

LONE_SPACINGS: Final = 12.0
"""What is no end of a gate lies farther beyond the next return than so many mean spacings of the
noise on its side: fewer than six of a million ends of uniform noise do [count]. Half moves 49 + 0
labels, twice nothing."""

STRAY_SHARE: Final = 0.1
"""Share of the noise on a side of the signal that may lie beyond the gate. Half moves nothing,
twice 6 + 0 labels."""

LONE_MOST: Final = int(STRAY_SHARE * SUPPORT)
"""That share of the least noise that shows its spacing: so many returns of an interval, or
intervals of a window, may be no end of the gate, however little noise there is [count]."""

_BY_INTERVAL: Final = (
    "interval", "summary", "outside", "blinded", "returns", "beamlets", "shots", "first", "last",
    "groups", "looks",
)  # fmt: skip

_WITHIN: Final = (
    ("groups", ("signal",)), ("looks", ("look_cell", "look_number", "look_outside")),
)  # fmt: skip
"""What each interval has several of, by the column that has their number."""


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
        within the interval; ``signal``, heights of its ``groups`` (m,); ``look_cell``,
        ``look_number`` and ``look_outside`` of its ``looks`` (m,) at cells of the ground;
        ``by_channel`` (2, b, 256), ``seen_channel`` (256,) and ``strays`` (1,) int64, left out as
        none of the gate.
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
    lag_behind(beamlet, beams.range_m, 0.0, LAG_M, lag)
    blind_behind(beamlet, beams.range_m, LAG_M, blind)
    crowded = _crowded(beamlet, starts, beams.range_m, blind)
    lag[crowded], blind[crowded] = 0.0, 0.0
    look, looks = look_through(table, beams, seen)
    out: dict[str, NDArray[Any]] = {
        "interval": np.floor_divide(shot[starts[:-1]], settings.interval_shots),
        "summary": seen.summary,
        "blinded": np.zeros((m, 2, b)),
        "returns": np.diff(starts),
        "by_channel": np.zeros((2, b, 256), dtype=np.int64),
        "seen_channel": np.bincount(channel[beamlet[:-1]], minlength=256).astype(np.int64),
        "beamlets": _runs_per_interval(beamlet, starts),
        "shots": _runs_per_interval(run_starts(time), starts),
        "first": offset[starts[:-1]],
        "last": offset[starts[1:] - 1] if m else offset[:0],
        "groups": seen.groups,
        "signal": seen.height,
        **looks,
        "look_outside": np.zeros((len(looks["look_cell"]), 2, b), dtype=np.int32),
        "strays": np.zeros(1, dtype=np.int64),
    }
    count_noise(
        starts, seen.below, np.maximum(-beams.direction[:, 2], 0.1), channel, look,
        lag == 0, blind, settings.buffer_m * np.array(BUFFER_LADDER), out["look_outside"],
        out["blinded"], out["by_channel"],
    )  # fmt: skip
    first = np.cumsum(looks["looks"]) - looks["looks"]
    out["outside"] = np.add.reduceat(out["look_outside"], first) if m else out["look_outside"]
    gone = np.zeros(len(table), np.bool_)
    out["strays"][0] = far_beyond(
        starts, table["z"][seen.order] * QUANTUM_M, seen.summary[:, 0], out["outside"][:, :, HALF],
        settings.buffer_m * BUFFER_LADDER[HALF], (SUPPORT, LONE_MOST, STRAY_SHARE, LONE_SPACINGS),
        gate_m or np.inf, gone,
    )  # fmt: skip
    lone[np.flatnonzero(chosen)[seen.order[gone]]] = True
    return out, lone


def _crowded(
    beamlet: NDArray[np.int64],
    starts: NDArray[np.int64],
    range_m: NDArray[np.float64],
    blind_m: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Returns of intervals whose followers blind most of their own gate: (n,) bool.

    What is left is the difference of two large lengths, and may be nothing: there they count too.
    """
    if len(starts) < 2:
        return np.zeros(len(range_m), dtype=np.bool_)
    first = starts[:-1]
    gate_m = np.maximum.reduceat(range_m, first) - np.minimum.reduceat(range_m, first)
    heard_m = gate_m * _runs_per_interval(beamlet, starts)
    blinded_m = np.add.reduceat(blind_m, first)
    crowded = blinded_m > heard_m - blinded_m
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
    for number, names in _WITHIN:
        of = np.repeat(interval, np.concatenate([p[number] for p in parts]))
        of = np.argsort(of, kind="stable")
        merged |= {k: np.concatenate([p[k] for p in parts])[of] for k in names}
    for name in ("by_channel", "seen_channel", "strays"):
        merged[name] = np.sum([p[name] for p in parts], axis=0)
    return merged
