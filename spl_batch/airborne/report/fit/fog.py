"""Fog and mist on the ground, and layers of haze too thin to be taken for noise."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import takewhile
from typing import Any, Final, NamedTuple

import numpy as np

from spl_batch.airborne.lines.comparison import pairs_of
from spl_batch.airborne.lines.pair_table import PairDifference
from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.products.air import near_ground
from spl_batch.airborne.products.air.thin_haze import PLACES_LEAST
from spl_batch.airborne.tasks.cells.pulses import SWATHS
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import counted, grouped

FOG_LEAST_M2: Final = 2000.0
FOG_SHARE: Final = 0.5
"""Area from which fog is told [m2], and part of it that it fills."""


Facts = Mapping[str, Any]
"""Of the receipt of a ground cell's surface."""


class Fog(NamedTuple):
    """Ground fog: how high it reaches over half of a survey, and anywhere; its part, the area."""

    high_m: float
    highest_m: float
    share: float
    area_m2: float


def fog_warning(done: Receipts) -> Iterator[str]:
    """Sentence on returns that fill the air just above the ground, everywhere or in patches.

    Not where flightlines lie so far apart, which is told: the upper one's ground fills it then.
    """
    cells = _single(done)
    found = _fog(cells)
    if found is None:
        yield from _mist_warning(cells)
        return
    places = f", in places up to {found.highest_m:.1f} m" * (found.highest_m > found.high_m)
    yield as_ascii(
        f"returns fill the air up to {found.high_m:.1f} m above the ground evenly in "
        f"{100 * found.share:.0f} % of {significant(found.area_m2 * 1e-6, 2)} km2{places}: ground "
        "fog, or low plants without gaps. Up to there neither the DSM nor the signal points can be "
        "trusted"
    )


def _single(done: Receipts) -> list[Facts]:
    """Ground cells, but those in which flightlines fill the air as they lie apart."""
    pairs = [p for r in done.get("strip_pairs", {}).values() for p in pairs_of(r.facts)]
    off = [pair for pair in pairs if pair.is_off_vertically]
    cells = [receipt.facts for receipt in done.get("surface", {}).values()]
    return [facts for facts in cells if _lowest_m(facts) > _apart_m(facts, off)]


def _lowest_m(facts: Facts) -> float:
    """Lower end of the highest step that is filled in most places of a cell [m]."""
    steps = _steps(facts["filled"]) if facts.get("filled") else 0
    return near_ground.FLOOR_M + max(steps - 1, 0) * near_ground.STEP_M


def _apart_m(facts: Facts, off: Sequence[PairDifference]) -> float:
    """Largest height between two flightlines of a cell that do not fit [m]."""
    flown = Counter(f"{swath[0]:05d}" for swath in facts.get(SWATHS, ()))
    there = (
        pair
        for pair in off
        if SWATHS not in facts
        or not Counter(name.partition("_")[0] for name in (pair.first, pair.second)) - flown
    )
    return max((abs(pair.up_m) for pair in there), default=0.0)


def _fog(cells: Sequence[Facts]) -> Fog | None:
    """Fog over most of the survey; None where there is none."""
    parts = [facts["filled"] for facts in cells if facts.get("filled")]
    if not parts:
        return None
    total = np.array(parts).sum(axis=0).tolist()
    places, *filled = total
    area_m2 = float(places * near_ground.SQUARE_M**2)
    if area_m2 < FOG_LEAST_M2 or filled[0] < FOG_SHARE * places:
        return None
    steps = _steps(total)
    most = max([steps, *(k for k, held in enumerate(filled, start=1) if held >= PLACES_LEAST)])
    high, highest = (near_ground.FLOOR_M + k * near_ground.STEP_M for k in (steps, most))
    return Fog(high, highest, filled[0] / places, area_m2)


def _steps(counts: Sequence[int]) -> int:
    """Steps that are filled in most of some places; counts of a receipt."""
    places, *filled = counts
    full = (held >= FOG_SHARE * max(places, 1) for held in filled)
    return sum(1 for _ in takewhile(bool, full))


def _mist_warning(cells: Sequence[Facts]) -> Iterator[str]:
    """Sentence on patches of ground that returns fill, where most ground is clear."""
    found = [patch for facts in cells for patch in facts.get("mist", ())]
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
    cells = [receipt.facts for receipt in done.get("surface", {}).values()]
    foggy = _fog(cells) is not None
    found = [
        layer
        for facts in cells
        for layer in facts.get("thin_haze", ())
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
