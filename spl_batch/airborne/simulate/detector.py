"""A single-photon channel: Poisson events, dead time, afterpulses [W17 2.1, 2.2, 7.1].

One beamlet of one shot is a list of photo-electrons sorted by range. The channel records the first,
is blind for the dead time, records the next, and so on (multi-stop). After the dead time every
recorded detection may start an afterpulse in the same channel, and that another. Lags follow an
exponential law, a share of them a tail: a longer exponential, or a power law.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.ray_trace import KIND_AFTERPULSE, KIND_BACKGROUND
from spl_batch.numerics.compiled import njit

NO_PARENT: Final = int(np.iinfo(np.uint8).max)
"""Value of ``parent`` for returns that are no afterpulse."""


class Receiver(NamedTuple):
    """How a channel detects; lengths are slant range."""

    dead_m: float
    afterpulse_probability: float  #: Afterpulses started per recorded detection.
    afterpulse_scale_m: float  #: Scale of the exponential lag behind the dead time [m].
    afterpulse_max_m: float  #: Longest lag behind the parent [m], > ``dead_m``.
    tail_share: float = 0.0  #: Part of the afterpulses whose lag follows the tail, 0..1.
    tail_scale_m: float = 1.0  #: Scale of the tail behind the dead time [m].
    #: The tail's density falls as (1 + lag / scale) ** -power, > 1; 0 for an exponential.
    tail_power: float = 0.0


@njit()
def poisson_count(rng: np.random.Generator, mean: float) -> int:
    """Poisson number: how many unit-rate exponential gaps fit into ``mean`` [W17 Eq. 2.6]."""
    total, count = -math.log(1.0 - rng.random()), 0
    while total <= mean:
        count += 1
        total -= math.log(1.0 - rng.random())
    return count


@njit()
def truncated_exponential(rng: np.random.Generator, scale: float, longest: float) -> float:
    """Exponential number that does not pass ``longest``, by inversion."""
    return -scale * math.log(1.0 - rng.random() * -math.expm1(-longest / scale))


@njit()
def truncated_power(
    rng: np.random.Generator, scale: float, power: float, longest: float
) -> float:  # fmt: skip
    """Number of density (1 + x / scale) ** -power that does not pass ``longest``, by inversion."""
    rest = (1.0 + longest / scale) ** (1.0 - power)
    left = 1.0 - rng.random() * (1.0 - rest)
    return float(scale * (left ** (1.0 / (1.0 - power)) - 1.0))


@njit()
def draw_lag(rng: np.random.Generator, receiver: Receiver) -> float:
    """Lag of an afterpulse behind its parent [m]."""
    window = receiver.afterpulse_max_m - receiver.dead_m
    if receiver.tail_share > 0.0 and rng.random() < receiver.tail_share:
        if receiver.tail_power > 0.0:
            behind = truncated_power(rng, receiver.tail_scale_m, receiver.tail_power, window)
        else:
            behind = truncated_exponential(rng, receiver.tail_scale_m, window)
    else:
        behind = truncated_exponential(rng, receiver.afterpulse_scale_m, window)
    return receiver.dead_m + behind


@njit()
def add_event(
    ranges: NDArray[np.float64],
    facts: NDArray[np.int64],
    n: int,
    at: float,
    kind: int,
    parent: int,
    source: int,
) -> int:
    """Put an event in its place by range; the number of events afterwards.

    ``ranges`` (k,): those of the events, ascending [m]; ``facts`` (k, 3): kind, kind of the surface
    behind an afterpulse, recorded number of its parent (-1).
    """
    if n >= len(ranges):
        raise ValueError("more photo-electrons in one beamlet than there is room for")
    k = n
    while k > 0 and ranges[k - 1] > at:
        ranges[k] = ranges[k - 1]
        facts[k] = facts[k - 1]
        k -= 1
    ranges[k] = at
    facts[k, 0] = kind
    facts[k, 1] = parent
    facts[k, 2] = source
    return n + 1


@njit()
def record(
    rng: np.random.Generator,
    ranges: NDArray[np.float64],
    facts: NDArray[np.int64],
    n: int,
    stop_m: float,
    receiver: Receiver,
    kept: NDArray[np.int64],
    electrons: NDArray[np.int64],
) -> int:
    """Which events a channel records, how many; afterpulses are added as they start.

    ``kept`` and ``electrons`` (k,) are filled with the index of each and its number of
    photo-electrons: itself and those that fell into its dead time.
    """
    count, blind_until = 0, -np.inf
    e = 0
    while e < n:
        at = ranges[e]
        if at > stop_m:
            break
        if at < blind_until:
            electrons[count - 1] += 1
        else:
            kept[count] = e
            electrons[count] = 1
            blind_until = at + receiver.dead_m
            if rng.random() < receiver.afterpulse_probability:
                lag = draw_lag(rng, receiver)
                surface = facts[e, 1] if facts[e, 0] == KIND_AFTERPULSE else facts[e, 0]
                n = add_event(ranges, facts, n, at + lag, KIND_AFTERPULSE, surface, count)
            count += 1
        e += 1
    return count


@njit()
def add_background(
    rng: np.random.Generator,
    ranges: NDArray[np.float64],
    facts: NDArray[np.int64],
    gate: tuple[float, float],
    per_m: float,
    fall: float = 0.0,
) -> int:
    """First events of a beamlet: background, a Poisson process along the gate; how many.

    ``fall``: rate at the start less that at the end, over their sum, -1..1, linear between; it is
    drawn by thinning. ``per_m`` is the mean [1/m].
    """
    start, stop = gate
    n, most = 0, per_m * (1.0 + abs(fall))
    if most <= 0.0:
        return n
    at = start - math.log(1.0 - rng.random()) / most
    while at < stop:
        rate = per_m * (1.0 + fall * (1.0 - 2.0 * (at - start) / (stop - start)))
        if fall == 0.0 or rng.random() * most < rate:
            n = add_event(ranges, facts, n, at, KIND_BACKGROUND, NO_PARENT, -1)
        at -= math.log(1.0 - rng.random()) / most
    return n
