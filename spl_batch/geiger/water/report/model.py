"""Model of the report of a water surface: ``report.json`` is this model."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.report.parts import (
    Count,
    Failure,
    FindingReport,
    Number,
    Part,
    Performance,
    Provenance,
)


class WaterFile(Part):
    """One file of frames."""

    name: str = Field(description="As messages call it.")
    role: Literal["water", "target"] = Field(description="What it was recorded of.")
    frames: Count = Field(description="Frames [count].")
    acquisitions: Count = Field(description="Surfaces made of it [count].")
    gate: tuple[Count, Count] = Field(description="First bin of the gate, first one behind it.")
    hits: Count = Field(description="Hits within the gate [count].")
    outside: Count = Field(description="Hits outside of it, of pixels in use [count].")


class WaterCalibration(Part):
    """From time bins to ranges."""

    fitted: bool = Field(description="Whether it was fitted from frames of a target.")
    scale: Number = Field(description="Measured over actual time.")
    offset_ns: Number = Field(description="Delay of the electronics [ns].")
    range_walk: str = Field(description="Law of the range walk.")
    walk_ns: Number = Field(description="A of the exponential law [ns].")
    walk_exponent: Number = Field(description="B of the exponential law.")
    pulse_ns: Number = Field(description="Spread of the echo of the first-photon law [ns].")
    residual_ns: Number = Field(description="Delay of a pixel that a fit leaves [ns].")
    dead: Count = Field(description="Dead pixels among those in use [count].")
    used: Count = Field(description="Pixels in use, dead ones included [count].")


class SurfaceErrors(Part):
    """Errors of surfaces, means over acquisitions [G15 Eq. 3-22 to 3-27]."""

    acquisitions: Count = Field(description="Surfaces that were compared [count].")
    bias_m: Number = Field(description="Mean of absolute biases; down less true down [m].")
    signed_bias_m: Number = Field(description="Mean bias; positive is too deep [m].")
    variance_m2: Number = Field(description="Mean variance [m2].")
    mse_m2: Number = Field(description="Mean squared error [m2].")
    normal_deg: Number = Field(description="Angle of the mean normal [deg].")
    pixel_normal_deg: Number = Field(description="Mean angle of a pixel's normal [deg].")


class SurfaceError(Part):
    """Errors of one surface [G15 Eq. 3-16 to 3-18, 3-25]."""

    file: str = Field(description="File of frames.")
    acquisition: Count = Field(description="Which one of the file, from 0.")
    bias_m: Number = Field(description="Down less true down [m].")
    variance_m2: Number = Field(description="[m2]")
    mse_m2: Number = Field(description="[m2]")
    normal_deg: Number = Field(description="Angle of the mean normal [deg].")
    pixel_normal_deg: Number = Field(description="Mean angle of a pixel's normal [deg].")
    pixels: Count = Field(description="Pixels that are known [count].")


class FloorErrors(Part):
    """How far rays end from the truth, means over acquisitions."""

    in_water_m: Number = Field(description="Length of the way in water [m].")
    straight_m: Number = Field(description="Without refraction, single pixels [m].")
    level_m: Number = Field(description="Refracted by a level surface, single pixels [m].")
    refracted_m: Number = Field(description="Refracted by the surface found, single pixels [m].")
    straight_beam_m: Number = Field(description="Without refraction, a beam over all of them [m].")
    level_beam_m: Number = Field(description="Refracted by a level surface, such a beam [m].")
    refracted_beam_m: Number = Field(description="Refracted by the surface found, such a beam [m].")


class WaterReport(Part):
    """Everything that ``report.json`` holds and ``report.html`` shows."""

    schema_version: Literal[1] = 1
    name: str = Field(description="Title.")
    crs: str | None = Field(None, description="CRS of the rasters.")
    method: str = Field(description="Way to the normals.")
    frames_per_acquisition: Count = Field(description="Frames that make a surface [count].")
    files: tuple[WaterFile, ...]
    calibration: WaterCalibration | None = Field(None, description="Null where it failed.")
    points: Count = Field(description="Points delivered [count].")
    surfaces: SurfaceErrors | None = Field(None, description="Null without truth.")
    each_surface: tuple[SurfaceError, ...] = Field((), description="Every one of them.")
    floor: FloorErrors | None = Field(None, description="Null without truth or a way in water.")
    performance: Performance = Performance()
    failures: tuple[Failure, ...] = Field((), description="Everything that did not make it.")
    findings: tuple[FindingReport, ...] = Field((), description="What a reader has to know.")
    provenance: Provenance
