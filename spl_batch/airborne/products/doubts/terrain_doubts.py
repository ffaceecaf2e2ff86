"""Where a terrain model may be wrong: far from all ground, on a roof, or up a slope without ground.

Between ground returns heights are interpolated. Where the nearest one is far, and the ground
around rough for that distance, nobody knows what lies there; what the filter took for ground by
mistake is known to nobody either, but a roof shows its walls, and a wide deck two of them. Where
the model rises steeply through cells that hold no ground, while it does hold ground at its usual
spacing elsewhere, something was cut off or taken in: rims and spurs of cliffs, ends of bridge
decks, noise beyond a swath's edge.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.multiscale.raised_patches import Patch, raised_patches
from spl_batch.airborne.products.doubts.cut_off_blocks import cut_off_blocks
from spl_batch.airborne.products.doubts.dams_over_gaps import dams_over_gaps
from spl_batch.airborne.products.doubts.deck_ends import deck_ends
from spl_batch.airborne.products.doubts.raised_strips import raised_strips
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.lattice.tiles import Bounds
from spl_batch.numerics.nearest_cells import distances

DOMAIN: Final = "space"

FAR_M: Final = 5.0
"""Distance to the nearest ground from which on it is told: interpolated over 10 m [m]."""

UNSURE_M: Final = 0.5
"""Terrain that may be off by more than this is not known well [m]."""

GAP_M2: Final = 50.0
"""Smaller gaps are not told [m2]."""

STEEP: Final = 1.0
"""Slope from which on terrain without ground is told [rise/run]."""

STEEP_CELLS: Final = 25.0
"""Smaller patches of it are not told: in cells of a metre well-filled tiles have some of 11, steep
scenes whose terrain is right of 24 [squares of the usual spacing]."""

TALL_M: Final = 8.0
"""Of patches that rise by more, half as large ones are told: real tiles have none [m]."""

AROUND: Final = 15
"""Cells on each side whose ground tells the usual spacing [count]."""

CLIMBS: Final = "climbs"
"""Fact of a ground cell: each steep patch's area [m2], place [quanta] and rise [m]."""

GAPS: Final = "gaps"
"""Fact of a ground cell: each gap's area [m2], place [quanta], distance to ground and standard
deviation [m]."""

RAISED: Final = "raised"
"""Fact of a ground cell: each raised flat patch's area [m2], place [quanta] and height [m]."""

DECKS: Final = "decks"
"""Fact of a ground cell: each raised strip's area [m2], place [quanta] and height [m]."""

DAMS: Final = "dams"
"""Fact of a ground cell: each dam over a gap, its area [m2], place [quanta] and height [m]."""

ENDS: Final = "deck_ends"
"""Fact of a ground cell: each end of a deck, its area [m2], place [quanta] and height [m]."""

BLOCKS: Final = "blocks"
"""Fact of a ground cell: each raised block's area [m2], place [quanta] and height [m]."""

Grid = NDArray[np.float64]
Fact = list[float]


class Doubts(NamedTuple):
    """What speaks against a terrain model.

    Parameters
    ----------
    away_m : (rows, columns) float64
        Distance to the nearest cell with ground, row 0 northernmost [m].
    spacing : (rows, columns) float64
        Usual distance between cells with ground around each cell [cells].
    patches : sequence of Patch
        Raised flat patches; their rows count from the north, too.
    strips : sequence of Patch
        Raised strips between two walls, likewise.
    lowest : (rows, columns) float64
        Height of the lowest signal of each cell, row 0 northernmost [m]; NaN without any.
    """

    away_m: Grid
    spacing: Grid
    patches: Sequence[Patch]
    strips: Sequence[Patch] = ()
    lowest: Grid = np.empty((0, 0))


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
        away = distances(held) * cell_m
    spacing = np.rint(_spacing(held))
    rows, columns = away[inner].shape

    def owned(patches: Iterable[Patch]) -> list[Patch]:
        found = (
            patch._replace(row=rows - 1 - (patch.row - margin), column=patch.column - margin)
            for patch in patches
        )
        return [p for p in found if 0 <= p.row < rows and 0 <= p.column < columns]

    roofs, strips = owned(raised_patches(ground, cell_m)), owned(raised_strips(ground, cell_m))
    return Doubts(away[inner][::-1], spacing[inner][::-1], roofs, strips)


