"""Sentence on light so strong that each beamlet sees several returns."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

from spl_batch.engine.report.number_format import as_ascii
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import Said, shared

STRONG: Final = 3.0
"""Mean signal of a beamlet that is told [photo-electrons]: a single-photon lidar has one or
less."""

UNSEEN: Final = 1e-3
"""Least share of the beamlets without a return that tells how strong the light is."""


def strong_light_warning(done: Receipts) -> Iterator[str]:
    """Sentence on flightlines that are flown too low, or with too strong a laser.

    Photo-electrons are as many as leave so few beamlets without a return [W17 Eq. 2.6], less the
    noise of a gate.
    """
    said = (
        Said(name, _sentence(electrons, facts["seen_fraction"]), electrons)
        for name, receipt in done.get("fit_line", {}).items()
        if (electrons := _electrons(facts := receipt.facts)) >= STRONG
    )
    yield from shared(said, "flightlines", "flightline")


def _electrons(facts: Mapping[str, Any]) -> float:
    """Mean signal of a beamlet, 0 where it is not known [photo-electrons]."""
    seen, noise_per_m = facts["seen_fraction"], facts["noise_per_m"]
    if seen is None or noise_per_m is None:  # nothing filters
        return 0.0
    if facts["beamlets"] == 1:  # beamlets are not told apart: nearly every shot has a return
        return 0.0
    noise = float(noise_per_m) * float(facts["gate_m"] or 0.0)
    return -math.log(max(1.0 - float(seen), UNSEEN)) - noise


def _sentence(electrons: float, seen: float) -> str:
    return as_ascii(
        f"{100 * seen:.1f} % of the beamlets have a return, by a signal of some {electrons:.1f} "
        "photo-electrons each: so strong a light shows several returns of leaves, and some of one "
        "and the same surface. Among leaves some true returns are lost as afterpulses, and more "
        "afterpulses stay; fly higher or with less light"
    )
