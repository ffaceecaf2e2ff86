"""Gains: how much of a flightline's noise each channel of the receiver hears.

Domain: time. Dead channels hear nothing. The gains of others are counted, and shrunk towards one as
far as chance explains their differences (empirical Bayes, gamma prior).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.findings import Finding
from spl_batch.errors import named

DOMAIN: Final = "time"


def active_channels(
    seen: NDArray[np.int64], beamlets: int
) -> tuple[int, NDArray[np.float64], tuple[Finding, ...]]:
    """Beamlets per shot, gains as far as live and dead channels decide them, and warnings.

    ``seen``: (256,), beamlets seen of each channel; ``beamlets``: per shot, that the sensor has.
    Gains, (256,), are 0 for dead channels, equal for all others; their mean is one.
    """
    live = seen > 0
    alive = int(live.sum())
    if alive > beamlets:
        least = np.argsort(np.where(live, seen, seen.max() + 1), kind="stable")[: alive - beamlets]
        values = {"kind": "more", "alive": alive, "beamlets": beamlets, "channels": least.tolist()}
        return alive, live.astype(np.float64), (Finding("I04", values, badness=alive),)
    if seen.sum() < 10 * beamlets or alive == beamlets:
        return beamlets, np.ones(256), ()
    gain = live.astype(np.float64) * (beamlets / alive)
    dead = beamlets - alive
    which = _dead(np.flatnonzero(live), beamlets)
    values = {"dead": dead, "beamlets": beamlets, "what": which}
    return beamlets, gain, (Finding("I07", values, badness=dead),)


def _dead(live: NDArray[np.int64], beamlets: int) -> str:
    """Channels without returns, as far as their neighbours show their numbers."""
    within = np.setdiff1d(np.arange(live[0], live[-1]), live).tolist()
    dead, ends = beamlets - len(live), f"below {live[0]} or above {live[-1]}"
    if not within:
        return f"{dead} {ends}"
    if len(within) > dead:
        return f"{dead} among {named(within)}"
    return named(within) + (f", and {dead - len(within)} {ends}" * (dead > len(within)))


def channel_gains(
    by_channel: NDArray[np.int64], active: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Gain of each channel, by its noise returns, with the mean of ``active``: (256,) float64."""
    # A live channel without noise returns was seen, not counted: it keeps its mean share.
    used = np.flatnonzero((active > 0) & (by_channel > 0))
    if len(used) == 0:
        return active
    n = by_channel[used].astype(np.float64)
    # Weak channels are different: only ordinary ones share a prior.
    usual = float(np.median(n))
    ordinary = np.abs(n - usual) <= 5.0 * np.sqrt(usual + 1.0)
    expected = float(n[ordinary].mean())
    weight = prior_weight(by_channel[used][ordinary], np.full(ordinary.sum(), expected))
    raw = np.where(ordinary, (n + weight) / (expected + weight), n / expected)
    gain = active.copy()
    gain[used] = raw * (active[used].sum() / raw.sum())
    return gain


def prior_weight(n: NDArray[Any], expected: NDArray[np.float64]) -> float:
    """Counts that a gamma prior is worth: 1 / relative variance beyond Poisson."""
    excess = float(np.sum((n - expected) ** 2 - expected))
    square = float(np.sum(expected**2))
    return square / excess if excess > 1e-9 * square > 0 else 1e9
