"""Fog and mist on the ground, and layers of haze too thin to be taken for noise."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.products.air import near_ground
from spl_batch.airborne.strips.strip_comparison import pairs_of
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import counted, grouped

FOG_LEAST_M2: Final = 2000.0
FOG_SHARE: Final = 0.5
"""Area from which fog is told [m2], and part of it that it fills."""


class Fog(NamedTuple):
    """Ground fog: how high it reaches, its part of a survey, and the survey's area."""

    high_m: float
    share: float
    area_m2: float


def fog_warning(done: Receipts) -> Iterator[str]:
    """Sentence on returns that fill the air just above the ground, everywhere or in patches.

    Not where flightlines lie so far apart, which is told: the upper one's ground fills it then.
    """
    found = _fog(done)
    low_m = near_ground.FLOOR_M if found is None else found.high_m - near_ground.STEP_M
    if low_m <= _apart_m(done):
        return
    if found is None:
        yield from _mist_warning(done)
        return
    yield as_ascii(
        f"returns fill the air up to {found.high_m:.1f} m above the ground evenly in "
        f"{100 * found.share:.0f} % of {significant(found.area_m2 * 1e-6, 2)} km2: ground fog, or "
        f"low plants without gaps. Up to there neither the DSM nor the signal points can be "
        "trusted"
    )


def _apart_m(done: Receipts) -> float:
    """Largest height between two flightlines that do not fit [m]."""
    pairs = [p for r in done.get("strip_pairs", {}).values() for p in pairs_of(r.facts)]
    return max((abs(pair.up_m) for pair in pairs if pair.is_off_vertically), default=0.0)


def _fog(done: Receipts) -> Fog | None:
    """Fog over most of the survey; None where there is none."""
    parts = [r.facts["filled"] for r in done.get("surface", {}).values() if r.facts.get("filled")]
    if not parts:
        return None
    places, *filled = np.array(parts).sum(axis=0)
    area_m2 = float(places * near_ground.SQUARE_M**2)
    shares = np.array(filled) / max(places, 1)
    if area_m2 < FOG_LEAST_M2 or shares[0] < FOG_SHARE:
        return None
    steps = int(np.argmax(np.append(shares < FOG_SHARE, True)))
    return Fog(near_ground.FLOOR_M + steps * near_ground.STEP_M, float(shares[0]), area_m2)


def _mist_warning(done: Receipts) -> Iterator[str]:
    """Sentence on patches of ground that returns fill, where most ground is clear."""
    found = [patch for r in done.get("surface", {}).values() for patch in r.facts.get("mist", ())]
    if not found:
        return
    _, x, y = max(found)
    top = near_ground.FLOOR_M + near_ground.LOW_STEPS * near_ground.STEP_M
    patches = f"{len(found)} patch{'es' * (len(found) > 1)}"
    yield as_ascii(
        f"returns fill the air up to {top:.1f} m and more above the ground evenly in {patches}, "
        f"{_extent(found, x, y)}: mist, or plants without gaps; there "
        "neither the DSM nor the signal points just above the ground can be trusted"
    )


def _extent(found: Sequence[Sequence[float]], x: float, y: float) -> str:
    """Area of all, and of the largest with its place; each begins with its number of places."""
    places = [patch[0] for patch in found]
    total, most = (near_ground.SQUARE_M**2 * n for n in (sum(places), max(places)))
    east, north = (grouped(round(axis * QUANTUM_M)) for axis in (x, y))
    return (
        f"{grouped(round(total))} m2 in all, the largest of {grouped(round(most))} m2 "
        f"at {east} E, {north} N"
    )


def thin_haze_warning(done: Receipts) -> Iterator[str]:
    """Sentence on layers of haze that are too thin to be taken for noise."""
    foggy = _fog(done) is not None
    found = [
        layer
        for r in done.get("surface", {}).values()
        for layer in r.facts.get("thin_haze", ())
        if not foggy or layer[-1] < FOG_SHARE
    ]
    if not found:
        return
    _, low, high, x, y, _ = max(found)
    yield as_ascii(
        f"returns fill the air evenly in {counted(len(found), 'thin layers')} above the ground, "
        f"{_extent(found, x, y)}, {low:.0f} to {high:.0f} m above it: "
        "haze or a low cloud, or crowns without a gap; as they are less than "
        f"{3 * CUBE_M:.0f} m thick they stay signal, and the DSM lies on them; look at the "
        "profile there, and classify by hand what is no canopy"
    )
