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

from collections.abc import Iterable, Iterator, Sequence
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

PASS_S: Final = 60
"""Returns of one point source id in this minute or the next one are of one pass [s]."""

NO_TIME: Final = -(2**40)
"""Minute of what has no time."""

SQUARE_M2: Final = (EDGE_Q * QUANTUM_M) ** 2
"""Area of a square of a swath [m2]."""

Found = tuple[int, int, int, list[list[int]]]
"""A swath of a region: point source id, first and last minute, rings.

A ring is its number, first returns, squares of a swath, and squares of twice the spacing and those
filled, by spacing.
"""

Outlined = tuple[int, int, int, Packed]
"""A swath of a region: point source id, first and last minute, and where it lies."""

Flown = tuple[str, int, float, float]
"""Name, point source id, first and last time of a flightline [s]."""


class SwathTotals(NamedTuple):
    """A swath, water excepted."""

    area_m2: float
    pulses: int
    #: The same of its middle, without the edges; squares of twice the spacing there, and filled.
    middle_m2: float
    middle_pulses: int
    squares: int
    filled: int


def pass_of(time_s: NDArray[np.float64], psid: NDArray[np.uint16]) -> NDArray[np.int64]:
    """A number for each pass of a flightline by the minute; one that turns comes back later.

    :data:`NO_TIME` stands for the minute of returns without a time.
    """
    minute = np.nan_to_num(np.floor(time_s / PASS_S), nan=NO_TIME).astype(np.int64)
    return minute * 2**16 + psid


class Swaths:
    """Swaths of a region; their first returns come part by part.

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

    def add(self, x: NDArray[np.int64], y: NDArray[np.int64], number: NDArray[np.int64]) -> None:
        """Take first returns in, in any order: places [quanta], and what :func:`pass_of` says."""
        numbers, rank = distinct(number)
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
            (psid, first, last, rings)
            for psid, first, last, held, closed in self._closed
            if (rings := self._rings(held, closed, there, region))
        ]

    def outlines(self) -> list[Outlined]:
        """Where each pass lies within the region, water or not."""
        own = _owned(self._core, EDGE_Q)
        rows = slice(own.ymin - self._near.ymin, own.ymax - self._near.ymin)
        columns = slice(own.xmin - self._near.xmin, own.xmax - self._near.xmin)
        return [
            (psid, first, last, squares)
            for psid, first, last, _, closed in self._closed
            if (squares := packed(closed[rows, columns], own)) is not None
        ]

    @cached_property
    def _closed(self) -> list[tuple[int, int, int, "_Held", NDArray[np.bool_]]]:
        """Passes, and the squares of 1 m that they cover."""
        return [
            (psid, first, last, held, close(held.count > 0, GAP))
            for psid, first, last, held in self._passes()
        ]

    def _passes(self) -> Iterator[tuple[int, int, int, "_Held"]]:
        """Point source id, first and last minute of each pass, and its returns."""
        keys = sorted((key % 2**16, key // 2**16) for key in self._held)
        for k, (psid, minute) in enumerate(keys):
            if not k or keys[k - 1] != (psid, minute - 1):
                first, held = minute, self._held[minute * 2**16 + psid]
            else:
                held = held.with_those_of(self._held[minute * 2**16 + psid])
            if k + 1 == len(keys) or keys[k + 1] != (psid, minute + 1):
                yield psid, first, minute, held

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
    """First returns of a pass: how many by squares of 1 m, and which squares hold any."""

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

    def with_those_of(self, other: "_Held") -> "_Held":
        both = object.__new__(_Held)
        both.count = self.count + other.count
        both.filled = {name: mine | other.filled[name] for name, mine in self.filled.items()}
        return both


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
    found: Iterable[Sequence[Found]], flown: Sequence[Flown], spacing: str
) -> dict[str, SwathTotals]:
    """Swaths of a survey, by the names of their flightlines; what has no area is left out.

    Parameters
    ----------
    found : iterable of sequence of Found
        What :meth:`Swaths.facts` found in each region, or a receipt has of it.
    flown : sequence of (str, int, float, float)
        The flightlines.
    spacing : str
        Which of :data:`~spl_batch.airborne.pulses.pulse_coverage.SPACINGS`.
    """
    sums: dict[str, NDArray[np.int64]] = {}
    for of_region in found:
        for psid, first, last, rings in of_region:
            name = _flightline(psid, first, last, flown)
            total = sums.setdefault(name, np.zeros((RINGS + 1, 2 + 2 * len(SPACINGS)), np.int64))
            for number, *counts in rings:
                total[number] += counts
    level = 2 + 2 * list(SPACINGS).index(spacing)
    return {name: _totals(sums[name], level) for name in sorted(sums) if sums[name][:, 1].any()}


def outlines(
    found: Iterable[Sequence[Outlined]], flown: Sequence[Flown]
) -> dict[str, shapely.MultiPolygon]:
    """Outline of each flightline, by its name.

    Parameters
    ----------
    found : iterable of sequence of Outlined
        What :meth:`Swaths.outlines` found in each region, or a receipt has of it.
    flown : sequence of (str, int, float, float)
        The flightlines.
    """
    pieces: dict[str, list[Packed]] = {}
    for of_region in found:
        for psid, first, last, squares in of_region:
            name = _flightline(psid, first, last, flown)
            pieces.setdefault(name, []).append(squares)
    return {name: outline(of_line) for name, of_line in pieces.items() if name}


def _flightline(psid: int, first: int, last: int, flown: Sequence[Flown]) -> str:
    """Name of the flightline that a pass belongs to most of all; empty if it has no time."""
    shared = {
        name: min(end, (last + 1) * PASS_S) - max(start, first * PASS_S)
        for name, of_line, start, end in flown
        if of_line == psid
    }
    best = max(shared, key=lambda name: (shared[name], name), default="")
    return best if best and shared[best] >= 0 else ""


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
