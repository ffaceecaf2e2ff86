"""How densely and evenly first returns cover the ground: spatial distribution, data voids, swaths.

Source: USGS Lidar Base Specification, Collection Requirements: spatial distribution, 90 % of the
squares of twice the nominal spacing hold a first return; data voids, areas of (4 x spacing)^2
without one. All swaths count together: voids may be filled by another one. Deviations: a void is a
whole empty square of four spacings, not any shape of its area; only places that were flown count.

Squares of 5 m that each flightline covers give its density, its outline, where flightlines overlap.
Source: USGS Lidar Base Specification 2025 rev. A, Collection Requirements. Nominal Pulse Spacing:
density is assessed "against single swath, first return data located within the geometrically usable
center portion (typically ~95%) of each swath". Spatial Distribution and Regularity: first returns
of a single file source id; 90 % of the squares of twice the nominal spacing hold one.

A flightline covers the squares of an absolute grid that hold one of its first returns. Its middle
are those whose eight neighbours it covers as well: nobody needs to know a path or an axis.
Deviation: what is left out at the edges is a rim of 5 to 10 m, not 5 % of the area.
"""

import base64
import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.features import shapes
from scipy import ndimage

from spl_batch.airborne.products.cell_values import at_centres, held, owned, shape_of
from spl_batch.airborne.products.wide_voids import SQUARES
from spl_batch.airborne.settings.standards import ASKED, LEVELS
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.row_order import distinct
from spl_batch.lattice.tiles import Bounds, grow, quanta

SPACINGS: Final[Mapping[str, int]] = {
    level.spacing: quanta(level.spacing_m) for level in LEVELS.values()
}
"""Aggregate nominal pulse spacing of a quality level, that of QL0 is QL1's [quanta]."""

EDGE_Q: Final = quanta(5.0)
"""Edge of a square [quanta]: more than twice the spacing of each quality level, so that a swath
fills it."""

SQUARE_M2: Final = (EDGE_Q * QUANTUM_M) ** 2
"""Area of a square [m2]."""

Found = list[int]
"""A swath of a region: number of its flightline; squares and first returns, of all and of its
middle; squares of twice the spacing in its middle and those filled, by spacing [count]."""

Outlined = tuple[int, list[int], str]
"""A swath of a region: number of its flightline; squares of the region, as :func:`owned` gives
them, and which of them it covers."""


class Coverage(NamedTuple):
    """Squares of a region that was flown, water excepted; counts of several regions add up."""

    #: Squares of twice the spacing; those that hold a first return [count].
    squares: int
    filled: int
    #: Squares of the spacing; those that lie in a data void [count].
    places: int
    void: int


def coverage(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    counted: NDArray[np.bool_],
    core: Bounds,
    spacing: int,
) -> Coverage:
    """Squares of a region by one of :data:`SPACINGS` [quanta].

    ``x, y``: first returns of the region and of five spacings around it [quanta]; ``counted``:
    cells of the region that count, row 0 southernmost.
    """
    pairs, places = owned(core, 2 * spacing), owned(core, spacing)
    wide = grow(places, ASKED.void_spacings)
    window = np.ones((ASKED.void_spacings, ASKED.void_spacings), np.bool_)
    void = ndimage.binary_opening(~held(x, y, wide, spacing), window)
    inner = slice(ASKED.void_spacings, -ASKED.void_spacings)
    there = at_centres(counted, core, pairs, 2 * spacing)
    beside = at_centres(counted, core, places, spacing)
    filled, empty = there & held(x, y, pairs, 2 * spacing), beside & void[inner, inner]
    return Coverage(*(int(np.count_nonzero(some)) for some in (there, filled, beside, empty)))


class SwathTotals(NamedTuple):
    """A swath, water excepted."""

    area_m2: float
    pulses: int
    #: The same of its middle, without the edges; squares of twice the spacing there, and filled.
    middle_m2: float
    middle_pulses: int
    squares: int
    filled: int


