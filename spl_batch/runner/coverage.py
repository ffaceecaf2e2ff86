"""What a survey covers and how densely: counted by each ground cell, added up for the report."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.io.polygons import contains, read_polygons
from spl_batch.model import PointTable
from spl_batch.report.model import Density
from spl_batch.runner.remember import Receipts
from spl_batch.runner.survey_context import Context
from spl_batch.stages.footprint import SQUARE_M2, footprint
from spl_batch.tiling import Bounds

_SQUARES: Final = "footprint"
"""Fact of a ground cell: squares that returns cover [count]."""

_CELLS: Final = "cells_by_returns"
"""Fact of a ground cell: raster cells that were flown, by the signal returns in them [count]."""

_VOIDS: Final = "voids"
"""Fact of a ground cell: raster cells that were flown and have no terrain height [count]."""


def covered(
    table: PointTable, core: Bounds, arrays: Mapping[str, NDArray[np.float32]], context: Context
) -> dict[str, Any]:
    """Facts of a ground cell: whole numbers, so that sums do not depend on their order.

    Parameters
    ----------
    table : PointTable
        Points of the cell and around it that its rasters are made of.
    core : Bounds
        The cell [quanta].
    arrays : mapping of str to (rows, cols) float32
        Its rasters; ``dtm`` and ``density`` are looked at.
    context : Context
        The run.
    """
    within = None
    if context.workflow.aoi is not None:
        polygons = read_polygons(context.resolve(context.workflow.aoi), context.crs)

        def within(east: NDArray[np.int64], north: NDArray[np.int64]) -> NDArray[np.bool_]:
            return contains(polygons, east, north)

    products = context.workflow.products
    flown = arrays["density"] != NODATA
    returns = np.rint(arrays["density"][flown].astype(np.float64) * products.cell_m**2)
    values, counts = np.unique(returns.astype(np.int64), return_counts=True)
    return {
        _SQUARES: footprint(table, core, products, within),
        _CELLS: dict(zip(map(str, values.tolist()), counts.tolist(), strict=True)),
        _VOIDS: int(np.count_nonzero(arrays["dtm"][flown] == NODATA)),
    }


def area_km2(done: Receipts) -> float | None:
    """Area that the returns of all pieces of a survey cover [km2]; None where nobody counted.

    Parameters
    ----------
    done : mapping of str to mapping of str to Receipt
        Finished tasks by kind and name.
    """
    facts = _facts(done)
    return None if facts is None else sum(f[_SQUARES] for f in facts) * SQUARE_M2 / 1e6


def density(done: Receipts, context: Context, ground: int) -> Density:
    """How densely returns cover all pieces of a survey.

    Parameters
    ----------
    done : mapping of str to mapping of str to Receipt
        Finished tasks by kind and name.
    context : Context
        The run.
    ground : int
        Ground points [count].
    """
    facts, area = _facts(done), area_km2(done)
    if facts is None or not area:
        return Density()
    cells: Counter[int] = Counter()
    for found in facts:
        cells.update({int(returns): n for returns, n in found[_CELLS].items()})
    if not cells:
        return Density()
    cell_m2, area_m2 = context.workflow.products.cell_m**2, area * 1e6
    returns = sum(held * n for held, n in cells.items())
    return Density(
        mean_per_m2=returns / area_m2,
        median_per_m2=_quantile(cells, 0.5) / cell_m2,
        p05_per_m2=_quantile(cells, 0.05) / cell_m2,
        # Without signal no ground was looked for.
        ground_per_m2=ground / area_m2 if returns else None,
        void_share=sum(f[_VOIDS] for f in facts) / cells.total(),
    )


def _facts(done: Receipts) -> list[Mapping[str, Any]] | None:
    """What ground cells have counted; None where one is of a version that did not, or none is."""
    found = [receipt.facts for receipt in done.get("surface", {}).values()]
    return found if found and all(_SQUARES in facts for facts in found) else None


def _quantile(cells: Mapping[int, int], share: float) -> int:
    """Smallest value that so many cells do not exceed."""
    values = sorted(cells)
    below: Iterable[int] = np.cumsum([cells[value] for value in values])
    wanted = share * sum(cells.values())
    return next(value for value, n in zip(values, below, strict=True) if n >= wanted)
