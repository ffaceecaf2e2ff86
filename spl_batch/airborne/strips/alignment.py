"""Shifts of flightlines that a run applies: how sure each one is, and which flightlines stay.

Each pair tells how far its second flightline lies from the first. The shifts make all pairs fit
best, by least squares; pairs that do not fit the others count less (Huber's weights). Overlaps do
not tell where all flightlines lie together: of those that hang together one is held, and all are
shifted against it. It is the one to which the others, weighted by their returns, come by the
shortest way. So where most fit, they stay, and one that is off does not draw them along, as it
would with a mean of zero.

A flightline stays where nothing compares it with another, where its shift is less than
:data:`SURE` of its standard deviations (:data:`SURE_ACROSS` on the map), and where it is more than
:data:`MOST_M`, which is a fault of another kind; the others are then solved without it.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from spl_batch.airborne.strips.pair_table import (
    FEW_M,
    HUBER,
    OWN_M,
    UNKNOWNS,
    PairDifference,
    student_t,
)
from spl_batch.constants import QUANTA_PER_M

SURE: Final = 2.0
"""Standard deviations of a shift in height from which on it is applied."""

SURE_ACROSS: Final = 2.5
"""The same of one on the map: two directions have twice the chance to seem off by accident. One
flightline in 22 that fits is shifted all the same, as in height."""

MOST_M: Final = 2.0
"""Longest shift that is applied [m]."""

NORMAL: Final = 3.0
"""What :func:`~spl_batch.airborne.strips.pair_table.student_t` stands for [standard deviations]."""

ROUNDS: Final = 10
"""Rounds of weights [count]."""

COLUMNS_AT_ONCE: Final = 256
"""Columns of the inverse that are held at once [count]."""

HELD: Final = "held"
ALONE: Final = "not compared"
UNSURE: Final = "not sure"
TOO_FAR: Final = "too far"
"""Why a flightline stays."""


class Alignment(NamedTuple):
    """By how much a flightline is shifted."""

    name: str
    #: What is added to its coordinates, whole quanta [m].
    east_m: float
    north_m: float
    up_m: float
    #: What was found, before it was decided whether to apply it, and its standard deviation [m];
    #: None where nothing tells it.
    found_m: tuple[float | None, float | None, float | None]
    horizontal_sd_m: float | None  #: In the worse of the two directions.
    up_sd_m: float | None
    stays: str  #: Why nothing is added; empty where something is.


class _Told(NamedTuple):
    """Differences of pairs along one axis, those that tell it."""

    ends: NDArray[np.intp]  #: (m, 2): first and second flightline.
    away_m: NDArray[np.float64]  #: (m,): where the second lies from the first.
    sd_m: NDArray[np.float64]


class _Group(NamedTuple):
    """Flightlines that hang together, and what brings them together along one axis."""

    lines: NDArray[np.intp]  #: (k,): which they are, in order.
    ends: NDArray[np.intp]  #: (m, 2): first and second flightline of each pair among these.
    weight: NDArray[np.float64]  #: (m,): of each pair [1/m2].
    shift_m: NDArray[np.float64]  #: (k,): against the first of them.


class _Axis(NamedTuple):
    """Shifts along one axis, of each flightline [m]; NaN where nothing tells them."""

    shift_m: NDArray[np.float64]
    sd_m: NDArray[np.float64]


def align_lines(
    names: Sequence[str],
    pairs: Sequence[PairDifference],
    returns: Mapping[str, int],
    *,
    rigid: bool,
) -> list[Alignment]:
    """Shifts of flightlines, by name.

    Parameters
    ----------
    names : sequence of str
        All that were flown; those of ``pairs`` among them.
    pairs : sequence of PairDifference
        From :func:`~spl_batch.airborne.strips.pair_table.pair_table`.
    returns : mapping of str to int
        Signal returns of each [count]: their weights where one is to be held.
    rigid : bool
        Whether flightlines are shifted in place as well, not in height alone.
    """
    names = sorted(names)
    far: dict[str, tuple[float | None, float | None, float | None]] = {}
    while True:
        left = [one for one in pairs if one.first not in far and one.second not in far]
        axes = _solve_all(names, left, returns, rigid=rigid)
        length = np.nan_to_num([np.hypot(axes[0].shift_m, axes[1].shift_m), abs(axes[2].shift_m)])
        worst = length.max(axis=0)
        if not names or worst.max() <= MOST_M:
            break
        k = int(worst.argmax())
        far[names[k]] = _found(axes, k)
    return [_decided(name, far.get(name), axes, k) for k, name in enumerate(names)]


def _decided(
    name: str,
    too_far: tuple[float | None, float | None, float | None] | None,
    axes: Sequence[_Axis],
    k: int,
) -> Alignment:
    """What is applied to the ``k``-th flightline."""
    if too_far is not None:
        return Alignment(name, 0.0, 0.0, 0.0, too_far, None, None, TOO_FAR)
    found = _found(axes, k)
    across_sd, up_sd = max(axes[0].sd_m[k], axes[1].sd_m[k]), axes[2].sd_m[k]
    east, north, up = (0.0 if one is None else one for one in found)
    if not np.hypot(east, north) >= SURE_ACROSS * across_sd:
        east = north = 0.0
    if not abs(up) >= SURE * up_sd:
        up = 0.0
    east, north, up = (round(one * QUANTA_PER_M) / QUANTA_PER_M for one in (east, north, up))
    stays = "" if east or north or up else _reason(found[2], up_sd)
    return Alignment(name, east, north, up, found, _known(across_sd), _known(up_sd), stays)


def _reason(up_m: float | None, up_sd_m: float) -> str:
    """Why a flightline stays."""
    if up_m is None:
        return ALONE
    return HELD if up_sd_m == 0 else UNSURE


def _found(axes: Sequence[_Axis], k: int) -> tuple[float | None, float | None, float | None]:
    """East, north and up of the ``k``-th flightline [m]."""
    east, north, up = (_known(axis.shift_m[k]) for axis in axes)
    return east, north, up


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _solve_all(
    names: Sequence[str],
    pairs: Sequence[PairDifference],
    returns: Mapping[str, int],
    *,
    rigid: bool,
) -> list[_Axis]:
    """Shifts to the east, to the north and up."""
    number = {name: k for k, name in enumerate(names)}
    weight = np.array([max(returns.get(name, 0), 1) for name in names], np.float64)

    def ends(some: Sequence[PairDifference]) -> NDArray[np.intp]:
        found = [(number[one.first], number[one.second]) for one in some]
        return np.array(found, np.intp).reshape(-1, 2)

    sloped = [one for one in pairs if rigid and one.east_m is not None]
    sd = np.array([_horizontal_sd_m(one) for one in sloped])
    across = [
        _Told(ends(sloped), np.array([getattr(one, axis) for one in sloped], np.float64), sd)
        for axis in ("east_m", "north_m")
    ]
    up_sd = np.array([np.hypot(one.up_sd_m, OWN_M) for one in pairs])
    up = _Told(ends(pairs), np.array([one.up_m for one in pairs], np.float64), up_sd)
    axes = [_Axis(np.full(len(names), np.nan), np.full(len(names), np.nan)) for _ in range(3)]
    solved = [list(_solve(told, len(names))) for told in (*across, up)]
    for axis, groups in zip(axes, solved, strict=True):
        for group in groups:
            axis.shift_m[group.lines] = group.shift_m
    held = {_held(group.lines, axes, weight) for group in solved[2]}
    for axis, groups in zip(axes, solved, strict=True):
        for group in groups:
            mine = held.intersection(group.lines.tolist()) or {_held(group.lines, axes, weight)}
            place = int(np.searchsorted(group.lines, min(mine)))
            axis.shift_m[group.lines] = group.shift_m - group.shift_m[place]
            axis.sd_m[group.lines] = _sd_m(group, place)
    return axes


def _held(lines: NDArray[np.intp], axes: Sequence[_Axis], weight: NDArray[np.float64]) -> int:
    """The flightline of a group to which the others come by the shortest way."""
    shift = np.stack([axis.shift_m[lines] for axis in axes], axis=1)
    ways = [weight[lines] @ np.linalg.norm(np.nan_to_num(shift - one), axis=1) for one in shift]
    return int(lines[np.argmin(ways)])


def _horizontal_sd_m(pair: PairDifference) -> float:
    """How surely a pair tells a horizontal difference; few squares of place are no good witness."""
    given = pair.horizontal_sd_m or 0.0
    few = min(student_t(pair.squares - UNKNOWNS) * given, FEW_M) / NORMAL
    return float(np.hypot(max(given, few), OWN_M))


def _solve(told: _Told, count: int) -> Iterator[_Group]:
    """Shifts along one axis, of each group of flightlines that hang together."""
    for lines, mine in _groups(told.ends, count):
        place = np.searchsorted(lines, told.ends[mine])
        yield _solve_group(lines, _Told(place, told.away_m[mine], told.sd_m[mine]))


def _groups(
    ends: NDArray[np.intp], count: int
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Flightlines that hang together, in order, and the pairs among them."""
    ones = np.ones(len(ends))
    joined = csr_array((ones, tuple(ends.T)), (count, count))
    _, group = connected_components(joined, directed=False)
    for one in np.unique(group[ends[:, 0]]):
        yield np.flatnonzero(group == one), np.flatnonzero(group[ends[:, 0]] == one)


