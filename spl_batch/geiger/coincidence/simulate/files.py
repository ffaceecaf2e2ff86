"""Files of a simulated flight: frames and detections of each pass, a workflow."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml

from spl_batch.engine.settings.validation import validated
from spl_batch.engine.settings.workflow_file import read_mapping
from spl_batch.errors import grouped
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.simulate.flight import detect, flights
from spl_batch.geiger.coincidence.simulate.scene import SceneSettings, build


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
