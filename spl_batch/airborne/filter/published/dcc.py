"""Differential cell count, shot by shot [W17 3.2.3; Eq. 3.3 with a correction].

Domain: time for :func:`shot_noise`, which needs whole shots; the flag travels with the point, and
:func:`judge` only reads it. :mod:`~spl_batch.airborne.beams.differential_cell_count` tells the
correction of Eq. 3.3. Ranges replace the source's elevations, so a bin is as long in a slanting
beam as in an upright one.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.filter.published.dcc_shots import keep_by_shot
from spl_batch.airborne.settings import DccSettings, FilterSettings
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"
COLUMNS_NEEDED: Final = ("gps_time", "flags")
COLUMNS_ADDED: Final = ("flags",)


def shot_noise(
    table: PointTable, beams: BeamTable, settings: DccSettings, gate_m: float
) -> NDArray[np.bool_]:
    """Returns that the differential cell count of their shot calls noise: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by gps_time.
    beams : BeamTable
        Their beams; rows without a known one are not called noise.
    """
    noise = np.zeros(len(table), dtype=np.bool_)
    rows = np.flatnonzero(beams.known)
    keep = np.empty(len(rows), dtype=np.bool_)
    starts = run_starts(table["gps_time"][rows])
    keep_by_shot(
        starts, beams.range_m[rows], gate_m, settings.coarse_bin_m, settings.fine_bin_m, keep
    )
    noise[rows] = ~keep
    return noise


def reach_m(settings: FilterSettings) -> float:  # noqa: ARG001 - every method has this form
    """Shots were judged whole: nothing is looked at around a point [m]."""
    return 0.0


def judge(cloud: Cloud, settings: FilterSettings) -> Verdict:  # noqa: ARG001
    """What the shots said about the points asked for; there is no p-value."""
    return without_p(~cloud.shot_noise[cloud.asked])
