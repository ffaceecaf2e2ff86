"""A flight over the artificial scene [M20 3.3], and its files: frames, detections, a workflow.

Each frame has its own random numbers, so it does not depend on the others.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import yaml

from spl_batch.constants import QUANTA_PER_M, SPEED_OF_LIGHT_M_S
from spl_batch.engine.verbs.simulation import Simulated, finished, scene_of
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.simulate.scene import SceneSettings, build
from spl_batch.geiger.coincidence.simulate.scene_rays import Targets, expose
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.numerics.attitude import rotations


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Fly over the scene of a file; see :func:`simulate`."""
    return simulate(scene_of(SceneSettings, path), out, progress=progress)


def simulate(
    scene: SceneSettings, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Fly over a scene.

    Parameters
    ----------
    out : Path
        Folder for ``l1/``, ``scene.yaml`` and ``workflow.yaml``.
    progress : callable, optional
        Receives the share of the passes that is flown, 0..1.
    """
    targets, passes = build(scene), len(scene.flight.headings_deg)
    frames = detections = 0
    for k, seen in enumerate(flights(scene), start=1):
        found = detect(scene, seen, targets)
        for name, table in (("frames", seen), ("detections", found)):
            l1_files.write(out / "l1" / f"pass_{k}_{name}.parquet", table)
        frames, detections = frames + len(seen), detections + len(found)
        if progress is not None:
            progress(k / passes)
    workflow = {
        "kind": "coincidence",
        "survey": {
            "name": "Synthetic Geiger-mode scene",
            "crs": scene.crs,
            "frames": "l1/*_frames.parquet",
            "detections": "l1/*_detections.parquet",
        },
        "array": scene.array.model_dump(mode="json"),
        "output": "out",
    }
    made = yaml.safe_dump(scene.model_dump(mode="json"), sort_keys=False)
    write_bytes(out / "scene.yaml", made.encode())
    return finished(out, workflow, {"frames": frames, "detections": detections})


FRAMES_OF_A_PASS = 10_000_000
"""Frame numbers are the pass times this, and then count from the start of the pass."""


def flights(scene: SceneSettings) -> Iterator[Frames]:
    """Frames of each pass that look at the scene's part."""
    flight, array = scene.flight, scene.array
    half = 0.5 * np.array([array.rows, array.columns]) * array.ifov_rad * flight.altitude_m
    reach = 0.5 * math.hypot(*scene.extent_m) + float(half.max()) + flight.speed_m_s
    n = math.ceil(2 * reach / flight.speed_m_s * flight.pulse_rate_hz)
    for number, heading_deg in enumerate(flight.headings_deg, start=1):
        rng = np.random.default_rng([scene.seed, number])
        time = np.arange(n) / flight.pulse_rate_hz
        phase = (time * flight.sweeps_hz + 2.0 * rng.random()) % 2.0
        roll = flight.sweep_rad * (2.0 * np.abs(phase - 1.0) - 1.0)
        heading = np.full(n, math.radians(heading_deg))
        nose = np.array([math.sin(heading[0]), math.cos(heading[0]), 0.0])
        origin = (
            np.array([*scene.centre_m, flight.altitude_m])
            + nose * (flight.speed_m_s * time - reach)[:, None]
        )
        turn = rotations(heading, roll, np.zeros(n))
        axis = -turn[:, :, 2]
        ground = origin - axis * (origin[:, 2] / axis[:, 2])[:, None]
        # The image lies along the flight, which runs along an axis or slants across.
        lies = np.abs(turn[:, :2, 0]) * half[0] + np.abs(turn[:, :2, 1]) * half[1]
        away = np.abs(ground[:, :2] - scene.centre_m) - 0.5 * np.array(scene.extent_m)
        rows = np.flatnonzero((away <= lies + 0.5).all(axis=1))
        attitude = np.stack([heading, roll, np.zeros(n)], axis=-1)[rows]
        place = origin[rows] + np.array(scene.origin_m)
        yield Frames(number * FRAMES_OF_A_PASS + rows, place, attitude)


def detect(scene: SceneSettings, frames: Frames, targets: Targets) -> Detections:
    """What the detectors record in :func:`flights`: at most one detection of each in a frame.

    In order of frame and detector; places by each detector's own line of sight.
    """
    array, flight = scene.array, scene.flight
    tangent = math.tan(array.ifov_rad)
    gate = np.array([array.gate_start_m, array.gate_stop_m])
    jitter = np.array([flight.range_jitter_m, flight.angle_jitter_rad])
    dark_per_m = flight.dark_rate_hz * 2.0 / SPEED_OF_LIGHT_M_S
    row, column = np.indices((array.rows, array.columns))
    across, along = row - 0.5 * (array.rows - 1), column - 0.5 * (array.columns - 1)
    looks = np.stack([across * tangent, along * tangent, -np.ones(row.shape)], -1).reshape(-1, 3)
    looks /= np.linalg.norm(looks, axis=1)[:, None]
    image = np.empty(row.shape)
    parts = [Detections.joined([])]
    for number, origin, turn in zip(frames.number, frames.origin_m, frames.turn, strict=True):
        rng = np.random.default_rng([scene.seed, int(number)])
        expose(
            *(rng, origin - np.array(scene.origin_m), turn, targets, tangent, gate),
            *(flight.efficiency, dark_per_m, jitter, flight.range_bin_m, image),
        )
        fired = np.flatnonzero(np.isfinite(image.ravel()))
        place = origin + image.ravel()[fired, None] * (looks[fired] @ turn.T)
        xyz = np.rint(place * QUANTA_PER_M).astype(np.int64)
        parts.append(Detections(np.full(len(fired), number), fired.astype(np.int32), xyz))
    return Detections.joined(parts)


def fly(scene: SceneSettings) -> tuple[Frames, Detections]:
    """Frames and detections of all passes, in order."""
    targets = build(scene)
    frames = list(flights(scene))
    return Frames.joined(frames), Detections.joined([detect(scene, f, targets) for f in frames])
