"""What to add to each flightline so that those that overlap fit together: told, not applied.

The shifts are those of :mod:`~spl_batch.airborne.strips.alignment`, whether they are sure or not.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from spl_batch.airborne.strips.alignment import align_lines
from spl_batch.airborne.strips.pair_table import PairDifference


class LineShift(NamedTuple):
    """What to add to the coordinates of a flightline [m]; None where no slopes tell it."""

    name: str
    up_m: float
    east_m: float | None
    north_m: float | None
    left_m: float  #: Largest vertical difference to another flightline that is left then [m].


def line_shifts(pairs: Sequence[PairDifference], returns: Mapping[str, int]) -> list[LineShift]:
    """Shifts of all flightlines that take part in a pair, by name.

    Parameters
    ----------
    pairs : sequence of PairDifference
        From :func:`~spl_batch.airborne.strips.pair_table.pair_table`.
    returns : mapping of str to int
        Signal returns of each flightline [count].
    """
    names = sorted({name for pair in pairs for name in (pair.first, pair.second)})
    found = {one.name: one.found_m for one in align_lines(names, pairs, returns, rigid=True)}
    up = {name: shift[2] or 0.0 for name, shift in found.items()}
    left = dict.fromkeys(names, 0.0)
    for pair in pairs:
        off = abs(pair.up_m + up[pair.second] - up[pair.first])
        for name in (pair.first, pair.second):
            left[name] = max(left[name], off)
    return [LineShift(name, up[name], *found[name][:2], left[name]) for name in names]
