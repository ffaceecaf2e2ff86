"""Warnings where a flightline's returns disagree with the facts of its sensor.

Domain: time. The law and the ranging spread follow the data. A finding names where they are not
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
from spl_batch.airborne.findings import WARNED_SHARE
from spl_batch.airborne.noise.gains import SURE_SIGMA
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.engine.findings import Finding


def expected_and_seen(
    part: Mapping[str, NDArray[Any]], law: AfterpulseLaw, noise_per_m: float, within_m: float
) -> tuple[float, int]:
    """Followers behind a stretch's hard planes: expected by the flightline's law, and found.

    Parameters
    ----------
    part : dict
        Result of :func:`~spl_batch.airborne.afterpulse.candidates.observe`.
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
"""Factor to what a flightline's law or its noise lets expect, up or down, within which a part of it
is no news."""


def uneven(
    parts: Sequence[Mapping[str, NDArray[Any]]], spans_s: Sequence[tuple[float, float]],
    law: AfterpulseLaw, noise_per_m: float, sensor: Sensor,
) -> tuple[Finding, ...]:  # fmt: skip
    """Findings about stretches of a flightline that do not follow its law.

    Parameters
    ----------
    parts : sequence of dict
        Results of :func:`~spl_batch.airborne.afterpulse.candidates.observe`.
    spans_s : sequence of (float, float)
        First and last time of each [s].
    law, noise_per_m
        Of the flightline; background per metre of beamlet [1/m].
    sensor : Sensor
        Its longest lag: what follows later is a finding of whole flightlines only.
    """
    odd = []
    for part, span_s in zip(parts, spans_s, strict=True):
        due, seen = expected_and_seen(part, law, noise_per_m, sensor.afterpulse_lag_max_m)
        ratio = (seen + 1.0) / (due + 1.0)
        if max(ratio, 1.0 / ratio) > UNEVEN and abs(seen - due) > SURE_SIGMA * math.sqrt(due + 1):
            odd.append((ratio, span_s))
    if not odd:
        return ()
    ratio, (first, last) = max(odd, key=lambda one: abs(math.log(one[0])))
    values = {
        "kind": "uneven", "count": len(odd), "of": len(parts), "times": float(ratio),
        "first_s": float(first), "last_s": float(last),
    }  # fmt: skip
    return (Finding("A01", values, badness=abs(math.log(ratio))),)


def disagreements(law: AfterpulseLaw, sensor: Sensor) -> tuple[Finding, ...]:
    """Findings about a flightline's law and ranging spread."""
    stated_m, late = sensor.afterpulse_lag_max_m, law.later_than(sensor.afterpulse_lag_max_m)
    found = []
    if law.longest_m > stated_m and late >= WARNED_SHARE:
        values = {
            "kind": "late", "share": late, "stated_m": stated_m, "longest_m": float(law.longest_m),
        }  # fmt: skip
        found.append(Finding("A01", values, badness=late))
    sigma_m, stated_m = float(law.sigma_m), sensor.range_sigma_m
    if sigma_m > stated_m:
        values = {"kind": "spread", "sigma_m": sigma_m, "stated_m": stated_m}
        found.append(Finding("A01", values, badness=sigma_m))
    return tuple(found)
