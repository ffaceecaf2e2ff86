"""By how much to shift each flightline so that those that overlap fit together.

Each pair tells how far its second flightline lies from the first. The shifts that make all pairs
fit best are found by least squares, weighted by the variance of each pair; those of flightlines
that hang together add up to zero, since nothing tells where all of them lie. Nothing is applied.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import lsqr

from spl_batch.airborne.strips.pair_table import OWN_M, PairDifference

ALIKE_M: Final = OWN_M
"""Pairs are known no better than this, whatever their patches promise [m]."""


class LineShift(NamedTuple):
    """What to add to the coordinates of a flightline [m]; None where no slopes tell it."""

    name: str
    up_m: float
    east_m: float | None
    north_m: float | None
    left_m: float  #: Largest vertical difference to another flightline that is left then [m].


def line_shifts(pairs: Sequence[PairDifference]) -> list[LineShift]:
    """Shifts of all flightlines that take part in a pair, by name.

    Parameters
    ----------
    pairs : sequence of PairDifference
        From :func:`~spl_batch.airborne.strips.pair_table.pair_table`.
    """
    names = sorted({name for pair in pairs for name in (pair.first, pair.second)})
    up = _solve(names, pairs, "up_m", "up_sd_m")
    sloped = [pair for pair in pairs if pair.east_m is not None]
    told = {name for pair in sloped for name in (pair.first, pair.second)}
    east, north = (_solve(names, sloped, of, "horizontal_sd_m") for of in ("east_m", "north_m"))
    left = dict.fromkeys(names, 0.0)
    number = {name: k for k, name in enumerate(names)}
    for pair in pairs:
        off = abs(pair.up_m + up[number[pair.second]] - up[number[pair.first]])
        for name in (pair.first, pair.second):
            left[name] = max(left[name], off)
    return [
        LineShift(
            name,
            float(up[k]),
            float(east[k]) if name in told else None,
            float(north[k]) if name in told else None,
            left[name],
        )
        for name, k in number.items()
    ]


def _solve(
    names: Sequence[str], pairs: Sequence[PairDifference], away: str, sd: str
) -> NDArray[np.float64]:
    """Shifts of least norm that take away by what pairs differ, as far as they can [m].

    ``away``, ``sd``: fields of a pair, a difference and its standard deviation.
    """
    number = {name: k for k, name in enumerate(names)}
    ends = [[number[name] for name in (pair.second, pair.first)] for pair in pairs]
    weight = np.array([1.0 / np.hypot(getattr(pair, sd), ALIKE_M) for pair in pairs])
    wanted = -weight * [getattr(pair, away) for pair in pairs]
    if not len(pairs):
        return np.zeros(len(names))
    row = np.arange(len(pairs)).repeat(2)
    values = np.stack([weight, -weight], axis=1).ravel()
    design = csr_array((values, (row, np.ravel(ends))), (len(pairs), len(names)))
    # Of all solutions that of least norm adds up to zero in each group that hangs together.
    found: NDArray[np.float64] = lsqr(design, wanted, atol=1e-12, btol=1e-12)[0]
    return found
