"""Settings of the water surface, with all their defaults.

Defaults are those of the source's instrument [G15 tables 3.1-3.3]. The local frame is its own:
north, east, down [m].
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final, Literal

from pydantic import Field, model_validator

from spl_batch.engine.settings.base import BaseWorkflow, Positive, Section, Share, StoreSettings

Vector = tuple[float, float, float]
NONE: Final[Vector] = (0.0, 0.0, 0.0)


class CameraSettings(Section):
    """The array and its clock [G15 2.2.5, 3.5.2]."""

    rows: int = Field(32, ge=3, le=1024, description="Rows of pixels [count].")
    cols: int = Field(32, ge=3, le=1024, description="Columns of pixels [count].")
    last_rows_unused: int = Field(
        3, ge=0, description="Rows at the end that are left out, being mostly dead [count]."
    )
    bin_ns: Positive = Field(0.25, description="Length of a time bin [ns].")
    bins: int = Field(8000, ge=2, le=65535, description="Time bins of a frame [count].")
    pitch_mm: Positive = Field(0.1, description="Between neighbouring pixels [mm].")
    focal_mm: Positive = Field(50.0, description="Focal length [mm].")
    prf_hz: Positive = Field(2000.0, description="Frames a second [Hz].")

    @model_validator(mode="after")
    def _some_rows(self) -> "CameraSettings":
        if self.rows - self.last_rows_unused < 3:
            raise ValueError("last_rows_unused: at least 3 rows must remain")
        return self


class GateSettings(Section):
    """Bins that count, found in the histogram of a file's bins [G15 3.4.2]."""

    width_bins: int = Field(47, ge=3, description="Bins of the gate [count].")
    centre_bin: int | None = Field(
        None,
        ge=1,
        description="Middle of the gate; by default, and of targets always, the histogram's peak.",
    )


class PixelSettings(Section):
    """Which pixels take part [G15 2.2.5, 3.1.2]."""

    intensity_min: Share = Field(0.005, description="Least share of frames with a hit.")
    dead_share: Share = Field(
        0.05, description="A pixel with less than this share of its neighbours' hits is dead."
    )
    hot_share: Share = Field(
        0.2, description="A pixel that fires outside the gate in more frames than this is dead."
    )
    dead: tuple[tuple[int, int], ...] = Field((), description="Dead pixels besides: [row, column].")


class CalibrationFrames(Section):
    """Frames of a flat target across the optical axis, at a known distance."""

    frames: str = Field(description="File of frames, relative to the workflow.")
    distance_m: Positive = Field(description="From the lens to the target along the axis [m].")


class CalibrationSettings(Section):
    """From time bins to ranges [G15 3.4.3-3.4.4]."""

    frames: tuple[CalibrationFrames, ...] = Field(
        (), description="Frames to fit it from; without them the numbers below hold."
    )
    scale: Positive = Field(1.02379235588971, description="Measured over actual time, R0 [1].")
    offset_ns: float = Field(82.3525317669176, description="Delay of the electronics, R1 [ns].")
    range_walk: Literal["first_photon", "exponential", "none"] = Field(
        "first_photon", description="Law by which bright pixels range short."
    )
    walk_ns: float = Field(0.02190018680885, ge=0, description="A of the exponential law [ns].")
    walk_exponent: float = Field(4.588548204216641, description="B of the exponential law [1].")
    pulse_ns: float = Field(
        1.0, ge=0, description="Standard deviation of the echo, for the first-photon law [ns]."
    )
    dim_min: Share = Field(0.005, description="Least intensity of pixels without range walk.")
    dim_max: Share = Field(0.02, description="Greatest intensity of pixels without range walk.")
    pixel_offsets: bool = Field(
        True, description="Fit a delay of each pixel too, where there are frames to fit from."
    )


class MountSettings(Section):
    """Where the lens is and where it looks [G15 Eq. 3-6 to 3-9, table 3.3]."""

    off_nadir_deg: float = Field(19.5, ge=-80, le=80, description="Forward of straight down [deg].")
    scan_deg: float = Field(0.0, ge=-180, le=180, description="About the vertical [deg].")
    boresight_deg: Vector = Field(NONE, description="Small angles about the body's x, y, z [deg].")
    lever_arm_m: Vector = Field(
        NONE, description="Lens in the body frame: forward, starboard, down [m]."
    )
    attitude_deg: Vector = Field(NONE, description="Roll, pitch, heading of the body [deg].")
    position_m: Vector = Field(NONE, description="North, east, down of the body's origin [m].")


