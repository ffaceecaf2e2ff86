"""Noise that is dense, and noise kept."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from spl_batch.airborne.filter.stray_returns import CELL_M
from spl_batch.airborne.report.fit.places import largest
from spl_batch.airborne.settings import FilterSettings
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import grouped

DROWNED_M2: Final = 500.0
"""Area from which dense noise is told [m2]."""

THIN_PER_M3: Final = 0.2
"""Dense noise from which on a power line loses some of its returns [1/m3]."""

KEPT_TOLD: Final = 5.0
KEPT_LEAST: Final = 100
"""Times ``filter.alpha`` of the noise below all surfaces that is kept, from which on that is told,
and the returns that it takes [1, count]."""


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