def _spacing(held: NDArray[np.bool_]) -> Grid:
    """Usual distance between cells with ground around each cell [cells]."""
    share = ndimage.uniform_filter(held.astype(np.float64), 2 * AROUND + 1, mode="nearest")
    return 1.0 / np.sqrt(np.maximum(share, (1.0 / (2 * AROUND + 1)) ** 2))


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
    edge_m = cell_q * QUANTUM_M
    far = known & (found.away_m > FAR_M) & (sigma > UNSURE_M)

    def place(row: int, column: int) -> list[float]:
        return _place(core, cell_q, row, column)

    gaps = []
    for patch in _hanging_together(far):
        area_m2, away = len(patch.T) * edge_m**2, found.away_m[tuple(patch)]
        if area_m2 >= GAP_M2:
            at = place(*patch.T[away.argmax()].tolist())
            sd_m = float(np.median(sigma[tuple(patch)]))
            gaps.append([area_m2, *at, float(away.max()), sd_m])
    climbs = []
    bare = found.away_m >= found.spacing * edge_m
    for patch in _hanging_together(_steep(arrays["dtm"], edge_m) & bare):
        rise = float(np.ptp(arrays["dtm"][tuple(patch)]))
        least = STEEP_CELLS / 2 if rise > TALL_M else STEEP_CELLS
        if np.sum(found.spacing[tuple(patch)] ** -2.0) >= least:
            off = np.abs(patch - patch.mean(axis=1, keepdims=True)).sum(axis=0)
            at = place(*patch.T[off.argmin()].tolist())
            climbs.append([len(patch.T) * edge_m**2, *at, rise])
    raised, decks = (
        [
            [patch.area_m2, *place(patch.row, patch.column), patch.height_m]
            for patch in patches
            if known[patch.row, patch.column]
        ]
        for patches in (found.patches, found.strips)
    )
    return {GAPS: gaps, RAISED: raised, DECKS: decks, CLIMBS: climbs}


def block_facts(
    found: Doubts, arrays: dict[str, NDArray[np.float32]], core: Bounds, cell_q: int
) -> dict[str, list[Fact]]:
    """Raised blocks that were cut off, dams over gaps below decks that were, and ends of these.

    Where they are the model is no surer than half their height.

    Parameters
    ----------
    found, core, cell_q
        As for :func:`doubt_facts`.
    arrays : dict of str to (rows, cols) float32
        Rasters of the cell; ``dtm_quality`` is raised.
    """
    dtm = np.where(arrays["dtm"] == NODATA, np.nan, arrays["dtm"].astype(np.float64))
    sigma, blocks = arrays["dtm_quality"].copy(), []
    for block in cut_off_blocks(found.lowest, dtm, found.away_m == 0.0, cell_q * QUANTUM_M):
        at = block.cells & ~np.isnan(dtm)
        sigma[at] = np.maximum(sigma[at], np.float32(block.height_m / 2))
        blocks.append(
            [block.area_m2, *_place(core, cell_q, block.row, block.column), block.height_m]
        )
    held, edge_m = found.away_m == 0.0, cell_q * QUANTUM_M
    facts = {BLOCKS: blocks}
    for name, some in (
        (DAMS, dams_over_gaps(dtm, found.lowest, found.away_m, edge_m)),
        (ENDS, deck_ends(dtm, found.lowest, held, edge_m)),
    ):
        facts[name] = []
        for one in some:
            cells = tuple(one.cells)
            sigma[cells] = np.maximum(sigma[cells], np.float32(one.height_m / 2))
            place = _place(core, cell_q, one.row, one.column)
            facts[name].append([one.area_m2, *place, one.height_m])
    arrays["dtm_quality"] = sigma
    return facts


def _place(core: Bounds, cell_q: int, row: int, column: int) -> list[float]:
    """Middle of a raster cell [quanta]."""
    return [
        float(core.xmin + column * cell_q + cell_q // 2),
        float(core.ymax - row * cell_q - cell_q // 2),
    ]


def _steep(dtm: NDArray[np.float32], cell_m: float) -> NDArray[np.bool_]:
    """Cells in which a terrain model is steep; none beside a void."""
    if min(dtm.shape) < 2:
        return np.zeros(dtm.shape, np.bool_)
    heights = np.where(dtm == NODATA, np.nan, dtm.astype(np.float64))
    steep: NDArray[np.bool_] = np.hypot(*np.gradient(heights, cell_m)) > STEEP
    return steep


def _hanging_together(marked: NDArray[np.bool_]) -> Iterator[NDArray[np.int64]]:
    """Rows and columns (2, n) of marked cells that touch, row by row, patch by patch."""
    numbers, _ = ndimage.label(marked, np.ones((3, 3)))
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        corner = [[side.start] for side in box]
        yield np.stack(np.nonzero(numbers[box] == number)) + np.array(corner)


def largest(facts: Sequence[Mapping[str, Any]], name: str) -> list[Fact]:
    """All gaps, patches or climbs of a survey, the largest first."""
    return sorted((one for some in facts for one in some.get(name, [])), reverse=True)
