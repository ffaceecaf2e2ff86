"""What the returns of a ground cell cover, how densely and evenly; added up for the report.

Facts are whole numbers, so that sums do not depend on their order.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.products.flown_cells import covered_cells
from spl_batch.airborne.pulses.first_returns import COLUMNS_NEEDED
from spl_batch.airborne.pulses.swaths import SPACINGS, Swaths, coverage
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA, NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, inside, quanta

CELLS: Final = "cells_by_returns"
"""Fact of a ground cell: raster cells that were flown, by the signal returns in them [count]."""

VOIDS: Final = "voids"
"""Fact of a ground cell: raster cells that were flown and have no terrain height [count]."""

PULSES: Final = "pulses"
"""Fact of a ground cell: raster cells with signal around, no water; first returns in them; flown
cells beyond every signal, off the edge or in a wide hole [count]."""

LEVELS: Final = "pulse_levels"
"""Fact of a ground cell: a :class:`~spl_batch.airborne.pulses.swaths.Coverage` by spacing."""

SWATHS: Final = "swaths"
"""Fact of a ground cell: what :class:`~spl_batch.airborne.pulses.swaths.Swaths` found."""

OUTLINES: Final = "swath_outlines"
"""Fact of a ground cell: where each swath lies in it."""

COLUMNS: Final = (*COLUMNS_NEEDED, "line")
"""What is looked at, and ``noise_class, flags``."""


def usable(table: PointTable) -> NDArray[np.bool_]:
    """Signal that may be a return of a pulse: (n,) bool, of each point by itself."""
    noise_class = table["noise_class"]
    found: NDArray[np.bool_] = (noise_class == NOISE_SIGNAL) | (noise_class == NOISE_NOT_ASSESSED)
    return found & ~table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)


def covered(arrays: Mapping[str, NDArray[np.float32]], settings: ProductSettings) -> dict[str, Any]:
    """Raster cells of a ground cell that were flown, and those without terrain."""
    flown = arrays["density"] != NODATA
    returns = np.rint(arrays["density"][flown].astype(np.float64) * settings.cell_m**2)
    values, counts = np.unique(returns.astype(np.int64), return_counts=True)
    return {
        CELLS: dict(zip(map(str, values.tolist()), counts.tolist(), strict=True)),
        VOIDS: int(np.count_nonzero(arrays["dtm"][flown] == NODATA)),
    }


def pulse_facts(
    first: PointTable, density: NDArray[np.float32], core: Bounds, context: Context
) -> tuple[dict[str, Any], Swaths]:
    """How densely and evenly first returns cover what was flown of a ground cell, but water.

    ``first``: those of the cell and what its rasters read around it, with ``x, y, line``;
    ``density``: its raster, north up, which has a value where was flown.
    """
    x, y, products = first["x"], first["y"], context.workflow.products
    size = quanta(products.cell_m)
    dry = density[::-1] != NODATA
    if context.workflow.water is not None:
        row, column = np.nonzero(dry)
        east, north = core.xmin + column * size + size // 2, core.ymin + row * size + size // 2
        dry[row, column] = ~context.within(context.workflow.water, east, north)
    near = dry & covered_cells(x, y, core, products)
    own = inside(x, y, core)
    row, column = (y[own] - core.ymin) // size, (x[own] - core.xmin) // size
    swaths = Swaths(x, y, first["line"].astype(np.int64), core)
    counts = (near, near[row, column], dry & ~near)
    return {
        PULSES: [int(np.count_nonzero(some)) for some in counts],
        LEVELS: {
            level: list(coverage(x, y, near, core, spacing)) for level, spacing in SPACINGS.items()
        },
        SWATHS: swaths.facts(dry),
        OUTLINES: swaths.outlines(),
    }, swaths
