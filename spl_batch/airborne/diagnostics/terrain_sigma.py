"""Terrain whose standard deviation is large: how much of it there is, and the largest place."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.diagnostics.patches import WARNED_M2, patches
from spl_batch.airborne.findings import WARNED_SHARE
from spl_batch.airborne.products.surface_rasters import OFF_M
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.lattice.tiles import Bounds

FACT: Final = "unsure"
"""Fact of a ground cell: cells with a height, those that are not known well [count], and area [m2]
and west, south, east and north [m] of their largest place."""


def terrain_facts(quality: NDArray[np.float32], dtm: NDArray[np.float32], core: Bounds) -> Any:
    """What the report needs of a ground cell, by the name of its fact; rasters are north up."""
    unsure = quality > OFF_M
    known = int(np.count_nonzero(dtm != NODATA))
    fact: list[float] = [known, int(np.count_nonzero(unsure))]
    if unsure.any():
        largest = patches(unsure[::-1])[0]
        edge_m = (core.xmax - core.xmin) / quality.shape[1] * QUANTUM_M
        box = largest.box(core.xmin * QUANTUM_M, core.ymin * QUANTUM_M, edge_m)
        fact += [largest.squares * edge_m**2, *box]
    return {FACT: fact}


def unsure_share(done: Receipts) -> float | None:
    """Share of the terrain's cells that are not known well; None without any."""
    known, unsure = (sum(fact[k] for _, fact in _facts(done)) for k in (0, 1))
    return unsure / known if known else None


def terrain_findings(done: Receipts) -> Iterator[Finding]:
    """Much of the terrain, or a large place of it, is not known well."""
    share = unsure_share(done)
    places = [(fact[2], name, fact[3:]) for name, fact in _facts(done) if len(fact) > 2]
    if share is None or not places:
        return
    area_m2, _, box = max(places)
    if share > WARNED_SHARE or area_m2 >= WARNED_M2:
        values = {"share": share, "sigma_m": OFF_M, "area_m2": area_m2}
        yield Finding("G01", values, place=box)


def _facts(done: Receipts) -> list[tuple[str, list[float]]]:
    surface = done.get("surface", {})
    return [(name, r.facts[FACT]) for name, r in surface.items() if FACT in r.facts]
