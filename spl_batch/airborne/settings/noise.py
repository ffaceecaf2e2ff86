"""Noise model and afterpulses."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.settings.base import Edge, Positive, Section, Share


class NoiseSettings(Section):
    """Line noise density and the voxel-spherical model [W17 5.2.1, W18 2.2.2]."""

    interval_shots: int = Field(60, ge=1, description="Shots counted together [count].")
    smooth_intervals: int = Field(
        40, ge=0, description="Half-width of the smoothing over intervals [count]; 0 is none."
    )
    peak_m: Positive = Field(
        5.0, description="Height window whose fullest place marks the signal [m]."
    )
    buffer_m: Positive = Field(50.0, description="Half-height around the signal left out [m].")
    voxel_m: Edge = Field(10.0, description="Edge of a noise voxel [m].")
    correction: Literal["seen", "published"] = Field(
        "seen", description="Silent beamlets: by seen fraction, or the published gamma."
    )
    haze: bool = Field(
        True,
        description="Where returns fill the air evenly, as in haze or cloud, expect what is seen.",
    )


class AfterpulseSettings(Section):
    """Afterpulse candidates [W17 ch. 7]."""

    enabled: bool = Field(True, description="Look for afterpulses.")
    method: Literal["beamlet", "published"] = Field(
        "beamlet",
        description="By earlier returns of the beamlet and returns around; or as published, all "
        "that lies below the plane of a shot.",
    )
    coarse_bin_m: Positive = Field(30.0, description="DCC coarse range bin [m].")
    fine_bin_m: Positive = Field(5.0, description="DCC fine range bin [m].")
    weight_min: Share = Field(0.1, description="Bisquare weight that marks the hard surface.")
    fit_p68_max_m: Positive = Field(0.5, description="A fit is trusted below this [m].")
    below_plane_m: Positive = Field(
        0.3, description="Returns farther below the plane are flagged [m]."
    )
    lag_max_m: Positive = Field(
        5.0,
        description="Greatest depth behind a hard surface [m]; deeper where a flightline shows "
        "longer lags than the sensor's afterpulse_lag_max_m.",
    )
    vegetation_loss: Share = Field(
        0.0125,
        description="Share of the true returns of vegetation that may go with its afterpulses.",
    )
