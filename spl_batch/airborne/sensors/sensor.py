"""Facts about an instrument, and the presets that ship with the project."""

from functools import cache
from importlib import resources
from typing import Annotated, Final

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from spl_batch.constants import SPEED_OF_LIGHT_M_S
from spl_batch.errors import WorkflowError

Positive = Annotated[float, Field(gt=0)]

DEAD_MOST_M: Final = 60.0
"""A dead time of this range or more is no sensor's: lags are looked at as far [m]."""


class Sensor(BaseModel):
    """Instrument facts that processing and the simulator share.

    Every length is in metres, every time in the unit of its name.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str = Field("own sensor", description="Name shown in the report.")
    photons: bool = Field(
        True,
        description="Whether single photons are counted; false for linear mode, whose clouds have "
        "neither such noise nor afterpulses to be filtered.",
    )
    beamlets: int = Field(100, ge=1, le=255, description="Beamlets per shot [count].")
    array_columns: int = Field(
        10, ge=1, description="Beamlets along one side of the array [count]."
    )
    prf_hz: Positive | None = Field(
        None, description="Pulse repetition frequency [Hz]; estimated where missing."
    )
    gate_m: Positive | None = Field(
        None, description="Slant length of the range gate [m]; estimated where missing."
    )
    array_rotation_deg: float = Field(
        5.7, description="Turn of the array against the scan direction, alpha_R [deg]."
    )
    dead_time_ns: Positive = Field(1.6, description="Time after a detection without another [ns].")
    range_sigma_m: Positive = Field(0.05, description="Ranging spread, one sigma [m].")
    wavelength_nm: Positive = Field(532.0, description="Laser wavelength [nm].")
    pulse_energy_uj: Positive = Field(83.0, description="Energy of one pulse, all beamlets [uJ].")
    aperture_m: Positive = Field(0.076, description="Diameter of the receiver aperture [m].")
    quantum_efficiency: float = Field(0.2, gt=0, le=1, description="Detector quantum efficiency.")
    receiver_efficiency: float = Field(0.05, gt=0, le=1, description="Receiver optical efficiency.")
    hologram_efficiency: float = Field(0.8, gt=0, le=1, description="Beam splitter efficiency.")
    filter_bandwidth_nm: Positive = Field(0.5, description="Spectral filter bandwidth [nm].")
    pixel_fov_urad: Positive = Field(120.0, description="Full field of view of one pixel [urad].")
    beamlet_pitch_urad: Positive = Field(200.0, description="Angle between beamlets [urad].")
    beam_divergence_urad: Positive = Field(80.0, description="Full divergence of a beamlet [urad].")
    dark_rate_hz: float = Field(30_000.0, ge=0, description="Dark counts per channel [Hz].")
    half_cone_deg: Positive = Field(15.0, lt=60, description="Half cone angle of the scan [deg].")
    scan_rate_hz: Positive = Field(25.0, description="Wedge revolutions per second [Hz].")
    afterpulse_probability: float = Field(
        0.15, ge=0, lt=1, description="Afterpulses per detection; W17 ch. 7: 10-20 per 80-100."
    )
    afterpulse_scale_m: Positive = Field(
        0.7, description="Mean lag of an afterpulse behind the end of the dead time [m]."
    )
    afterpulse_lag_max_m: Positive = Field(
        3.0,
        description="Longest lag of an afterpulse behind its parent [m]; W17 7.2: 2-3 m.",
        validate_default=True,
    )

    @field_validator("dead_time_ns")
    @classmethod
    def _short_enough(cls, time_ns: float) -> float:
        if _range_m(time_ns) >= DEAD_MOST_M:
            raise ValueError(f"must be below {2e9 * DEAD_MOST_M / SPEED_OF_LIGHT_M_S:.0f} ns")
        return time_ns

    @field_validator("afterpulse_lag_max_m")
    @classmethod
    def _behind_the_dead_time(cls, lag_m: float, given: ValidationInfo) -> float:
        dead_m = _range_m(given.data.get("dead_time_ns", 0.0))
        if lag_m <= dead_m:
            raise ValueError(f"must exceed the dead time, {dead_m:.3f} m")
        return lag_m

    @property
    def dead_m(self) -> float:
        """Dead time as range [m]."""
        return _range_m(self.dead_time_ns)


def _range_m(time_ns: float) -> float:
    return time_ns * 1e-9 * SPEED_OF_LIGHT_M_S / 2


def preset_names() -> list[str]:
    """Names of the sensors that ship with the project, sorted."""
    folder = resources.files("spl_batch.airborne.sensors")
    return sorted(
        p.name.removesuffix(".yaml") for p in folder.iterdir() if p.name.endswith(".yaml")
    )


@cache
def load_preset(name: str) -> Sensor:
    """Sensor by preset name.

    ``name``: one of :func:`preset_names`, in any case.

    Raises
    ------
    WorkflowError
        If there is no such preset.
    """
    known = preset_names()
    if name.lower() not in known:
        raise WorkflowError(f"survey.sensor: no preset {name!r}; known are {', '.join(known)}")
    text = (
        resources.files("spl_batch.airborne.sensors")
        .joinpath(f"{name.lower()}.yaml")
        .read_text(encoding="utf-8")
    )
    return Sensor.model_validate(yaml.safe_load(text))
