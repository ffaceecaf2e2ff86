"""How densely and evenly the first returns of single swaths lie, apart from their edges.

Source: USGS Lidar Base Specification 2025 rev. A, Collection Requirements. Nominal Pulse Spacing:
density is assessed "against single swath, first return data located within the geometrically usable
center portion (typically ~95%) of each swath". Spatial Distribution and Regularity: first returns
of a single file source id; 90 % of the squares of twice the nominal spacing hold one.

A swath covers the squares of 1 m that hold one of its first returns, and gaps between them that no
disc of :data:`GAP` fits into. What lies equally far from its edge is a ring; rings of all regions
add up, and the outermost whole ones that make 5 % of the area are left out. Nobody needs to know a
path or an axis. Deviation: no ring deeper than :data:`RINGS`, or than a region's margin tells, is
left out, so that of swaths wider than some 800 m more than the middle 95 % is judged.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.products.flown_cells import close
from spl_batch.airborne.pulses.pulse_coverage import SPACINGS
from spl_batch.airborne.pulses.square_kernels import add_rings, count_squares, mark_squares
from spl_batch.airborne.pulses.swath_outline import Packed, outline, packed
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.distinct import distinct
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tiles import Bounds, grow, quanta
from spl_batch.numerics.nearest_cells import distances

DOMAIN: Final = "space"

EDGE_Q: Final = quanta(1.0)
"""Edge of a square of a swath [quanta]."""

GAP: Final = 8
"""Radius of the disc that gaps within a swath have no room for [squares]."""

RINGS: Final = 30
"""Rings that may be told apart, from the edge of a swath [count]."""

EDGE_SHARE: Final = 0.05
"""Share of a swath's area that its edges are, 0..1."""

SQUARE_M2: Final = (EDGE_Q * QUANTUM_M) ** 2
"""Area of a square of a swath [m2]."""

Found = tuple[int, list[list[int]]]
"""A swath of a region: number of its flightline, rings.

A ring is its number, first returns, squares of a swath, and squares of twice the spacing and those
filled, by spacing.
"""

Outlined = tuple[int, Packed]
"""A swath of a region: number of its flightline, and where it lies."""