class Swaths:
    """Swaths of a region, from first returns of it and of two squares around it [quanta]."""

    def __init__(
        self, x: NDArray[np.int64], y: NDArray[np.int64], line: NDArray[np.int64], core: Bounds
    ) -> None:
        self._core, self._own = core, owned(core, EDGE_Q)
        self._near = grow(self._own, 1)
        self._numbers, self._rank = distinct(line)
        self._x, self._y = x, y
        row, column = y // EDGE_Q - self._near.ymin, x // EDGE_Q - self._near.xmin
        rows, columns = shape_of(self._near, 1)
        there = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        at = (self._rank[there] * rows + row[there]) * columns + column[there]
        count = np.bincount(at, minlength=len(self._numbers) * rows * columns)
        self._count = count.reshape(-1, rows, columns)

    def facts(self, dry: NDArray[np.bool_]) -> list[Found]:
        """What was found, by the cells that count, row 0 southernmost; facts of regions add up."""
        there, found = at_centres(dry, self._core, self._own, EDGE_Q), []
        for rank, number in enumerate(self._numbers.tolist()):
            count = self._count[rank]
            covered = there & (count[1:-1, 1:-1] > 0)
            middle = covered & ndimage.minimum_filter(count, 3)[1:-1, 1:-1].astype(np.bool_)
            sums = [
                int(some)
                for part in (covered, middle)
                for some in (np.count_nonzero(part), count[1:-1, 1:-1][part].sum())
            ]
            mine = self._rank == rank
            for spacing in SPACINGS.values():
                sums += self._filled(self._x[mine], self._y[mine], middle, 2 * spacing)
            if any(sums):
                found.append([number, *sums])
        return found

    def _filled(
        self, x: NDArray[np.int64], y: NDArray[np.int64], middle: NDArray[np.bool_], edge: int
    ) -> tuple[int, int]:
        """Squares of an edge in the middle of a swath, and those that hold a return [count]."""
        squares = owned(self._core, edge)
        column, row = (
            (np.arange(low, high) * edge + edge // 2) // EDGE_Q - first
            for low, high, first in (
                (squares.xmin, squares.xmax, self._own.xmin),
                (squares.ymin, squares.ymax, self._own.ymin),
            )
        )
        # a centre in the region may lie in a square of a neighbour's
        within = np.pad(middle, 1)[np.ix_(row + 1, column + 1)]
        filled = within & held(x, y, squares, edge)
        return int(np.count_nonzero(within)), int(np.count_nonzero(filled))

    def outlines(self) -> list[Outlined]:
        """Where each swath lies within the region, water or not."""
        found = []
        for number, count in zip(self._numbers.tolist(), self._count, strict=True):
            covered = count[1:-1, 1:-1] > 0
            if covered.any():
                bits = zlib.compress(np.packbits(covered).tobytes())
                text = base64.b85encode(bits).decode("ascii")
                found.append((number, list(self._own), text))
        return found

    def overlapping(self, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which places of the region lie where two flightlines or more do: (m,) bool.

        The flag "overlap" of a point marks it [LAS 1.4 R15, 2.6]; which of the swaths is surplus is
        left to whoever thins them.
        """
        several = np.count_nonzero(self._count, axis=0) > 1
        found: NDArray[np.bool_] = several[
            y // EDGE_Q - self._near.ymin, x // EDGE_Q - self._near.xmin
        ]
        return found


def by_flightline(
    found: Iterable[Sequence[Found]], names: Mapping[int, str], spacing: str
) -> dict[str, SwathTotals]:
    """Swaths of a survey, by the names of their flightlines.

    ``found``: what :meth:`Swaths.facts` gave, region by region; ``names``: of flightlines by their
    numbers, what has none is of the flightline ""; ``spacing``: key of
    :data:`~spl_batch.airborne.pulses.swaths.SPACINGS`.
    """
    sums: dict[str, NDArray[np.int64]] = {}
    for of_region in found:
        for number, *counts in of_region:
            name = names.get(number, "")
            sums[name] = sums.get(name, 0) + np.array(counts, np.int64)
    level = 4 + 2 * list(SPACINGS).index(spacing)
    return {name: _totals(sums[name], level) for name in sorted(sums) if sums[name][0]}


def _totals(sums: NDArray[Any], level: int) -> SwathTotals:
    area, pulses, middle, middle_pulses = sums[:4].tolist()
    if not middle:  # narrower than three squares
        middle, middle_pulses = area, pulses
    squares, filled = sums[level : level + 2].tolist()
    return SwathTotals(area * SQUARE_M2, pulses, middle * SQUARE_M2, middle_pulses, squares, filled)


def outlines(
    found: Iterable[Sequence[Outlined]], names: Mapping[int, str]
) -> dict[str, shapely.MultiPolygon]:
    """Outline of each flightline by its name, in the survey's CRS [m].

    A wide survey is drawn in coarser squares, and steps of squares become straight lines.
    ``found``: what :meth:`Swaths.outlines` gave, region by region; ``names``: of flightlines by
    their numbers, others are not drawn.
    """
    pieces: dict[str, list[tuple[Bounds, str]]] = {}
    for of_region in found:
        for number, squares, text in of_region:
            if number in names:
                pieces.setdefault(names[number], []).append((Bounds(*squares), text))
    return {name: _outline(listed) for name, listed in pieces.items()}


def _outline(pieces: Sequence[tuple[Bounds, str]]) -> shapely.MultiPolygon:
    squares = [piece for piece, _ in pieces]
    west, south = min(one.xmin for one in squares), min(one.ymin for one in squares)
    east, north = max(one.xmax for one in squares), max(one.ymax for one in squares)
    coarser = int(np.ceil(np.sqrt((north - south) * (east - west) / SQUARES)))
    west, south = (side // coarser * coarser for side in (west, south))
    drawn = np.zeros((-(-(north - south) // coarser), -(-(east - west) // coarser)), np.uint8)
    for piece, text in pieces:
        bits = np.frombuffer(zlib.decompress(base64.b85decode(text)), np.uint8)
        rows, columns = shape_of(piece, 1)
        at = np.nonzero(np.unpackbits(bits, count=rows * columns).reshape(rows, columns))
        drawn[(at[0] + piece.ymin - south) // coarser, (at[1] + piece.xmin - west) // coarser] = 1
    rings = [shapely.geometry.shape(one) for one, _ in shapes(drawn, mask=drawn > 0)]
    edge_m = EDGE_Q * QUANTUM_M
    corner = np.array([west, south]) * edge_m
    found = shapely.transform(
        shapely.simplify(shapely.union_all(rings), 1.0), lambda xy: xy * coarser * edge_m + corner
    )
    return found if found.geom_type == "MultiPolygon" else shapely.MultiPolygon([found])
