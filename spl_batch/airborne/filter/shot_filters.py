"""Filters of the sources for single shots, in the time domain: the flag travels with the point.

- ``dcc``: differential cell count, shot by shot [W17 3.2.3; Eq. 3.3 with the correction of
  :mod:`~spl_batch.airborne.beams.differential_cell_count`]. Ranges replace the source's elevations,
  so a bin is as long in a slanting beam as in an upright one.
- ``pixels``: neighbours in the detector, shot by shot [W17 3.2.1, after Zhang et al.]. A return
  stays if enough of the 3 x 3 pixels around its own returned from about its range. The source finds
  the number, 1 to 9, numerically for a brightness and a noise, and gives neither it nor the range:
  both are settings.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.differential_cell_count import dcc_keep
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tables import BeamTable, PointTable
from spl_batch.numerics.compiled import njit

OF_SHOTS: Final = ("dcc", "pixels")
"""Their names."""


def shot_noise(
    table: PointTable, beams: BeamTable, settings: FilterSettings, gate_m: float, columns: int
) -> NDArray[np.bool_]:
    """Returns that a filter of single shots calls noise: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by gps_time.
    beams : BeamTable
        Their beams; rows without a known one are not called noise.
    settings : FilterSettings
        Filter, one of :data:`OF_SHOTS`.
    columns : int
        Beamlets along a side of the array [count].
    """
    noise = np.zeros(len(table), dtype=np.bool_)
    rows = np.flatnonzero(beams.known)
    keep = np.empty(len(rows), dtype=np.bool_)
    starts = run_starts(table["gps_time"][rows])
    if settings.method == "dcc":
        bins = settings.dcc.coarse_bin_m, settings.dcc.fine_bin_m
        _keep_by_shot(starts, beams.range_m[rows], gate_m, *bins, keep)
    else:
        pixel = table["channel"][rows].astype(np.int64) - 1
        place = np.stack([pixel // columns, pixel % columns], axis=1)
        own = settings.pixels
        _keep_by_pixels(starts, beams.range_m[rows], place, own.range_m, own.count, keep)
    noise[rows] = ~keep
    return noise


@njit()
def _keep_by_shot(
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


@njit()
def _keep_by_pixels(
    starts: NDArray[np.int64],
    range_m: NDArray[np.float64],
    place: NDArray[np.int64],
    reach_m: float,
    least: int,
    keep: NDArray[np.bool_],
) -> None:
    """Returns that enough of the 3 x 3 pixels around share: fills (n,) bool.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where shots start, then n.
    range_m : (n,) float64
        Slant ranges [m].
    place : (n, 2) int64
        Row and column of the pixel; without a known one a return stays.
    """
    for m in range(len(starts) - 1):
        for i in range(starts[m], starts[m + 1]):
            seen = np.zeros(9, dtype=np.bool_)
            for j in range(starts[m], starts[m + 1]):
                row, column = place[j, 0] - place[i, 0] + 1, place[j, 1] - place[i, 1] + 1
                if 0 <= row < 3 and 0 <= column < 3 and abs(range_m[j] - range_m[i]) <= reach_m:
                    seen[3 * row + column] = True
            keep[i] = place[i, 0] < 0 or seen.sum() >= least


def reach_m(settings: FilterSettings) -> float:  # noqa: ARG001 - every method has this form
    """Shots were judged whole: nothing is looked at around a point [m]."""
    return 0.0


def judge(cloud: Cloud, settings: FilterSettings) -> Verdict:  # noqa: ARG001
    """What the shots gave the points asked for."""
    return without_p(~cloud.shot_noise[cloud.asked])
