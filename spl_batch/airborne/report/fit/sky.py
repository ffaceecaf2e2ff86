"""Bright points that light the whole array, crosstalk, noise that is dense, and noise kept."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from spl_batch.airborne.filter.stray_returns import CELL_M
from spl_batch.airborne.report.fit.places import largest
from spl_batch.airborne.settings import FilterSettings
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import counted, grouped

DROWNED_M2: Final = 500.0
"""Area from which dense noise is told [m2]."""

THIN_PER_M3: Final = 0.2
"""Dense noise from which on a power line loses some of its returns [1/m3]."""

KEPT_TOLD: Final = 5.0
KEPT_LEAST: Final = 100
"""Times ``filter.alpha`` of the noise below all surfaces that is kept, from which on that is told,
and the returns that it takes [1, count]."""


def bloom(done: Receipts) -> tuple[int, int]:
    """Shots that one bright point lit wholly, and their returns at its range [count]."""
    found = _bloom(done)
    return sum(one[0] for one in found), sum(one[1] for one in found)


def _bloom(done: Receipts) -> list[list[int]]:
    """Shots, returns, and west, south, east and north of these [quanta], by stretch."""
    return [r.facts["bloom"] for r in done.get("scatter", {}).values() if "bloom" in r.facts]


def crosstalk(done: Receipts) -> int:
    """Returns that one beside them in their shot may have set off [count]."""
    return sum(r.facts.get("crosstalk", 0) for r in done.get("scatter", {}).values())


def crosstalk_expected(done: Receipts) -> int:
    """How many returns others have set off, by the chance of it that flightlines show [count]."""
    facts = [r.facts for r in done.get("fit_line", {}).values()]
    found = [float(some["points"]) * float(some.get("crosstalk", 0.0)) for some in facts]
    return round(sum(found))


def bloom_warning(done: Receipts, *, removed: bool) -> Iterator[str]:
    """Sentence on shots in which a bright point lit the whole array."""
    shots, returns = bloom(done)
    if not shots:
        return
    fate = (
        "are noise, class 18 or 7"
        if removed
        else "stay signal and may raise the DSM: set noise.bloom: true to make them noise"
    )
    lit = [one for one in _bloom(done) if one[0]]
    place = largest([one[2:] for one in lit], [one[1] for one in lit])
    yield as_ascii(
        f"{counted(shots, 'shots')} {place}: many channels "
        "have a return at one and the same range, and others behind it. Bright points such as "
        "retro-reflectors light the whole array so, or a small surface "
        f"that lets light pass; the {grouped(returns)} returns at that range {fate}"
    )


def drowned_warning(done: Receipts) -> Iterator[str]:
    """Sentence on dense noise that leaves no surface, or takes what is thin."""
    parts = [r.facts for r in done.get("ground", {}).values() if r.facts.get("dense")]
    if not parts:
        return
    dense, drowned, sums = np.array([facts["dense"] for facts in parts]).sum(axis=0).tolist()
    area_m2 = drowned * CELL_M**2
    where = (
        f"noise is dense, {significant(sums / dense, 2)} returns per m3 over "
        f"{significant(dense * CELL_M**2 * 1e-6, 2)} km2"
    )
    if area_m2 < DROWNED_M2:
        if dense * CELL_M**2 >= DROWNED_M2 and sums >= THIN_PER_M3 * dense:
            yield as_ascii(f"{where}: wires and other thin objects lose returns in it")
        return
    lost = [facts for facts in parts if facts["dense"][1]]
    place = largest([facts["core"] for facts in lost], [facts["dense"][1] for facts in lost])
    yield as_ascii(
        f"{where}, and in {grouped(round(area_m2))} m2 of "
        f"it, {place}, no surface "
        "stands out: no ground is found there, and the terrain is void or spans it from the sides"
    )


def kept_warning(done: Receipts, settings: FilterSettings) -> Iterator[str]:
    """Sentence on more noise that is kept where nothing stands than the filter promises."""
    if settings.method != "vsaes" or settings.test != "calibrated":
        return
    found = [r.facts.get("below", [0, 0]) for r in done.get("ground", {}).values()]
    kept, refused = (sum(counts[k] for counts in found) for k in (0, 1))
    share = kept / max(kept + refused, 1)
    if kept >= KEPT_LEAST and share > KEPT_TOLD * settings.alpha:
        yield as_ascii(
            f"below all surfaces, where only noise lies, {significant(100 * share, 2)} % of "
            f"{grouped(kept + refused)} returns were kept in place of the "
            f"{significant(100 * settings.alpha, 2)} % of filter.alpha: the noise comes in "
            "clusters that its model does not know. About that share of the noise above surfaces "
            "stays among the signal, too"
        )
