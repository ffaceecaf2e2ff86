"""A flight over the artificial scene [M20 3.3], and its files: frames, detections, a workflow.

Each frame has its own random numbers, so it does not depend on the others.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from spl_batch.constants import QUANTA_PER_M, SPEED_OF_LIGHT_M_S
from spl_batch.engine.settings.validation import validated
from spl_batch.engine.settings.workflow_file import read_mapping
from spl_batch.errors import grouped
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.simulate.scene import SceneSettings, build
from spl_batch.geiger.coincidence.simulate.scene_rays import Targets, expose
from spl_batch.geiger.coincidence.tables import Attitudes, Detections, Frames
from spl_batch.numerics.attitude import rotations


@dataclass(frozen=True, slots=True)
class CoincidenceSimulation:
    """What was made."""

    frames: int  #: Laser pulses that look at the scene [count].
    detections: int  #: Detections in them [count].

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows."""
        return [("frames", grouped(self.frames)), ("detections", grouped(self.detections))]


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> CoincidenceSimulation:
    """Fly over the scene of a file; see :func:`simulate`."""
    content = read_mapping(path, "a scene is a mapping with targets: and extent_m:")
    return simulate(validated(SceneSettings, content, str(path)), out, progress=progress)


def simulate(
    scene: SceneSettings, out: Path, *, progress: Callable[[float], None] | None = None
) -> CoincidenceSimulation:
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
    for k, (seen, attitudes) in enumerate(flights(scene), start=1):
        found = detect(scene, seen, targets)
        l1_files.write_frames(out / "l1" / f"pass_{k}_frames.parquet", attitudes)
        l1_files.write_detections(out / "l1" / f"pass_{k}_detections.parquet", found)
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
    for name, made in (("workflow", workflow), ("scene", scene.model_dump(mode="json"))):
        write_bytes(out / f"{name}.yaml", yaml.safe_dump(made, sort_keys=False).encode())
    return CoincidenceSimulation(frames, detections)


FRAMES_OF_A_PASS = 10_000_000
"""Frame numbers are the pass times this, and then count from the start of the pass."""


def flights(scene: SceneSettings) -> Iterator[tuple[Frames, Attitudes]]:
    """Frames of each pass that look at the scene's part, as directions and as files have them."""
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
        number_of, place = number * FRAMES_OF_A_PASS + rows, origin[rows] + np.array(scene.origin_m)
        yield Frames(number_of, place, turn[rows]), Attitudes(number_of, place, attitude)


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
    frames = [found for found, _ in flights(scene)]
    parts = [detect(scene, part, targets) for part in frames]
    return Frames.joined(frames), Detections.joined(parts)
