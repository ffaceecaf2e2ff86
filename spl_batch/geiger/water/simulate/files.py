"""Files of a simulated water surface: frames with truth, frames of targets, a workflow."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from spl_batch.errors import grouped
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.water.formats import FrameTruth, write_frames
from spl_batch.geiger.water.pixel_geometry import View, view_of
from spl_batch.geiger.water.settings import MountSettings
from spl_batch.geiger.water.simulate.frames import Target, acquisitions
from spl_batch.geiger.water.simulate.scene import TargetFrames, WaterScene, load_scene


@dataclass(frozen=True, slots=True)
class WaterSummary:
    """What was written."""

    #: Folder, and the workflow in it, ready to run.
    out: Path
    workflow: Path
    #: frames, targets: frames of the water, and of targets [count].
    frames: int
    targets: int
    wall_s: float

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Label and value of what a user is told."""
        return [
            ("frames", grouped(self.frames)),
            ("frames of targets", grouped(self.targets)),
        ]


def simulate_file(
    scene: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> WaterSummary:
    """Simulate a scene file."""
    return simulate(load_scene(scene), out, progress=progress)


def simulate(
    scene: WaterScene, out: Path, *, progress: Callable[[float], None] | None = None
) -> WaterSummary:
    """Write the files of a scene.

    ``out``: folder; made where it is missing. ``progress``: told the share that is done, 0..1.
    """
    start = time.perf_counter()
    view = view_of(scene.camera, scene.mount)
    frames = 0
    for k in range(scene.files):
        frames += _water(scene, view, k, out / "frames" / f"{scene.name}_{k:02d}.{scene.format}")
        if progress is not None:
            progress((k + 1) / (scene.files + (scene.calibration is not None)))
    listed, targets = _targets(scene, scene.calibration, out) if scene.calibration else ([], 0)
    workflow = out / "workflow.yaml"
    text = yaml.safe_dump(_workflow(scene, listed), sort_keys=False)
    write_bytes(workflow, text.encode())
    if progress is not None:
        progress(1.0)
    return WaterSummary(out, workflow, frames, targets, time.perf_counter() - start)


def _attributes(scene: WaterScene) -> dict[str, float]:
    return {"bin_ns": scene.camera.bin_ns, "prf_hz": scene.camera.prf_hz}


def _water(scene: WaterScene, view: View, k: int, path: Path) -> int:
    made = list(
        acquisitions(
            scene.target,
            scene.instrument,
            scene.camera,
            view,
            scene.acquisitions,
            scene.frames_per_acquisition,
            (scene.seed, k),
        )
    )
    frames = np.concatenate([a.frames for a in made])
    truth = FrameTruth(
        np.stack([a.true_down_m for a in made]), np.stack([a.true_normals for a in made])
    )
    write_frames(path, frames, _attributes(scene), truth, scene.frames_per_acquisition)
    return len(frames)


def _targets(
    scene: WaterScene, wanted: TargetFrames, out: Path
) -> tuple[list[dict[str, Any]], int]:
    """Frames of a flat target across the axis, at distances that are known with an error."""
    rng = np.random.default_rng((scene.seed, 1_000_000))
    view = view_of(scene.camera, MountSettings(off_nadir_deg=0.0))
    listed: list[dict[str, Any]] = []
    for distance in wanted.distances_m:
        said = float(distance + wanted.tape_m * rng.standard_normal())
        for light in wanted.lights:
            seed = (scene.seed, 1_000_001 + len(listed))
            (made,) = acquisitions(
                Target(distance),
                scene.instrument.dimmed(light),
                scene.camera,
                view,
                1,
                wanted.frames,
                seed,
            )
            name = f"calibration/{distance:g}m_{light:g}.{scene.format}"
            write_frames(out / name, made.frames, _attributes(scene))
            listed.append({"frames": name, "distance_m": said})
    return listed, len(listed) * wanted.frames


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
    content |= {key: v for key, v in (("camera", camera), ("mount", mount)) if v}
    if listed:
        content["calibration"] = {"frames": listed}
    return content
