"""Differential cell count of every shot of a table [W17 3.2.3, Eq. 3.3]."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.differential_cell_count import dcc_keep
from spl_batch.numerics.compiled import njit


@njit()
def keep_by_shot(
    starts: NDArray[np.int64],
    range_m: NDArray[np.float64],
    gate_m: float,
    coarse_m: float,
    fine_m: float,
    keep: NDArray[np.bool_],
) -> None:
    """:func:`~spl_batch.airborne.beams.differential_cell_count.dcc_keep` for every shot.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where shots start, then n.
    range_m : (n,) float64
        Slant ranges [m].
    keep : (n,) bool
        Filled: True where the return lies in a bin that holds signal.
    """
    for m in range(len(starts) - 1):
        rows = slice(starts[m], starts[m + 1])
        dcc_keep(range_m[rows], gate_m, coarse_m, fine_m, keep[rows])
