"""Noise region of a flightline: the part of the gate that holds background only.

Source: [W17] 5.2.1: the gate less +-50 m around the peak of the heights.

Deviations: the buffer is the largest of a ladder that leaves a fifth of the gate. Where the two
sides of the signal disagree, the one that signal reaches into is left out. Where nothing is left,
the uniform part of the gate's histogram is fitted.
"""

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from spl_batch.airborne.noise.gate import Gate
from spl_batch.airborne.noise.line_statistics import BUFFER_LADDER, PROFILE_BINS
from spl_batch.airborne.noise.noise_intervals import SUMMARY
from spl_batch.engine.findings import Finding

REGION_MIN: Final = 0.2
"""Least share of the gate in a noise region."""

Side = Literal["both", "above", "below", "none"]


class Region(NamedTuple):
    """Buffer and sides of the signal that are counted."""

    buffer: int
    side: Side
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
    above, below = _around_signal(gate, column)
    both = np.stack([above[:, None] - buffers, below[:, None] - buffers], axis=1)
    spread = np.maximum(column["signal_sd"] / column["cosine"], 1e-6)[:, None, None]
    ratio = both / spread
    density = np.exp(-0.5 * np.minimum(ratio**2, 1400.0)) / np.sqrt(2 * np.pi)
    length: NDArray[np.float64] = both * ndtr(ratio) + spread * density
    return np.maximum(length, 0.0)


def _around_signal(
    gate: Gate, column: dict[str, NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant length of gate in front of and behind the signal: two (m,) float64 [m]."""
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
    above, below = _around_signal(gate, dict(zip(SUMMARY, summary.T, strict=True)))
    whole = float(np.sum(fired * np.maximum(above + below, 0.0)))
    wide = np.flatnonzero(offered.sum(axis=0) >= REGION_MIN * whole)
    if whole <= 0 or len(wide) == 0:
        return Region(0, "none", (_NO_REGION,))
    b = int(wide[0])
    notes = () if b == 0 else (_short(BUFFER_LADDER[b]),)
    (n_up, n_down), (e_up, e_down) = counts[:, b], offered[:, b]
    if min(e_up, e_down) < 0.25 * REGION_MIN * whole:
        return Region(b, "both", notes)
    up, down = n_up / e_up, n_down / e_down
    spread = np.sqrt((n_up + 1) / e_up**2 + (n_down + 1) / e_down**2)
    if abs(up - down) <= max(0.15 * min(up, down), 5 * spread):
        return Region(b, "both", notes)
    side: Side = "below" if up > down else "above"
    more, times = ("above", up / down) if up > down else ("below", down / up)
    values = {"kind": "side", "times": float(times), "more": more, "side": side}
    return Region(b, side, (*notes, Finding("N01", values, badness=float(times))))


def _short(share: float) -> Finding:
    """The part of the gate taken for signal had to shrink to this share."""
    return Finding("N01", {"kind": "short", "share": share}, badness=-share)


_NO_REGION: Final = Finding("N01", {"kind": "fitted"})


def profile_rate(
    profile: NDArray[np.int64],
    gate: Gate,
    summary: NDArray[np.float64],
    fired: NDArray[np.float64],
) -> float:
    """Uniform part of the histogram of heights around the signal [1/m].

    Signal only adds: the lower quartile of the bins' rates is background wherever signal fills less
    than three quarters of the gate.
    """
    column = dict(zip(SUMMARY, summary.T, strict=True))
    above, below = _around_signal(gate, column)
    cosine, half = column["cosine"], PROFILE_BINS // 2
    edges = np.clip(np.stack([-above * cosine, below * cosine]) + half, 0, PROFILE_BINS - 1)
    step = np.zeros(PROFILE_BINS)
    np.add.at(step, np.ceil(edges[0]).astype(np.int64), fired / cosine)
    np.add.at(step, np.maximum(np.floor(edges[1]), np.ceil(edges[0])).astype(np.int64),
              -fired / cosine)  # fmt: skip
    exposure = np.cumsum(step)
    use = exposure > 0.5 * exposure.max()
    if not use.any():
        return 0.0
    return float(np.quantile(profile[use] / exposure[use], 0.25))
