"""Warnings where a flightline's returns disagree with the facts of its sensor.

Domain: time. The law and the ranging spread follow the data. The user is told where they are not
what the sensor states, as its other figures may be wrong too.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.afterpulse_law import AfterpulseLaw, added, of_hard_planes
from spl_batch.airborne.afterpulse.hard_surfaces import STEP_M
from spl_batch.airborne.afterpulse.lag_counts import LAG_EDGES_M
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.errors import Remark, grouped

LATE_MIN: Final = 0.02
"""Share of afterpulses beyond the sensor's longest lag from which on a user is told."""


def expected_and_seen(
    part: Mapping[str, NDArray[Any]], law: AfterpulseLaw, noise_per_m: float, within_m: float
) -> tuple[float, int]:
    """Followers behind a stretch's hard planes: expected by the flightline's law, and found.

    Parameters
    ----------
    part : dict
        Result of :func:`~spl_batch.airborne.afterpulse.afterpulse_law.observe`.
    law, noise_per_m
        Of the flightline; background per metre of beamlet [1/m].
    """
    _, followers, left = of_hard_planes(added([part]), law.sigma_m)
    low, high = LAG_EDGES_M[:-1], LAG_EDGES_M[1:]
    taken = (high > law.dead_m) & (high <= within_m + 0.5 * STEP_M)
    middle, width = 0.5 * (low + high), high - np.maximum(low, law.dead_m)
    nodes = law.dead_m + STEP_M * np.arange(len(law.density))
    passed = 1.0 - STEP_M * (np.cumsum(law.density) - 0.5 * law.density)
    hazard = np.interp(middle, nodes, law.density / np.maximum(passed, 0.05), right=0.0)
    expected = float(np.sum((left * width * (hazard + noise_per_m))[taken]))
    return expected, int(followers[taken].sum())


UNEVEN: Final = 1.5
"""Factor to the law, up or down, within which a stretch's followers are no news."""

UNEVEN_SIGMA: Final = 6.0
"""And standard deviations of chance."""


def uneven(
    parts: Sequence[Mapping[str, NDArray[Any]]], spans_s: Sequence[tuple[float, float]],
    law: AfterpulseLaw, noise_per_m: float, sensor: Sensor,
) -> tuple[Remark, ...]:  # fmt: skip
    """What to tell of stretches of a flightline that do not follow its law.

    Parameters
    ----------
    parts : sequence of dict
        Results of :func:`~spl_batch.airborne.afterpulse.afterpulse_law.observe`.
    spans_s : sequence of (float, float)
        First and last time of each [s].
    law, noise_per_m
        Of the flightline; background per metre of beamlet [1/m].
    sensor : Sensor
        Its longest lag: what follows later is told of whole flightlines only.
    """
    odd = []
    for part, span_s in zip(parts, spans_s, strict=True):
        due, seen = expected_and_seen(part, law, noise_per_m, sensor.afterpulse_lag_max_m)
        ratio = (seen + 1.0) / (due + 1.0)
        if max(ratio, 1.0 / ratio) > UNEVEN and abs(seen - due) > UNEVEN_SIGMA * math.sqrt(due + 1):
            odd.append((ratio, span_s))
    if not odd:
        return ()
    ratio, (first, last) = max(odd, key=lambda one: abs(math.log(one[0])))
    text = (
        f"in {len(odd)} of {len(parts)} stretches returns of hard surfaces are followed more or "
        f"less often than the law of the flightline says, {ratio:.1f} times as often between "
        f"gps_time {first:.0f} and {last:.0f}: there afterpulses among leaves are told worse"
    )
    return (Remark(text, abs(math.log(ratio))),)


def disagreements(law: AfterpulseLaw, sensor: Sensor) -> tuple[Remark, ...]:
    """What to tell of a flightline's law and ranging spread."""
    return (*_late(law, sensor), *_spread(law, sensor))


def _late(law: AfterpulseLaw, sensor: Sensor) -> tuple[Remark, ...]:
    stated, late = sensor.afterpulse_lag_max_m, law.later_than(sensor.afterpulse_lag_max_m)
    if law.longest_m <= stated or late < LATE_MIN:
        return ()
    ends = "" if law.longest_m < LAG_EDGES_M[-1] else " and farther, which is not looked for"
    text = (
        f"{100 * late:.0f} % of the afterpulses lie more than {stated:g} m behind the return that "
        f"started them, up to {law.longest_m:.0f} m{ends}, and the sensor states {stated:g} m "
        f"({grouped(law.parents)} returns of hard surfaces show it). Behind hard surfaces they are "
        "taken away as deep; among leaves more of them stay than usual"
    )
    return (Remark(text, late),)


def _spread(law: AfterpulseLaw, sensor: Sensor) -> tuple[Remark, ...]:
    stated = sensor.range_sigma_m
    if law.sigma_m <= stated:
        return ()
    text = (
        f"returns of hard surfaces spread by {100 * law.sigma_m:.0f} cm along the beam, and the "
        f"sensor states {100 * stated:.0f} cm: so thick are surfaces taken, afterpulses within "
        f"{250 * law.sigma_m:.0f} cm behind them stay, and heights of single returns are as "
        "uncertain"
    )
    return (Remark(text, law.sigma_m),)
