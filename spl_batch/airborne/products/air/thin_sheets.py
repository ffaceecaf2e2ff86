r"""Sheets of haze thinner than the blocks of :mod:`~spl_batch.airborne.products.air.thin_haze`.

Domain: space. A sheet of a metre or two is a thin part of a block, and thickens no layer of noise:
it stays signal and becomes the surface. Of each place of 10 m the fullest :data:`WINDOW_M` of
height are looked at near which little else hangs above and below: crowns are deeper. They hold a
*sheet* if

- returns lie there by chance over cells of 1 m, as in air: wires lie in lines;
- within such cells they lie at unlike heights: roofs, of glass too, decks and wires do not;
- nearly everywhere something lies below them: halls, decks and closed crowns hide it.

Heights are level ones, or those above the ground where that fits better. A sheet counts for the
blocks around it, is told with them, and nothing is removed. Our own rule: no source has one.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.air.near_ground import CELL_M, HALF_M, SQUARE_M, Placed
from spl_batch.airborne.products.air.thin_haze import BLOCK, BLOCKS, TOP
from spl_batch.lattice.tiles import quanta

DOMAIN: Final = "space"

LOWEST_M: Final = 8.0
"""Height above the floor from which on sheets are looked for [m]."""

WINDOW_M: Final = 3.0
"""Height that holds a sheet, and what is empty above and below it [m]."""

LEAST: Final = 30
"""Returns of a sheet in a place [count]."""

BESIDE: Final = 0.2
"""Most returns just above and below a sheet, over its own."""

CLUMPED: Final = 1.5
"""Largest clumping over cells of 1 m; conductors 2 m apart have 2."""

STEP_M: Final = 0.25
FLAT: Final = 0.4
"""Most pairs of returns in a cell of 1 m that lie in the same step of height, over all of its
pairs: in a metre of air a quarter, on a roof, a deck or a wire most [m, 1]."""

REACH: Final = 1.0
"""How far the middle of a window lies from those of its blocks, at most [m]."""

SEEN: Final = 0.9
"""Least share of a sheet's cells of 2 m with something below."""

CLEAR: Final = 1.25
"""Least number of returns below, over the sheet's own: crowns that close leave fewer."""

_HIGH: Final = round(WINDOW_M / HALF_M)
_FIRST: Final = round(LOWEST_M / HALF_M)
_LAYERS: Final = round(TOP / HALF_M)
"""Height of a window, where the lowest one begins, and where the highest one ends [half metres]."""


def sheets(points: Placed) -> NDArray[np.bool_]:
    """Blocks of each place that hold a sheet: (rows, columns, BLOCKS) bool, as filled blocks."""
    found = np.zeros((*points.shape, BLOCKS), np.bool_)
    block = np.arange(BLOCKS)
    for heights in (points.level, points.half_metre):
        low = _windows(points, heights)
        low[~_holds_air(points, heights, low)] = -1
        middle = ((low + 0.5 * _HIGH) * HALF_M).reshape(-1, 1)
        near = np.abs(block + 0.5 * BLOCK - middle) <= REACH
        found |= (near & (low >= 0).reshape(-1, 1)).reshape(found.shape)
    return found


def _windows(points: Placed, heights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Lowest half metre of the fullest window of each place that is alone: (places,) int64.

    -1 where all windows hold few returns, or others lie near above or below.
    """
    places = len(points.grounded)
    aloft = points.kept & (heights >= _FIRST - _HIGH) & (heights < _LAYERS)
    number = points.place[aloft] * _LAYERS + heights[aloft].astype(np.int64)
    count = np.bincount(number, minlength=places * _LAYERS).reshape(places, _LAYERS)
    total = np.cumsum(np.pad(count, ((0, 0), (1, 2 * _HIGH))), axis=1)
    window = total[:, _HIGH:] - total[:, :-_HIGH]
    end = _LAYERS - _HIGH + 1
    own = window[:, _FIRST:end]
    beside = window[:, _FIRST - _HIGH : end - _HIGH] + window[:, _FIRST + _HIGH : end + _HIGH]
    alone = (own >= LEAST) & (beside <= BESIDE * own) & points.grounded.reshape(-1, 1)
    best = np.where(alone, own, -1).argmax(axis=1)
    return np.where(alone.any(axis=1), best + _FIRST, -1)


def _holds_air(
    points: Placed, heights: NDArray[np.float64], low: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether what lies in a window is spread as in air, and the ground is seen: (places,) bool."""
    places, parts = len(low), quanta(SQUARE_M) // quanta(CELL_M)
    mine = np.flatnonzero(points.kept & (low[points.place] >= 0))
    place, height = points.place[mine], heights[mine] - low[points.place[mine]]
    cell = place * parts**2 + points.within[mine]
    wide = (cell // parts // 2 * parts + cell % parts) // 2
    there, below = (height >= 0) & (height < _HIGH), height < -_HIGH
    count = np.bincount(cell[there], minlength=places * parts**2)
    pairs, own = (some.reshape(places, -1).sum(axis=1) for some in (count * (count - 1), count))
    held, seen = (np.bincount(wide[some], minlength=places * parts**2 // 4) > 0
                  for some in (there, below))  # fmt: skip
    covered, also = (some.reshape(places, -1).sum(axis=1) for some in (held, held & seen))
    good: NDArray[np.bool_] = parts**2 * pairs <= CLUMPED * own.astype(np.float64) ** 2
    good &= also >= SEEN * covered
    good &= np.bincount(place[below], minlength=places) >= CLEAR * own
    good &= _together(points.z[mine][there], cell[there], places) <= FLAT * pairs
    return good


def _together(z: NDArray[np.int32], cell: NDArray[np.int64], places: int) -> NDArray[np.int64]:
    """Pairs of returns of a cell in the same :data:`STEP_M` of height: (places,) [count]."""
    parts = (quanta(SQUARE_M) // quanta(CELL_M)) ** 2
    step = z.astype(np.int64) // quanta(STEP_M)
    low = int(step.min(initial=0))
    layers = int(step.max(initial=0)) - low + 1
    number, count = np.unique(cell * layers + step - low, return_counts=True)
    found = np.zeros(places, np.int64)
    np.add.at(found, number // (layers * parts), count * (count - 1))
    return found
