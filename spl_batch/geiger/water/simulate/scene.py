"""The scene file of a water surface: what is looked at, with which instrument, how long."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.settings.base import Positive, Section
from spl_batch.geiger.water.settings import CameraSettings, MountSettings
from spl_batch.geiger.water.simulate.frames import Instrument, Target


class TargetFrames(Section):
    """Frames of a flat target for calibration, at several distances and amounts of light."""

    distances_m: tuple[Positive, ...] = Field(
        (2.0, 3.0, 4.0, 5.0), min_length=2, description="Of the target along the axis [m]."
    )
    lights: tuple[Positive, ...] = Field(
        (0.04, 0.3, 1.0, 4.0), min_length=1, description="Shares of the light of the beam."
    )
    frames: int = Field(1000, ge=1, description="Frames at each distance and light [count].")
    tape_m: float = Field(
        0.0, ge=0, description="Standard deviation of the error of a distance [m]."
    )


class WaterScene(Section):
    """A water surface to be simulated."""

    kind: Literal["water_surface"] = Field(description="Receiver that the scene is for.")
    name: str = Field("water", description="Title, and name of the files.")
    seed: int = Field(1, ge=0, description="Every photon follows from it.")
    camera: CameraSettings = CameraSettings()
    mount: MountSettings = Field(
        MountSettings(position_m=(0.0, 0.0, -3.1)), description="Where the lens is."
    )
    target: Target = Field(Target(0.0), description="Surface: down_m, waves, penetration_m.")
    instrument: Instrument = Field(Instrument(), description="The array as it really is.")
    files: int = Field(1, ge=1, le=10_000, description="Files of frames [count].")
    acquisitions: int = Field(10, ge=1, description="Acquisitions of each file [count].")
    frames_per_acquisition: int = Field(200, ge=1, description="Frames of each [count].")
    calibration: TargetFrames | None = TargetFrames()
    format: Literal["h5", "zarr"] = Field("h5", description="HDF5 or Zarr.")
    in_water_m: float = Field(0.0, ge=0, description="Way in water of the workflow's rays [m].")
