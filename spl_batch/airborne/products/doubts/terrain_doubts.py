"""Where a terrain model may be wrong: far from all ground, or on a roof.

Between ground returns heights are interpolated. Where the nearest one is far, and the ground
around rough for that distance, nobody knows what lies there; what the filter took for ground by
mistake is known to nobody either, but a roof shows its walls.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.doubts.raised_patches import Patch, raised_patches
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.lattice.tiles import Bounds

DOMAIN: Final = "space"

FAR_M: Final = 5.0
"""Distance to the nearest ground from which on it is told: interpolated over 10 m [m]."""

UNSURE_M: Final = 0.5
"""Terrain that may be off by more than this is not known well [m]."""

GAP_M2: Final = 50.0
"""Smaller gaps are not told [m2]."""

GAPS: Final = "gaps"
"""Fact of a ground cell: each gap's area [m2], place [quanta], distance to ground and standard
deviation [m]."""

RAISED: Final = "raised"
"""Fact of a ground cell: each raised flat patch's area [m2], place [quanta] and height [m]."""

Grid = NDArray[np.float64]
Fact = list[float]


class Doubts(NamedTuple):
    """What speaks against a terrain model.

    Parameters
    ----------
    away_m : (rows, columns) float64
        Distance to the nearest cell with ground, row 0 northernmost [m].
    patches : sequence of Patch
        Raised flat patches; their rows count from the north, too.
    """

    away_m: Grid
    patches: Sequence[Patch]


def doubts(ground: Grid, margin: int, cell_m: float) -> Doubts:
    """What speaks against the terrain of an area within a margin.

    Parameters
    ----------
    ground : (rows, columns) float64
        Mean height of the ground in each cell [m], row 0 southernmost; NaN without.
    margin : int
        Cells around the area that take part [count].
    cell_m : float
        Edge of a cell [m].
    """
    inner = slice(margin, len(ground) - margin), slice(margin, ground.shape[1] - margin)
    held = ~np.isnan(ground)
    away = np.full(ground.shape, np.inf)
    if held.any():
        away = ndimage.distance_transform_edt(~held) * cell_m
    rows, columns = away[inner].shape
    found = (
        patch._replace(row=rows - 1 - (patch.row - margin), column=patch.column - margin)
        for patch in raised_patches(ground, cell_m)
    )
    owned = [p for p in found if 0 <= p.row < rows and 0 <= p.column < columns]
    return Doubts(away[inner][::-1], owned)


def doubt_facts(
    found: Doubts, arrays: Mapping[str, NDArray[np.float32]], core: Bounds, cell_q: int
) -> dict[str, list[Fact]]:
    """What the report needs to know; places that a model leaves out are none.

    Parameters
    ----------
    found : Doubts
        Of a ground cell.
    arrays : mapping of str to (rows, columns) float32
        Its rasters; ``dtm`` and ``dtm_quality`` are looked at.
    core : Bounds
        The ground cell [quanta].
    cell_q : int
        Edge of a raster cell [quanta].
    """
    known, sigma = arrays["dtm"] != NODATA, arrays["dtm_quality"]
    far = known & (found.away_m > FAR_M) & (sigma > UNSURE_M)

    def place(row: int, column: int) -> list[float]:
        return [
            float(core.xmin + column * cell_q + cell_q // 2),
            float(core.ymax - row * cell_q - cell_q // 2),
        ]

    numbers, _ = ndimage.label(far)
    gaps = []
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        mine = numbers[box] == number
        area_m2 = float(mine.sum()) * (cell_q * QUANTUM_M) ** 2
        if area_m2 < GAP_M2:
            continue
        away = np.where(mine, found.away_m[box], -1.0)
        row, column = np.unravel_index(away.argmax(), away.shape)
        at = place(int(row + box[0].start), int(column + box[1].start))
        gaps.append([area_m2, *at, float(away.max()), float(np.median(sigma[box][mine]))])
    raised = [
        [patch.area_m2, *place(patch.row, patch.column), patch.height_m]
        for patch in found.patches
        if known[patch.row, patch.column]
    ]
    return {GAPS: gaps, RAISED: raised}


def largest(facts: Sequence[Mapping[str, Any]], name: str) -> list[Fact]:
    """All gaps or patches of a survey, the largest first."""
    return sorted((one for some in facts for one in some.get(name, [])), reverse=True)
