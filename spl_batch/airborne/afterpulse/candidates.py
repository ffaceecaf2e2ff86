"""Afterpulse candidates, shot by shot.

Source: [W17] ch. 7 (DCC, robust regression, 68th percentile, 0.3 m), Eq. 3.3.

Deviations. The published rule flags whatever lies below the plane. Here a return also needs a
parent: an earlier return of its beamlet on that surface, at most ``lag_max_m`` away. So the ground
beside a roof stays. Returns behind another one of their beamlet take no part in the fit. Where the
plane of all of them does not do, one of the fullest range stands for it. Distances to the threshold
run along the beam. Away from hard surfaces the lag gives a probability below one half, and the
space domain decides (:mod:`~spl_batch.airborne.afterpulse.afterpulse_decision`). Where beamlets
cannot be separated (:mod:`~spl_batch.airborne.beams.separate_beamlets`), the published rule
applies, down to ``lag_max_m``.

``method: published`` has none of these but the distances along the beam: one plane for each shot
that has enough candidates, and all that lies below it.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.afterpulse_law import (
    AfterpulseLaw,
    across_beams,
    sensor_law,
    several,
)
from spl_batch.airborne.afterpulse.hard_surfaces import Rules, below_planes
from spl_batch.airborne.afterpulse.lag_counts import (
    LAG_EDGES_M,
    no_counts,
    observe_lags,
    rate_behind,
)
from spl_batch.airborne.afterpulse.shot_evidence import shot_probabilities
from spl_batch.airborne.beams.shot_runs import lag_behind, run_starts
from spl_batch.airborne.noise.gate import GATE_ASSUMED_M
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings import AfterpulseSettings
from spl_batch.lattice.tables import BeamTable, PointTable, rows_of
from spl_batch.numerics.simd import LANES

EVERY: Final = 4
"""The law is learnt from one shot in so many, by shot number: no cut matters. Half and twice move
94 + 103 and 114 + 100 labels."""


def assess(
    table: PointTable,
    beams: BeamTable,
    settings: AfterpulseSettings,
    sensor: Sensor,
    *,
    gate_m: float | None = None,
    law: AfterpulseLaw | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Probability that each return is an afterpulse, and afterpulses that are expected there.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...).
    beams : BeamTable
        Their beams; rows without a known beam get 0.
    gate_m : float, optional
        Slant length of the gate as the flightline's noise model found it [m].
    law : AfterpulseLaw, optional
        Of the flightline; the sensor's by default.

    Returns
    -------
    probability, rate : (n,) float32
        At a probability of 0.5 and above the return is called an afterpulse. Afterpulses per metre
        of beamlet [1/m]; 0 where no return of the beamlet is in front, or channels are not known.
    """
    probability, rate = np.zeros((2, len(table)), dtype=np.float32)
    if not settings.enabled or not beams.known.any():
        return probability, rate
    rows = rows_of(beams.known)
    table = table.take(rows)
    time, channel, range_m = table["gps_time"], table["channel"], beams.range_m[rows]
    shots, beamlets = run_starts(time), run_starts(time, channel)
    law = law or sensor_law(sensor)
    lag, found, due = np.empty((3, len(table)), dtype=np.float32)
    known = several(channel, shots)
    rules = hard_rules(settings, sensor, law, gate_m)
    u, v = across_beams(table, shots, beams.direction[rows])
    w = np.concatenate([range_m, np.zeros(LANES)])
    if settings.method == "published":
        below_planes(shots, u, v, w, rules._replace(below_m=settings.below_plane_m), found)
    else:
        lag_behind(beamlets, range_m, law.least_m, rules.chain_m, lag)
        shot_probabilities(shots, u, v, w, channel, lag, known, rules, found)
    rate_behind(beamlets, range_m, law.least_m, law.longest_m, law.dead_m, law.density, due)
    probability[rows], rate[rows] = found, due * np.repeat(known, np.diff(shots))
    return probability, rate


def observe(table: PointTable, beams: BeamTable, sensor: Sensor) -> dict[str, NDArray[np.int64]]:
    """Lags behind hard surfaces in one stretch; parts of a flightline add up.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...), with ``shot``.
    beams : BeamTable
        Their beams; rows without a known one take no part.

    Returns
    -------
    dict
        The arrays of :class:`~spl_batch.airborne.afterpulse.lag_counts.Counts`, their names
        beginning with ``afterpulse_``.
    """
    counts, law = no_counts(), sensor_law(sensor)
    rows = np.flatnonzero(beams.known & (table["shot"] % EVERY == 0))
    if len(rows):
        time, channel = table["gps_time"][rows], table["channel"][rows]
        range_m = beams.range_m[rows]
        shots = run_starts(time)
        lag = np.empty(len(rows), dtype=np.float32)
        lag_behind(run_starts(time, channel), range_m, law.least_m, float(LAG_EDGES_M[-1]), lag)
        u, v = across_beams(table.take(rows), shots, beams.direction[rows])
        observe_lags(
            shots, np.flatnonzero(several(channel, shots)), u, v, range_m, channel, lag,
            hard_rules(AfterpulseSettings(), sensor, law), LAG_EDGES_M, counts,
        )  # fmt: skip
    return {f"afterpulse_{name}": value for name, value in counts._asdict().items()}


def hard_rules(
    settings: AfterpulseSettings,
    sensor: Sensor,
    law: AfterpulseLaw,
    gate_m: float | None = None,
) -> Rules:
    """Numbers of the method for the kernels."""
    # Afterpulses start others, so chains go deeper than one lag, and deeper where lags are longer.
    deeper = max(law.longest_m / sensor.afterpulse_lag_max_m, 1.0)
    return Rules(
        gate_m=gate_m or sensor.gate_m or GATE_ASSUMED_M,
        coarse_m=settings.coarse_bin_m,
        fine_m=settings.fine_bin_m,
        weight_min=settings.weight_min,
        p68_max_m=settings.fit_p68_max_m,
        below_m=max(settings.below_plane_m, 4.0 * law.sigma_m),
        lag_max_m=settings.lag_max_m,
        chain_m=settings.lag_max_m * deeper,
        dead_m=law.dead_m,
        sigma_m=law.sigma_m,
        longest_m=law.longest_m,
        beamlets=float(sensor.beamlets),
        law=law.density,
    )