Names = Mapping[int, str]
"""Names of flightlines by their numbers."""


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
    """Swaths of a region.

    Parameters
    ----------
    core : Bounds
        The region [quanta].
    reach_q : int
        How far around it returns come [quanta].
    """

    def __init__(self, core: Bounds, reach_q: int) -> None:
        self._core = core
        near = grow(core, reach_q)
        low = (edge // EDGE_Q for edge in near[:2])
        self._near = Bounds(*low, *(-(-edge // EDGE_Q) for edge in near[2:]))
        self._deepest = max(min(RINGS, reach_q // EDGE_Q - 2 * GAP - 2), 0)
        self._squares = {name: _owned(core, 2 * spacing) for name, spacing in SPACINGS.items()}
        self._held: dict[int, _Held] = {}

    def add(self, x: NDArray[np.int64], y: NDArray[np.int64], line: NDArray[np.int64]) -> None:
        """Take first returns in, in any order: places [quanta], and flightlines."""
        numbers, rank = distinct(line)
        order = lexicographic_order([rank])
        x, y = x[order], y[order]
        ends = np.cumsum(np.bincount(rank, minlength=len(numbers))).tolist()
        for one, start, end in zip(numbers.tolist(), [0, *ends], ends, strict=False):
            if one not in self._held:
                self._held[one] = _Held(self._near, self._squares)
            self._held[one].add(x[start:end], y[start:end], self._near, self._squares)

    def facts(self, there: NDArray[np.bool_], region: Bounds) -> list[Found]:
        """What was found; facts of several regions add up.

        Parameters
        ----------
        there : (rows, cols) bool
            Which squares of a region around the core count, row 0 southernmost.
        region : Bounds
            That region [quanta].
        """
        return [
            (line, rings)
            for line, held, closed in self._closed
            if (rings := self._rings(held, closed, there, region))
        ]

    def outlines(self) -> list[Outlined]:
        """Where each swath lies within the region, water or not."""
        own = _owned(self._core, EDGE_Q)
        rows = slice(own.ymin - self._near.ymin, own.ymax - self._near.ymin)
        columns = slice(own.xmin - self._near.xmin, own.xmax - self._near.xmin)
        return [
            (line, squares)
            for line, _, closed in self._closed
            if (squares := packed(closed[rows, columns], own)) is not None
        ]

    @cached_property
    def _closed(self) -> list[tuple[int, "_Held", NDArray[np.bool_]]]:
        """Flightlines, and the squares of 1 m that they cover."""
        return [
            (line, held, close(held.count > 0, GAP)) for line, held in sorted(self._held.items())
        ]

    def _rings(
        self,
        held: "_Held",
        closed: NDArray[np.bool_],
        there: NDArray[np.bool_],
        region: Bounds,
    ) -> list[list[int]]:
        """Rings of a swath within the region that have an area."""
        depth = np.full(closed.shape, self._deepest)
        if not closed.all():
            depth = np.minimum(distances(~closed).astype(np.int64) - 1, self._deepest)
        sums = np.zeros((2 + 2 * len(SPACINGS), self._deepest + 1), np.int64)

        def add(squares: Bounds, edge: int, held: NDArray[Any], into: tuple[int, int]) -> None:
            x, y = (
                np.arange(low, high) * edge + edge // 2
                for low, high in ((squares.xmin, squares.xmax), (squares.ymin, squares.ymax))
            )
            row, column = y // EDGE_Q - self._near.ymin, x // EDGE_Q - self._near.xmin
            where = places_on(there, region, x, y)
            add_rings(depth, row, column, there, *where, held, *(sums[k] for k in into))

        own = _owned(self._core, EDGE_Q)
        south, west = own.ymin - self._near.ymin, own.xmin - self._near.xmin
        rows, columns = _shape(own)
        returns = held.count[south : south + rows, west : west + columns]
        add(own, EDGE_Q, np.ascontiguousarray(returns), (1, 0))
        for k, (name, spacing) in enumerate(SPACINGS.items()):
            add(self._squares[name], 2 * spacing, held.filled[name], (2 + 2 * k, 3 + 2 * k))
        found = np.flatnonzero(sums.any(axis=0))
        return [[k, *sums[:, k].tolist()] for k in found.tolist()]


class _Held:
    """First returns of a flightline: how many by squares of 1 m, and which squares hold any."""

    def __init__(self, near: Bounds, squares: dict[str, Bounds]) -> None:
        self.count = np.zeros(_shape(near), np.int64)
        self.filled = {name: np.zeros(_shape(own), np.bool_) for name, own in squares.items()}

    def add(
        self, x: NDArray[np.int64], y: NDArray[np.int64], near: Bounds, squares: dict[str, Bounds]
    ) -> None:
        count_squares(x, y, near.xmin, near.ymin, EDGE_Q, self.count)
        for name, own in squares.items():
            edge = 2 * SPACINGS[name]
            mark_squares(x, y, own.xmin, own.ymin, edge, self.filled[name])


def _owned(core: Bounds, edge: int) -> Bounds:
    """Squares of an absolute grid whose centres lie in a region."""
    return Bounds(*(-(-(side - edge // 2) // edge) for side in core))


def _shape(squares: Bounds) -> tuple[int, int]:
    return squares.ymax - squares.ymin, squares.xmax - squares.xmin


def at_places(
    there: NDArray[np.bool_], region: Bounds, x: NDArray[np.int64], y: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """What an array over a region says at places on a grid; at the edge what lies beside."""
    row, column = places_on(there, region, x, y)
    found: NDArray[np.bool_] = there.take(row, axis=0).take(column, axis=1)
    return found


def places_on(
    there: NDArray[np.bool_], region: Bounds, x: NDArray[np.int64], y: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of an array over a region where places on a grid lie."""
    rows, columns = there.shape
    size = (region.xmax - region.xmin) // columns
    column = ((x - region.xmin) // size).clip(0, columns - 1)
    row = ((y - region.ymin) // size).clip(0, rows - 1)
    return row, column


def by_flightline(
    found: Iterable[Sequence[Found]], names: Names, spacing: str
) -> dict[str, SwathTotals]:
    """Swaths of a survey, by the names of their flightlines; what has no area is left out.

    Parameters
    ----------
    found : iterable of sequence of Found
        What :meth:`Swaths.facts` found in each region, or a receipt has of it.
    names : mapping of int to str
        Names of the flightlines by their numbers; points of others have none.
    spacing : str
        Which of :data:`~spl_batch.airborne.pulses.pulse_coverage.SPACINGS`.
    """
    sums: dict[str, NDArray[np.int64]] = {}
    for of_region in found:
        for line, rings in of_region:
            name = names.get(line, "")
            total = sums.setdefault(name, np.zeros((RINGS + 1, 2 + 2 * len(SPACINGS)), np.int64))
            for number, *counts in rings:
                total[number] += counts
    level = 2 + 2 * list(SPACINGS).index(spacing)
    return {name: _totals(sums[name], level) for name in sorted(sums) if sums[name][:, 1].any()}


def outlines(found: Iterable[Sequence[Outlined]], names: Names) -> dict[str, shapely.MultiPolygon]:
    """Outline of each flightline, by its name.

    Parameters
    ----------
    found : iterable of sequence of Outlined
        What :meth:`Swaths.outlines` found in each region, or a receipt has of it.
    names : mapping of int to str
        Names of the flightlines by their numbers; points of others have none.
    """
    pieces: dict[str, list[Packed]] = {}
    for of_region in found:
        for line, squares in of_region:
            name = names.get(line, "")
            pieces.setdefault(name, []).append(squares)
    return {name: outline(of_line) for name, of_line in pieces.items() if name}


def _totals(rings: NDArray[np.int64], level: int) -> SwathTotals:
    whole = rings.sum(axis=0)
    edges = int(np.searchsorted(rings[:, 1].cumsum(), EDGE_SHARE * whole[1])) + 1
    deepest = int(np.flatnonzero(rings[:, 1]).max())
    middle = rings[min(edges, deepest) :].sum(axis=0)
    return SwathTotals(
        area_m2=float(whole[1]) * SQUARE_M2,
        pulses=int(whole[0]),
        middle_m2=float(middle[1]) * SQUARE_M2,
        middle_pulses=int(middle[0]),
        squares=int(middle[level]),
        filled=int(middle[level + 1]),
    )