class WindowedSettings(Section):
    """The source's chain: median, non-local means, planes of a fixed window [G15 3.6.2]."""

    median: Literal[3, 5] = Field(3, description="Edge of the median's window [pixel].")
    search: int = Field(15, ge=3, description="Edge of the search window of the means [pixel].")
    patch: int = Field(7, ge=3, description="Edge of a patch [pixel].")
    strength_m: Positive = Field(
        0.02, description="Difference of patches at which a weight falls to 1/e, h [m]."
    )
    window: Literal[3, 5] = Field(3, description="Edge of a plane's window [pixel].")


class AdaptiveSettings(Section):
    """Weighted planes whose windows grow as long as their results agree."""

    half_windows: tuple[int, ...] = Field(
        (1, 2, 3, 4, 6, 8, 11, 15, 20, 31),
        min_length=1,
        description="Half edges of the windows that are tried, rising [pixel].",
    )
    order_max: int = Field(
        6, ge=0, le=8, description="Highest order of the polynomial that windows start from."
    )
    agreement: Positive = Field(
        4.0, description="Standard deviations within which two windows agree [1]."
    )
    outlier: Positive = Field(
        5.0, description="Standard deviations from the neighbours' median that a pixel may lie [1]."
    )


class SurfaceSettings(Section):
    """Acquisitions, and how each becomes a surface with normals."""

    frames_per_acquisition: int = Field(
        200, ge=1, description="Frames that make a surface [count]."
    )
    method: Literal["adaptive", "windowed"] = Field("adaptive", description="Way to the normals.")
    adaptive: AdaptiveSettings = AdaptiveSettings()
    windowed: WindowedSettings = WindowedSettings()


class PathSettings(Section):
    """The way of a green beam through the water [G15 2.5.2]."""

    index_water: float = Field(1.33, ge=1, lt=2, description="Refractive index of water [1].")
    in_water_m: float = Field(
        0.0, ge=0, description="Length of the path in water at which rays end; 0 traces none [m]."
    )
    beam_pixels: int = Field(
        16, ge=1, description="Edge of the beam's footprint in the array's middle [pixel]."
    )


class WaterSurvey(Section):
    """What was recorded, and where its local frame lies."""

    name: str = Field("water surface", description="Title of the report.")
    frames: str | tuple[str, ...] = Field(
        description="HDF5 files or Zarr groups of frames: a path or glob, or several."
    )
    crs: str | None = Field(None, description="CRS of the rasters, e.g. EPSG:32616; in metres.")
    origin_m: Vector = Field(
        NONE, description="Easting, northing, height of the local frame's origin [m]."
    )


class LevelSettings(Section):
    """A level surface that the results are compared with, where files carry no truth."""

    down_m: float = Field(description="Down coordinate of the level surface [m].")


class WaterOutputs(StoreSettings):
    """What is written beside the report."""

    cell_m: Positive = Field(0.01, description="Edge of a raster cell [m].")
    each_acquisition: bool = Field(
        False, description="A raster of each acquisition too, beside the mean of a file."
    )


class WaterWorkflow(BaseWorkflow):
    """Everything that a run on a water surface needs to know."""

    kind: Literal["water_surface"] = Field(
        "water_surface", description="Water surface from a Geiger-mode array."
    )
    survey: WaterSurvey
    camera: CameraSettings = CameraSettings()
    gate: GateSettings = GateSettings()
    pixels: PixelSettings = PixelSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    mount: MountSettings = MountSettings()
    surface: SurfaceSettings = SurfaceSettings()
    path: PathSettings = PathSettings()
    level: LevelSettings | None = None
    outputs: WaterOutputs = WaterOutputs()

    def faults(self) -> Iterator[str]:
        """What is wrong that no single key shows."""
        camera, calibration, surface = self.camera, self.calibration, self.surface
        size = f"{camera.rows} x {camera.cols}"
        for row, col in self.pixels.dead:
            if not (0 <= row < camera.rows and 0 <= col < camera.cols):
                yield f"pixels.dead: [{row}, {col}] is no pixel of {size}"
        if self.gate.width_bins > camera.bins:
            yield f"gate.width_bins: more than camera.bins, {camera.bins}"
        if calibration.frames and len({f.distance_m for f in calibration.frames}) < 2:
            yield "calibration.frames: at least two different distances are needed"
        if calibration.dim_min >= calibration.dim_max:
            yield "calibration.dim_min: must be below calibration.dim_max"
        halves = (0, *surface.adaptive.half_windows)
        if any(wider <= half for half, wider in pairwise(halves)):
            yield "surface.adaptive.half_windows: must rise, from 1 at the least"
        if surface.method == "windowed" and surface.windowed.patch > min(camera.rows, camera.cols):
            yield f"surface.windowed.patch: wider than the array of {size}"
