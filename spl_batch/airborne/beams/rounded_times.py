"""Steps between shots whose times were rounded to a unit that is coarse against the pulse period.

Rounded so, one period takes two steps, a unit apart, and each as often as keeps the rhythm: their
mean over many shots is the period. Silent shots make longer steps, which are left out; of shots
less than a unit and a half apart, though, two periods may be as short as one. A clock that is exact
and has silent shots makes such steps too, but at random: sums of many of them scatter. So do those
of two rates. Our own rule: no source has one.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

AT_ONCE: Final = 64
"""Steps of one sum [count]."""

BLOCKS: Final = 8
"""Sums that tell whether steps keep a rhythm, at least [count]."""

RARE: Final = 0.002
"""Part of all steps that a length must have to count, 0..1: a clock may stumble."""

ON_UNITS: Final = 0.9
"""Part of all steps that are multiples of the unit, at least, 0..1."""

OFF_UNIT: Final = 0.1
"""What a length may be off a multiple of the unit [units]."""

NEAR_UNIT: Final = 0.4
"""The same where the unit is not known well yet [units]."""

RHYTHM: Final = 0.75
"""Sums of steps that keep a rhythm scatter by less than this part of random ones' variance."""

SURELY: Final = 0.5
"""The same where an exact clock with silent shots makes such steps at random."""

CHANCE: Final = 2.0
"""So many standard deviations the variance of random sums stays above that; twice as many where an
exact clock makes them."""

TICK_S: Final = 1e-7
"""Units are whole multiples of this [s]."""

OFF_TICK: Final = 0.02
"""What a time may be off a multiple of the unit, beside its own resolution [units]."""

UNSURE: Final = 0.01
"""A period that may be off by a larger part than this is not told, 0..1."""


def evened(
    step: NDArray[np.int64], apart: int, time_s: NDArray[np.float64], bin_s: float
) -> NDArray[np.int64]:
    """Steps between shots; if times are rounded, those of one period as their mean.

    Parameters
    ----------
    step : (n,) int64
        Steps between consecutive shots, in the order of time [bins].
    apart : int
        Lengths that are no farther apart than this are one [bins].
    time_s : (k,) float64
        Times that the steps lie between [s]; rounded ones are multiples of the unit.
    bin_s : float
        A bin [s].

    Returns
    -------
    (m,) int64
        The same steps where times are not coarse, or too few to tell; none where they are, but the
        period cannot be told.
    """
    found = _unit(step, apart)
    if found is None or not _on_ticks(time_s, found[0] * bin_s):
        return step
    unit, least = found
    units = np.rint(step / unit).astype(np.int64)
    count = np.bincount(units, minlength=least + 3)
    single = (units == least) | (units == least + 1)
    blocks = np.count_nonzero(single) // AT_ONCE
    if blocks < BLOCKS:
        return step
    longer = (units[single][: blocks * AT_ONCE] - least).reshape(blocks, AT_ONCE).sum(axis=1)
    part = longer.mean() / AT_ONCE
    random = AT_ONCE * part * (1.0 - part)
    if random < 1.0:
        return step
    spread = CHANCE * np.sqrt((2.0 + 1.0 / random) / blocks)
    regular = min(RHYTHM, 1.0 - spread)
    if least == 1 and part < 0.5:
        regular = min(SURELY, 1.0 - 2.0 * spread)
    if longer.var() > regular * random:
        return step
    if least == 1 and _mixed(part, count[3] / count[1]) > UNSURE:
        return step[:0]
    return np.full(np.count_nonzero(single), round(unit * (least + part)))


def _unit(step: NDArray[np.int64], apart: int) -> tuple[float, int] | None:
    """Unit that steps are multiples of [bins], and the shortest [units]; None if there is none."""
    count = np.bincount(step)
    held = np.flatnonzero(count > RARE * len(step))
    if len(held) < 2:
        return None
    group = np.cumsum(np.diff(held, prepend=held[0]) > apart)
    weight = np.bincount(group, count[held])
    place = np.bincount(group, count[held] * held) / weight
    if len(place) < 2:
        return None
    unit = float(min(place[0], np.diff(place).min()))
    for one in place.tolist():  # a longer one tells the unit more finely
        multiple = max(round(one / unit), 1)
        if abs(one / unit - multiple) <= NEAR_UNIT:
            unit = one / multiple
    off = np.abs(place / unit - np.rint(place / unit))
    if weight[off <= OFF_UNIT].sum() < ON_UNITS * len(step):
        return None
    return unit, max(round(place[0] / unit), 1)


def _on_ticks(time_s: NDArray[np.float64], unit_s: float) -> bool:
    """Whether times are multiples of a unit: those of an exact clock have a phase of their own."""
    tick = round(unit_s / TICK_S) * TICK_S
    if tick <= 0.0:
        return False
    turns = time_s / tick
    most = OFF_TICK + 2.0 * np.spacing(np.abs(time_s).max()) / tick
    return bool(np.mean(np.abs(turns - np.rint(turns)) <= most) >= ON_UNITS)


def _mixed(part: float, longest: float) -> float:
    """Part of a period between one and two units by which two periods may lengthen its mean.

    Parameters
    ----------
    part : float
        Part of two units among steps of one and two, 0..1.
    longest : float
        Steps of three units by those of one; they are two periods.
    """
    if part >= 0.5:  # two periods are three units or more
        return 0.0
    double = longest * (1.0 - part) / (2.0 * part)
    return double * (1.0 - 2.0 * part) / (1.0 + part)
