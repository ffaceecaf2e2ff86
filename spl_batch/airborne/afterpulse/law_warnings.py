"""Where a flightline's returns and the facts of its sensor disagree, in words.

Domain: time. The law and the ranging spread of a flightline follow what it shows; a user is told
where that is not what the sensor states, as other figures of the sensor may be wrong too.
"""

from typing import Final

from spl_batch.airborne.afterpulse.afterpulse_law import AfterpulseLaw
from spl_batch.airborne.afterpulse.lag_counts import LAG_EDGES_M
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.errors import Remark, grouped

LATE_MIN: Final = 0.02
"""Share of afterpulses with longer lags than the sensor states that is worth a word."""


def disagreements(law: AfterpulseLaw, sensor: Sensor) -> tuple[Remark, ...]:
    """What to tell of a flightline's law and ranging spread.

    Parameters
    ----------
    law : AfterpulseLaw
        As it was fitted.
    sensor : Sensor
        What is stated.
    """
    return (*_late(law, sensor), *_spread(law, sensor))


def _late(law: AfterpulseLaw, sensor: Sensor) -> tuple[Remark, ...]:
    stated, late = sensor.afterpulse_lag_max_m, law.later_than(sensor.afterpulse_lag_max_m)
    if late < LATE_MIN:
        return ()
    ends = "" if law.longest_m < LAG_EDGES_M[-1] else " and farther, which is not looked for"
    text = (
        f"{100 * late:.0f} % of the afterpulses lie more than {stated:g} m behind the return that "
        f"started them, up to {law.longest_m:.0f} m{ends}, and the sensor states {stated:g} m; so "
        f"says what follows {grouped(law.parents)} returns of hard surfaces. Behind hard surfaces "
        "they are taken away as deep; among leaves more of them stay than usual"
    )
    return (Remark(text, late),)


def _spread(law: AfterpulseLaw, sensor: Sensor) -> tuple[Remark, ...]:
    stated = sensor.range_sigma_m
    if law.sigma_m <= stated:
        return ()
    text = (
        f"returns of hard surfaces spread by {100 * law.sigma_m:.0f} cm along the beam, and the "
        f"sensor states {100 * stated:.0f} cm; surfaces are taken as thick as that, so afterpulses "
        f"within {250 * law.sigma_m:.0f} cm of them stay, and heights of single returns are as "
        "uncertain"
    )
    return (Remark(text, law.sigma_m),)
