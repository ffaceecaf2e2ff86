"""Clock of a GPS time, and the way from one clock to another.

LAS knows seconds of the GPS week and adjusted standard time, GPS time less 10^9 s
[LAS 1.4 R15, section 2.4, global encoding]. The header's bit is often wrong, so the values decide.
Adjusted times of the first eight days after 2011-09-14 look like week seconds.
"""

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import ADJUSTED_STANDARD_OFFSET_S, GPS_WEEK_S

TimeStandard = Literal["none", "week", "adjusted", "unix_or_gps", "other"]
"""``none``: no value, or all zero; ``unix_or_gps``: seconds since 1970 or 1980."""

CLOCKS: Final = {
    "week": "seconds of the GPS week",
    "adjusted": "adjusted standard time",
    "unix_or_gps": "seconds since 1970 or 1980",
}
"""Those of :data:`TimeStandard` that are known, in words."""

_WEEK_MAX_S: Final = GPS_WEEK_S + 86_400
"""Week seconds may run on past the end of the week for the length of a flight."""

_ADJUSTED_MAX_S: Final = 9e8
"""Adjusted standard time in 2040; GPS seconds were as small as this in 2008."""

_EPOCH_MAX_S: Final = 2.6e9

LATEST_S: Final = 1e10
"""No clock counts more seconds: three centuries [s]."""

_LEAPS: Final = ((1_025_136_016, 16), (1_119_744_017, 17), (1_167_264_018, 18))
"""GPS seconds, and leap seconds since then: of July 2012, July 2015 and January 2017 [IERS
Bulletins C 43, 49 and 52]."""


def usable_times(times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which times can be times at all: finite, and at most :data:`LATEST_S` from zero."""
    can_be: NDArray[np.bool_] = np.abs(times) <= LATEST_S
    return can_be


def time_standard(times: NDArray[np.float64]) -> TimeStandard:
    """Standard that times are in, judged by their values: see :data:`TimeStandard`.

    ``times``: (n,) float64, times [s]; non-finite ones are not looked at.
    """
    finite = times[np.isfinite(times)]
    if not len(finite) or not np.any(finite):
        return "none"
    low, high = float(finite.min()), float(finite.max())
    if low >= 0 and high < _WEEK_MAX_S:
        return "week"
    if low >= -ADJUSTED_STANDARD_OFFSET_S and high < _ADJUSTED_MAX_S:
        return "adjusted"
    if low >= _ADJUSTED_MAX_S and high < _EPOCH_MAX_S:
        return "unix_or_gps"
    return "other"


def leap_seconds(time_s: float) -> int:
    """Seconds by which UTC is behind GPS time.

    Parameters
    ----------
    time_s : float
        A time in any standard; seconds of the week, which have no year, count as of today [s].
    """
    standard = time_standard(np.array([time_s]))
    if standard not in {"adjusted", "unix_or_gps"}:
        return _LEAPS[-1][1]
    gps_s = time_s + ADJUSTED_STANDARD_OFFSET_S * (standard == "adjusted")
    return next((leap for since_s, leap in reversed(_LEAPS) if gps_s >= since_s), _LEAPS[0][1])


def contradicted_bit(standard: TimeStandard, *, adjusted_bit: bool) -> tuple[str, str] | None:
    """What a header's bit states and what the values are; None where they agree."""
    if standard == "week" and adjusted_bit:
        return CLOCKS["adjusted"], CLOCKS["week"]
    if standard == "adjusted" and not adjusted_bit:
        return "GPS week time", CLOCKS["adjusted"]
    return None


def clock(
    given: TimeStandard,
    span_s: tuple[float, float],
    point_span_s: tuple[float, float],
    wanted: TimeStandard,
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]] | None:
    """How times of a trajectory become the points'; None where nothing is to be done.

    Week seconds leave the week open: the one is taken that brings each record closest to the
    points. Records that wrap round at its end may change order.

    Parameters
    ----------
    span_s : (float, float)
        Its first and last time [s].
    point_span_s : (float, float)
        First and last time of the points [s].

    Raises
    ------
    ValueError
        If one of the two is in week seconds and the other spans more than half a week:
        then the week is ambiguous.
    """
    if given == wanted or {"other", "none"} & {given, wanted}:
        return None
    middle = (point_span_s[0] + point_span_s[1]) / 2
    # through adjusted standard time
    before = -ADJUSTED_STANDARD_OFFSET_S if given != "adjusted" else 0.0
    after = ADJUSTED_STANDARD_OFFSET_S if wanted != "adjusted" else 0.0
    if wanted == "unix_or_gps":
        middle -= ADJUSTED_STANDARD_OFFSET_S
    weeks = 0.0
    if given == "week":
        _refuse_ambiguous(point_span_s[1] - point_span_s[0], "points", "trajectory")
    elif wanted == "week":
        _refuse_ambiguous(span_s[1] - span_s[0], "trajectory", "points")
        first, last = (t + before + after for t in span_s)
        weeks = GPS_WEEK_S * float(np.rint((middle - (first + last) / 2) / GPS_WEEK_S))

    def convert(time: NDArray[np.float64]) -> NDArray[np.float64]:
        time = time + before
        if given == "week":
            time = time + GPS_WEEK_S * np.rint((middle - time) / GPS_WEEK_S)
        return time + after + weeks

    return convert


def _refuse_ambiguous(span_s: float, which: str, other: str) -> None:
    if span_s > GPS_WEEK_S / 2:
        raise ValueError(
            f"the times of the {other} are in seconds of the GPS week and the {which} span"
            f" {span_s / 86400:.1f} days, so the week is ambiguous: give both in adjusted"
            " standard time"
        )
