"""Afterpulse candidates, shot by shot.

Source: [W17] ch. 7 (DCC, robust regression, 68th percentile, 0.3 m), Eq. 3.3.

Deviations. The published rule flags whatever lies below the plane. Here a return also
needs a parent: an earlier return of its own beamlet, on that surface, at most
``lag_max_m`` in front. So the ground beside a roof, a car or a wall is not taken for the
roof's afterpulse. Returns that follow another one of their beamlet do not take part in
the fit. Where one plane does not do, a shot may hold up to three surfaces. Distances to
the threshold are taken along the beam, as an afterpulse lags along it. Away from hard
surfaces the lag alone gives a probability below one half. Where a shot knows no
channels, the published rule stands, but not deeper than ``lag_max_m``.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M, SPEED_OF_LIGHT_M_S
from spl_batch.kernels.afterpulses import shot_probabilities
from spl_batch.kernels.hard_surfaces import Rules
from spl_batch.kernels.shots import lag_behind, run_starts
from spl_batch.model import BeamTable, PointTable
from spl_batch.sensor import Sensor
from spl_batch.stages.gate import GATE_ASSUMED_M
from spl_batch.workflow import AfterpulseSettings

DOMAIN: Final = "time"
COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel")
COLUMNS_ADDED: Final = ("afterpulse",)
BYTES_PER_POINT: Final = 140


def probability(
    table: PointTable,
    beams: BeamTable,
    settings: AfterpulseSettings,
    sensor: Sensor,
    *,
    gate_m: float | None = None,
) -> NDArray[np.float32]:
    """Probability that each return is an afterpulse.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...).
    beams : BeamTable
        Their beams; rows without a known beam get 0.
    settings : AfterpulseSettings
        Numbers of the method.
    sensor : Sensor
        Dead time, ranging spread, afterpulse statistics.
    gate_m : float, optional
        Slant length of the gate as the flightline's noise model found it [m].

    Returns
    -------
    (n,) float32
        Probabilities; at 0.5 and above the return is called an afterpulse.
    """
    out = np.zeros(len(table), dtype=np.float32)
    rows = np.flatnonzero(beams.known)
    if len(rows) == 0 or not settings.enabled:
        return out
    time, channel = table["gps_time"][rows], table["channel"][rows]
    range_m = beams.range_m[rows]
    shots = run_starts(time)
    xyz = np.stack([table[k][rows].astype(np.int64) for k in ("x", "y", "z")], axis=1)
    offset = (xyz - np.repeat(xyz[shots[:-1]], np.diff(shots), axis=0)) * np.float64(QUANTUM_M)
    dead_m = 0.5e-9 * SPEED_OF_LIGHT_M_S * sensor.dead_time_ns
    # Both returns of a pair carry the ranging spread, so the measured lag may fall short.
    least = max(dead_m - 5.0 * sensor.range_sigma_m, 1e-3)
    lag = np.empty(len(rows), dtype=np.float32)
    lag_behind(run_starts(time, channel), range_m, least, settings.lag_max_m, lag)
    rules = Rules(
        gate_m=gate_m or sensor.gate_m or GATE_ASSUMED_M,
        coarse_m=settings.coarse_bin_m,
        fine_m=settings.fine_bin_m,
        weight_min=settings.weight_min,
        p68_max_m=settings.fit_p68_max_m,
        below_m=settings.below_plane_m,
        lag_max_m=settings.lag_max_m,
        dead_m=dead_m,
        sigma_m=sensor.range_sigma_m,
        probability=sensor.afterpulse_probability,
        scale_m=sensor.afterpulse_scale_m,
        beamlets=float(sensor.beamlets),
    )
    found = np.empty(len(rows), dtype=np.float32)
    shot_probabilities(
        shots, offset, np.ascontiguousarray(beams.direction[rows]), range_m, channel, lag,
        rules, found,
    )  # fmt: skip
    out[rows] = found
    return out
