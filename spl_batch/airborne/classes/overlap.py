"""Where flightlines overlap: the squares of an absolute grid that two or more of them cover.

Domain: space. The flag "overlap" of a point says that it lies where two or more swaths do [LAS 1.4
R15, 2.6]; which of them is surplus is left to whoever thins them.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tiles import quanta

EDGE_M: Final = 5.0
"""Edge of a square: more than twice the spacing of each quality level, so that a swath fills it
[m]."""


def lines_by_square(first: NDArray[np.int64], line: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which flightlines have first returns in which squares.

    Parameters
    ----------
    first : (n, 2) int64
        First signal returns of pulses, in any order [quanta].
    line : (n,) int64
        Flightline of each.

    Returns
    -------
    (2, k) int64
        Number of a square, and flightline; each pair once.
    """
    return np.unique(np.stack([_square(*first.T), line]), axis=1)


def overlapping(
    covered: NDArray[np.int64], x: NDArray[np.int64], y: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which places lie in squares with first returns of two flightlines or more: (m,) bool.

    Parameters
    ----------
    covered : (2, k) int64
        What :func:`lines_by_square` found, the squares around each place among them.
    x, y : (m,) int64
        The places [quanta].
    """
    square, lines = np.unique(covered[0], return_counts=True)
    return np.isin(_square(x, y), square[lines > 1])


def _square(x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number for each square."""
    edge = quanta(EDGE_M)
    number: NDArray[np.int64] = x // edge * 2**32 + y // edge
    return number