def _solve_group(lines: NDArray[np.intp], told: _Told) -> _Group:
    """Shifts of a group against its first flightline [m]."""
    count, precision = len(lines), 1 / told.sd_m**2
    first, second = told.ends.T
    freedom = len(told.away_m) - count + 1
    factor = np.ones(len(precision))
    for _ in range(ROUNDS if freedom else 1):
        inverse = splu(_normal(told.ends, factor * precision, count, 0))
        towards = factor * precision * -told.away_m
        wanted = np.bincount(second, towards, count) - np.bincount(first, towards, count)
        shift = np.concatenate([[0.0], inverse.solve(wanted[1:])])
        ratio = (told.away_m + shift[second] - shift[first]) / told.sd_m
        factor = 1 / np.maximum(np.abs(ratio) / HUBER, 1.0)
    # Where pairs contradict each other, none is as sure as it says.
    misfit = float(factor @ ratio**2) / freedom if freedom else 1.0
    return _Group(lines, told.ends, factor * precision / max(misfit, 1.0), shift)


def _normal(
    ends: NDArray[np.intp], weight: NDArray[np.float64], count: int, held: int
) -> csc_array:
    """Normal matrix of the shifts of all flightlines of a group but the one that is held."""
    row = np.arange(len(ends)).repeat(2)
    signs = np.tile([-1.0, 1.0], len(ends))
    whole = csc_array((signs, (row, ends.ravel())), (len(ends), count))
    design = csr_array(whole[:, np.flatnonzero(np.arange(count) != held)])
    return csc_array(design.T @ (design * weight[:, None]))


def _sd_m(group: _Group, held: int) -> NDArray[np.float64]:
    """Standard deviations of shifts against the flightline that is held [m]."""
    count = len(group.lines)
    inverse = splu(_normal(group.ends, group.weight, count, held))
    parts = []
    for start in range(0, count - 1, COLUMNS_AT_ONCE):
        rows = np.arange(start, min(start + COLUMNS_AT_ONCE, count - 1))
        unit = np.zeros((count - 1, len(rows)))
        unit[rows, rows - start] = 1.0
        parts.append(inverse.solve(unit)[rows, rows - start])
    variance = np.insert(np.concatenate(parts), held, 0.0)
    found: NDArray[np.float64] = np.sqrt(np.maximum(variance, 0.0))
    return found
