"""Where the points of a region lie from west to east, and strips of it that hold about as many.

Points are told by slabs: rectangles that hold a number of them, evenly. A tile lies in canonical
order, so each run of its rows is such a slab; where points are told by a count alone, the tile is
one. Strips of equal width would hold all of a narrow flight in one of them.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tiles import Bounds

SLAB_POINTS = 65_536
"""Points of a slab of a tile [count]."""

EVEN_STEPS = 12
"""How often the most that a strip holds is halved down to what no fewer points allow [count]."""

Float = NDArray[np.float64]

T = TypeVar("T")


Slab = tuple[Sequence[float], float]
"""Half-open rectangle (xmin, ymin, xmax, ymax) [quanta], and the points that it holds."""


class Slabs(NamedTuple):
    """Points by slabs, of which regions hold shares."""

    box: Float  #: (s, 4): their rectangles [quanta].
    points: Float  #: (s,): what they hold [count].

    @classmethod
    def of(cls, slabs: Iterable[Slab]) -> Self:
        """Slabs as arrays."""
        listed = list(slabs)
        box = np.array([bounds for bounds, _ in listed], np.float64).reshape(-1, 4)
        return cls(box, np.array([count for _, count in listed], np.float64))

    def within(self, region: Bounds) -> float:
        """Points of a region [count]."""
        share = np.ones(len(self.points))
        for low, high in ((0, 2), (1, 3)):
            start = self.box[:, low]
            end = np.maximum(self.box[:, high], start + 1.0)
            there = np.minimum(end, region[high]) - np.maximum(start, region[low])
            share *= np.clip(there / (end - start), 0.0, 1.0)
        return round(float(share @ self.points), 6)


class Cut(NamedTuple):
    """Strips of a region."""

    ends: tuple[int, ...]  #: Where they begin, and where the last one ends [quanta].
    fullest: int  #: Points of the one with most, with what it reads around [count].

    @property
    def strips(self) -> int:
        """How many [count]."""
        return len(self.ends) - 1


class Eastings(NamedTuple):
    """Points of a region, by slabs from west to east."""

    region: Bounds
    west: Float  #: (s,): western and eastern end of each slab [quanta].
    east: Float
    points: Float  #: (s,): points of it that lie in the region [count].

    @classmethod
    def of_slabs(cls, slabs: Iterable[Slab], region: Bounds) -> Self:
        """Points of slabs that lie in a region.

        Parameters
        ----------
        slabs : iterable of ((xmin, ymin, xmax, ymax), points)
            Half-open rectangles [quanta] and what they hold.
        """
        listed = list(slabs)
        box = np.array([bounds for bounds, _ in listed], np.float64).reshape(-1, 4)
        points = np.array([count for _, count in listed], np.float64)
        high = np.maximum(box[:, 3] - box[:, 1], 1.0)
        within = np.minimum(box[:, 3], region.ymax) - np.maximum(box[:, 1], region.ymin)
        points = points * np.clip(within / high, 0.0, 1.0)
        return cls(region, box[:, 0], np.maximum(box[:, 2], box[:, 0] + 1.0), points)

    @classmethod
    def even(cls, points: float, region: Bounds) -> Self:
        """Points that spread evenly over a region."""
        return cls.of_slabs([(region, points)], region)

    @property
    def total(self) -> float:
        """Points of the region [count]."""
        low, high = self._before(np.array([self.region.xmin, self.region.xmax], np.float64))
        return float(high - low)

    def cut(self, step: int, reach: int, most: float) -> Cut:
        """Fewest strips of whole steps that hold no more than so many points, as even as can be.

        Parameters
        ----------
        step : int
            Strips begin at multiples of it [quanta].
        reach : int
            What a strip reads on either side [quanta].
        most : float
            Points that a strip may hold with those around; one of a single step may hold more
            [count].
        """
        west, east = self.region.xmin, self.region.xmax
        inner = range(west // step + 1, -(-east // step))
        at = np.array([west, *(step * k for k in inner), east], np.float64)
        low = self._before(np.maximum(at - reach, west))
        high = self._before(np.minimum(at + reach, east))
        found = _fewest(low, high, most)
        even = float(high[-1] - low[0]) / (len(found) - 1)
        # Where single steps hold more than may be, no others are to hold more as well.
        for _ in range(EVEN_STEPS if even < most else 0):
            middle = (even + most) / 2
            tried = _fewest(low, high, middle)
            if len(tried) == len(found):
                found, most = tried, middle
            else:
                even = middle
        fullest = max(high[past] - low[first] for first, past in pairwise(found))
        return Cut(tuple(int(at[k]) for k in found), math.ceil(round(fullest, 6)))

    def _before(self, x: Float) -> Float:
        """Points west of places."""
        share = (x[:, None] - self.west) / (self.east - self.west)
        found: Float = np.clip(share, 0.0, 1.0) @ self.points
        return found


def _fewest(low: Float, high: Float, most: float) -> list[int]:
    """Numbers of the places at which strips begin and end; each is as wide as may be."""
    found, last = [0], len(low) - 1
    while found[-1] < last:
        past = int(np.searchsorted(high, low[found[-1]] + most, side="right")) - 1
        found.append(min(max(past, found[-1] + 1), last))
    return found


def slabs_of(x: NDArray[np.int64], y: NDArray[np.int64]) -> list[list[int]]:
    """Slabs of the points of a tile, which lie in canonical order.

    Returns
    -------
    list of [xmin, ymin, xmax, ymax, points]
        Half-open rectangles [quanta], from west to east, each with what it holds.
    """
    starts = range(0, len(x), SLAB_POINTS)
    runs = [slice(start, start + SLAB_POINTS) for start in starts]
    return [
        [int(x[run][0]), int(y[run].min()), int(x[run][-1]) + 1, int(y[run].max()) + 1, len(x[run])]
        for run in runs
    ]


def strips_between(region: Bounds, cuts: Iterable[int]) -> list[Bounds]:
    """Strips of a region from west to east.

    Tiles are read by easting: a strip reads little else.

    ``cuts``: where strips begin, rising; those beyond the region make none [quanta].
    """
    inner = (cut for cut in cuts if region.xmin < cut < region.xmax)
    ends = [region.xmin, *inner, region.xmax]
    return [region._replace(xmin=west, xmax=east) for west, east in pairwise(ends)]


def once(parts: Sequence[Bounds], read: Callable[[Bounds], T]) -> Callable[[Bounds], T]:
    """Read what is asked for; where there is one part only, once."""
    if len(parts) > 1:
        return read
    only = read(parts[0])
    return lambda _: only
