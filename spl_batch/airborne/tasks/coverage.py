"""What a survey covers and how densely: counted by each ground cell, added up for the report."""

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.products.footprint import Within
from spl_batch.constants import NODATA
from spl_batch.formats.polygons import contains, read_polygons

_SQUARES: Final = "footprint"
"""Fact of a ground cell: squares that returns cover [count]."""

_CELLS: Final = "cells_by_returns"
"""Fact of a ground cell: raster cells that were flown, by the signal returns in them [count]."""

_VOIDS: Final = "voids"
"""Fact of a ground cell: raster cells that were flown and have no terrain height [count]."""


_HEIGHTS: Final = "heights"
"""Fact of a ground cell: raster cells with a terrain height [count]."""

_UNSURE: Final = "unsure"
"""Fact of a ground cell: those whose standard deviation is more than :data:`UNSURE_M` [count]."""

UNSURE_M: Final = 0.5
"""Terrain that may be off by more than this is not known well [m]."""


def of_interest(context: Context) -> Within | None:
    """Which places lie within the area of interest; None where there is none."""
    aoi = context.workflow.aoi
    if aoi is None:
        return None
    return partial(contains, read_polygons(context.resolve(aoi), context.crs))


def covered(
    squares: NDArray[np.bool_], arrays: Mapping[str, NDArray[np.float32]], context: Context
) -> dict[str, Any]:
    """Facts of a ground cell: whole numbers, so that sums do not depend on their order.

    Parameters
    ----------
    squares : (rows, cols) bool
        Its squares that returns cover, within the area of interest.
    arrays : mapping of str to (rows, cols) float32
        Its rasters; ``dtm``, ``dtm_quality`` and ``density`` are looked at.
    """
    products = context.workflow.products
    flown = arrays["density"] != NODATA
    returns = np.rint(arrays["density"][flown].astype(np.float64) * products.cell_m**2)
    values, counts = np.unique(returns.astype(np.int64), return_counts=True)
    return {
        _SQUARES: int(np.count_nonzero(squares)),
        _CELLS: dict(zip(map(str, values.tolist()), counts.tolist(), strict=True)),
        _VOIDS: int(np.count_nonzero(arrays["dtm"][flown] == NODATA)),
        _HEIGHTS: int(np.count_nonzero(arrays["dtm"] != NODATA)),
        _UNSURE: int(np.count_nonzero(arrays["dtm_quality"] > UNSURE_M)),
    }
