"""Sentences on flightlines that do not give a hard place one height."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from spl_batch.airborne.pulses.steady_heights import KINDS, Counts, add_counts, typical_m
from spl_batch.airborne.pulses.swath_coverage import Flown, flightline_named
from spl_batch.airborne.tasks.cells.pulses import STEADY
from spl_batch.engine.report.number_format import as_ascii
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import Said, grouped, shared

TOLD: Final = {"looks": 1.0, "bright": 1.6}
"""Differences that are told [ranging spreads of the sensor]: a first photo-electron of many lies
as much as 1.5 above their mean."""


def steady_warnings(done: Receipts, flown: Sequence[Flown], sigma_m: float) -> Iterator[str]:
    """Sentences on heights that swing with time, and on such as follow brightness.

    ``flown``: the flightlines, which may share a point source id; ``sigma_m``: ranging spread that
    the sensor states [m].
    """
    found: dict[str, Counts] = {}
    for receipt in done.get("surface", {}).values():
        for number, kinds in receipt.facts.get(STEADY, {}).items():
            counts = {kind: Counter(dict(kinds[kind])) for kind in KINDS}
            add_counts(found, flightline_named(int(number), flown), counts)
    for kind in KINDS:
        said = (
            Said(line, as_ascii(_SENTENCES[kind](100 * off, places, 100 * sigma_m)), off)
            for line, counts in found.items()
            if (off := typical_m(counts[kind])) is not None
            and off > TOLD[kind] * sigma_m
            and (places := counts[kind].total())
        )
        yield from shared(said, "flightlines", "flightline")


def _looks(off_cm: float, places: int, sigma_cm: float) -> str:
    return (
        f"heights of one and the same hard place, seen at times moments apart, spread by "
        f"{off_cm:.0f} cm beyond the ranging noise ({grouped(places)} level squares of 8 m; the "
        f"sensor states {sigma_cm:.0f} cm): recorded positions or angles swing within seconds, or "
        "the looks ahead and back are not calibrated to each other. Surfaces become as thick "
        "as that, and much of the ground is not found; survey.align cannot mend it, adjust "
        "trajectory or calibration"
    )


def _bright(off_cm: float, places: int, _: float) -> str:
    return (
        f"bright returns of hard places lie {off_cm:.0f} cm above the weaker half of the same "
        f"place ({grouped(places)} level squares of 8 m): ranges walk with the strength of the "
        "return. Surfaces become as thick as that, and much of the ground is not found; correct "
        "the ranges by intensity"
    )


_SENTENCES: Final[dict[str, Callable[[float, int, float], str]]] = {
    "looks": _looks,
    "bright": _bright,
}
