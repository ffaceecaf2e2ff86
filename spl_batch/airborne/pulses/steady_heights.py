r"""Whether one flightline gives a hard place one height: at all times, and bright or weak.

Domain: space, on first signal returns. Where recorded positions swing within seconds, looks at a
place that are moments apart lie at unlike heights. Where a detector's ranges walk, bright returns
lie above weak ones. Both make surfaces thicker than one shot shows them, and ground is lost.

Places are level squares of one flightline (:mod:`~spl_batch.airborne.pulses.level_places`);
heights are taken off their plane. A *look* is what lies in a cell of
:data:`~spl_batch.airborne.pulses.smooth_surfaces.EDGE_M` within :data:`LOOK_S`. By the analysis of
variance, with sums of squares between and within the looks of a cell,

.. math:: \sigma^2 = \frac{SS_b - (g - 1) s^2}{N - \sum n^2 / N}, \quad s^2 = SS_w / (N - g)

for g looks of n returns, N in all; sums are over the cells of a place. It is hard, and counts,
where s is no more than :data:`HARD` ranging spreads. Brightness is told by the weaker half of the
returns of a place and the rest; there the weaker half alone must be hard. What half of the places
exceed is told: crowns may look hard to a narrow array, but not most places. Our own rules: no
source has one.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.pulses.level_places import RETURNS, SQUARE_M, Places
from spl_batch.airborne.pulses.smooth_surfaces import EDGE_M, LEVEL
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tiles import quanta

DOMAIN: Final = "space"

LOOK_S: Final = 0.005
"""Pause that parts two looks: less than a turn of a scanner, more than it takes over a cell [s]."""

HARD: Final = 2.0
"""Most that returns of a hard place spread [ranging spreads]."""

THICKEST_M: Final = 0.8
"""Places whose returns spread by more about their plane are not looked at [m]."""

FEWEST: Final = 3
"""Returns of a look, at least [count]."""

BRIGHT: Final = RETURNS / 4
"""Returns of the bright part of a place, at least [count]."""

STEP_M: Final = 0.01
"""Steps in which places are counted [m]."""

Counts = dict[str, Counter[int]]
"""Places of a pass or a flightline by how they differ [:data:`STEP_M`]: ``looks``, the standard
deviation of their heights beyond ranging noise, and ``bright``, by how much bright returns lie
above others."""

KINDS: Final = ("looks", "bright")

Key = TypeVar("Key", int, str)

PLACES: Final = 20
"""Places that tell something, at least [count]."""


def typical_m(places: Mapping[int, int]) -> float | None:
    """Median of counted places [m]; None for few."""
    steps, counts = np.array(sorted(places.items()), np.int64).reshape(-1, 2).T
    total = counts.sum()
    if total < PLACES:
        return None
    return float(steps[np.searchsorted(counts.cumsum(), total / 2)]) * STEP_M


def add_counts(found: dict[Key, Counts], line: Key, more: Mapping[str, Mapping[int, int]]) -> None:
    """Add places of a pass or a flightline to those that are known."""
    known = found.setdefault(line, {kind: Counter() for kind in KINDS})
    for kind in KINDS:
        known[kind].update(more[kind])


def unsteady_places(
    places: Places, time_s: NDArray[np.float64], brightness: NDArray[np.uint16], sigma_m: float
) -> dict[int, Counts]:
    """Places by pass; those of several regions add up.

    Parameters
    ----------
    places : Places
        Of columns of squares, from :func:`~spl_batch.airborne.pulses.level_places.places_in`.
    time_s : (n,) float64
        Times of all returns [s].
    brightness : (n,) uint16
        Their recorded intensity.
    sigma_m : float
        Ranging spread that the sensor states [m].
    """
    good = (places.slope <= LEVEL) & (places.thickness <= quanta(THICKEST_M))
    mine = good[places.place]
    if not mine.any():
        return {}
    place, rows, hard = places.place[mine], places.rows[mine], HARD * quanta(sigma_m)
    x, y, z = places.offset[mine].T
    height = np.rint(z - places.east[place] * x - places.north[place] * y).astype(np.int64)
    parts = quanta(SQUARE_M) // quanta(EDGE_M)
    cell = (place * parts + y // quanta(EDGE_M)) * parts + x // quanta(EDGE_M)
    of_places = (
        _looks(height, cell, time_s[rows], parts**2, len(good), hard),
        _rises(height, place, brightness[rows], len(good), hard),
    )
    found: dict[int, Counts] = {}
    for line in np.unique(places.line).tolist():
        steps = [np.rint(values[places.line == line] / quanta(STEP_M)) for values in of_places]
        known = [some[np.isfinite(some)].astype(np.int64).tolist() for some in steps]
        add_counts(found, line, dict(zip(KINDS, map(Counter, known), strict=True)))
    return found


def _looks(
    height: NDArray[np.int64], cell: NDArray[np.int64], time_s: NDArray[np.float64],
    cells: int, places: int, hard: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Standard deviation of the heights of looks, by place; NaN where none is hard: (places,)."""
    order = lexicographic_order([time_s])
    order = order[lexicographic_order([cell[order]])]
    height, cell, time_s = height[order], cell[order], time_s[order]
    opens = np.diff(cell, prepend=-1) != 0
    opens |= np.diff(time_s, prepend=-np.inf) > LOOK_S
    begin = np.flatnonzero(opens)
    n, cell = np.diff(begin, append=len(height)), cell[begin]
    one, two = (np.add.reduceat(height**k, begin) for k in (1, 2))
    many = n >= FEWEST
    n, one, two, cell = n[many], one[many], two[many], cell[many]

    def added(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(cell, values, places * cells).astype(np.float64)

    total, looks, squares = added(n), added(np.ones(len(n))), added(n * n)
    within = added(two - one**2 / n)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = added(one**2 / n) - added(one) ** 2 / total
        reduced = total - squares / total
    several = looks > 1
    between, within, free, own, reduced = (
        np.where(several, values, 0.0).reshape(places, cells).sum(axis=1)
        for values in (between, within, looks - 1, total - looks, reduced)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = (between - free * within / own) / reduced
        good = (own > 0) & (within <= hard**2 * own)
    return np.where(good, np.sqrt(np.maximum(variance, 0.0)), np.nan)


def _rises(
    height: NDArray[np.int64], place: NDArray[np.int64], brightness: NDArray[np.uint16],
    places: int, hard: float,
) -> NDArray[np.float64]:  # fmt: skip
    """By how much bright returns lie above others, by place; NaN where not hard: (places,)."""
    order = lexicographic_order([place, brightness])
    height, place, brightness = height[order], place[order], brightness[order]
    count = np.bincount(place, minlength=places)
    begin = np.cumsum(count) - count
    middle = brightness[np.minimum(begin + (count - 1) // 2, len(brightness) - 1)]
    bright = brightness > middle[place]

    def added(values: NDArray[np.int64], chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
        return np.bincount(place[chosen], values[chosen], places).astype(np.float64)

    n, one, two = (added(height**k, ~bright) for k in (0, 1, 2))
    more, sum_more = (added(height**k, bright) for k in (0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = (two - one**2 / n) / (n - 1)
        rise = sum_more / more - one / n
    good = (n > 1) & (more >= BRIGHT) & (spread <= hard**2)
    return np.where(good, rise, np.nan)


def as_facts(found: Mapping[int, Counts]) -> dict[str, dict[str, list[tuple[int, int]]]]:
    """Places as a receipt has them: by the number of the pass and kind, steps and counts."""
    return {
        str(line): {kind: sorted(found[line][kind].items()) for kind in KINDS}
        for line in sorted(found)
    }
