"""Scene of a simulated water surface, and its files: frames, truth, targets, a workflow."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from spl_batch.engine.settings.base import Positive, Section
from spl_batch.engine.verbs.simulation import Simulated, finished, scene_of
from spl_batch.geiger.water.formats import FrameTruth, write_frames
from spl_batch.geiger.water.pixel_geometry import view_of
from spl_batch.geiger.water.settings import CameraSettings, MountSettings
from spl_batch.geiger.water.simulate.frames import Instrument, Target, acquisitions


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


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Simulate the scene of a file; see :func:`simulate`."""
    return simulate(scene_of(WaterScene, path), out, progress=progress)


def simulate(
    scene: WaterScene, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Write the files of a scene.

    ``progress`` receives the share of the files that is written, 0..1.
    """
    for k in range(scene.files):
        _water(scene, k, out / "frames" / f"{scene.name}_{k:02d}.{scene.format}")
        if progress is not None:
            progress((k + 1) / (scene.files + (scene.calibration is not None)))
    listed = _targets(scene, scene.calibration, out) if scene.calibration else []
    if progress is not None:
        progress(1.0)
    frames = scene.files * scene.acquisitions * scene.frames_per_acquisition
    targets = len(listed) * scene.calibration.frames if scene.calibration else 0
    return finished(out, _workflow(scene, listed), {"frames": frames, "frames of targets": targets})


def _water(scene: WaterScene, k: int, path: Path) -> None:
    view, per = view_of(scene.camera, scene.mount), scene.frames_per_acquisition
    what = (scene.target, scene.instrument, scene.camera, view)
    made = list(acquisitions(*what, scene.acquisitions, per, (scene.seed, k)))
    truth = FrameTruth(
        np.stack([a.true_down_m for a in made]), np.stack([a.true_normals for a in made])
    )
    _write(scene, path, np.concatenate([a.frames for a in made]), truth)


def _write(scene: WaterScene, path: Path, frames: Any, truth: FrameTruth | None = None) -> None:
    described = {"bin_ns": scene.camera.bin_ns, "prf_hz": scene.camera.prf_hz}
    write_frames(path, frames, described, truth, scene.frames_per_acquisition)


def _targets(scene: WaterScene, wanted: TargetFrames, out: Path) -> list[dict[str, Any]]:
    """Frames of a flat target across the axis, at distances that are known with an error."""
    rng = np.random.default_rng((scene.seed, 1_000_000))
    view = view_of(scene.camera, MountSettings(off_nadir_deg=0.0))
    listed: list[dict[str, Any]] = []
    for distance in wanted.distances_m:
        measured = float(distance + wanted.tape_m * rng.standard_normal())
        for light in wanted.lights:
            seed = (scene.seed, 1_000_001 + len(listed))
            what = (Target(distance), scene.instrument.dimmed(light), scene.camera, view)
            (made,) = acquisitions(*what, 1, wanted.frames, seed)
            name = f"calibration/{distance:g}m_{light:g}.{scene.format}"
            _write(scene, out / name, made.frames)
            listed.append({"frames": name, "distance_m": measured})
    return listed


def _workflow(scene: WaterScene, listed: list[dict[str, Any]]) -> dict[str, Any]:
    camera = scene.camera.model_dump(mode="json", exclude_defaults=True)
    mount = scene.mount.model_dump(mode="json", exclude_defaults=True)
    content: dict[str, Any] = {
        "kind": "water_surface",
        "survey": {"name": scene.name, "frames": f"frames/*.{scene.format}"},
        "output": "out",
        "surface": {"frames_per_acquisition": scene.frames_per_acquisition},
        "path": {"in_water_m": scene.in_water_m},
    }
    given = {"camera": camera, "mount": mount, "calibration": listed and {"frames": listed}}
    return content | {key: value for key, value in given.items() if value}
