"""Area and density of a survey for the report, from what its ground cells have counted."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from spl_batch.airborne.context import Context
from spl_batch.airborne.diagnostics.terrain_sigma import unsure_share
from spl_batch.airborne.report.model import Density
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.tasks.cells.pulses import CELLS, VOIDS
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts

VEGETATION_PER_M2: Final = 1.0
"""Below this density shrubs become ground (``docs/delivery.md``) [1/m2]."""


def area_km2(done: Receipts, context: Context) -> float | None:
    """Area of the raster cells that were flown [km2]; None without any ground cell."""
    cells = _cells(done)
    return cells.total() * context.workflow.products.cell_m**2 / 1e6 if cells else None


def density(done: Receipts, context: Context, ground: int) -> Density:
    """How densely returns cover all pieces of a survey.

    Parameters
    ----------
    ground : int
        Ground points that were delivered [count].
    """
    cells = _cells(done)
    if not cells:
        return Density()
    cell_m2 = context.workflow.products.cell_m**2
    area_m2 = cells.total() * cell_m2
    returns = sum(held * n for held, n in cells.items())
    return Density(
        mean_per_m2=returns / area_m2,
        median_per_m2=_quantile(cells, 0.5) / cell_m2,
        p05_per_m2=_quantile(cells, 0.05) / cell_m2,
        # Without signal no ground was looked for.
        ground_per_m2=ground / area_m2 if returns else None,
        void_share=sum(r.facts[VOIDS] for r in done["surface"].values()) / cells.total(),
        unsure_share=unsure_share(done),
    )


def sparse_vegetation(found: Density, asked: ClassSettings) -> tuple[Finding, ...]:
    """Whether classes of low and medium vegetation are asked of too few returns."""
    density_m2 = found.mean_per_m2
    if asked.vegetation is None or density_m2 is None or density_m2 >= VEGETATION_PER_M2:
        return ()
    values = {"per_m2": density_m2, "high_m": asked.vegetation.high}
    return (Finding("G03", values),)


def _cells(done: Receipts) -> Counter[int]:
    """Raster cells that were flown, by the signal returns in them [count]."""
    cells: Counter[int] = Counter()
    for receipt in done.get("surface", {}).values():
        cells.update({int(returns): n for returns, n in receipt.facts[CELLS].items()})
    return cells


def _quantile(cells: Mapping[int, int], share: float) -> int:
    """Smallest value that so many cells do not exceed."""
    values = sorted(cells)
    below: Iterable[int] = np.cumsum([cells[value] for value in values])
    wanted = share * sum(cells.values())
    return next(value for value, n in zip(values, below, strict=True) if n >= wanted)
