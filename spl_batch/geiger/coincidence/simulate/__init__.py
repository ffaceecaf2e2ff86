"""Synthetic Geiger-mode data with a known scene [M20 ch. 3]."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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

    #: Laser pulses that look at the scene; detections in them [count].
    frames: int
    detections: int

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Label and value of what a user is told."""
        return [
            ("frames", grouped(self.frames)),
            ("detections", grouped(self.detections)),
        ]


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> CoincidenceSimulation:
    """Fly over the scene of a file.

    Parameters
    ----------
    out : Path
        Folder for ``l1/``, ``scene.yaml`` and ``workflow.yaml``.
    progress : callable, optional
        Told the share that is done, 0..1.

    Raises
    ------
    WorkflowError
        If the scene has a fault.
    """
    content = read_mapping(path, "a scene is a mapping with targets: and extent_m:")
    return simulate(validated(SceneSettings, content, str(path)), out, progress=progress)


def simulate(
    scene: SceneSettings, out: Path, *, progress: Callable[[float], None] | None = None
) -> CoincidenceSimulation:
    """Fly over a scene; see :func:`simulate_file`."""
    targets, passes = build(scene), len(scene.flight.headings_deg)
    frames = detections = 0
    for k, (seen, attitudes) in enumerate(flights(scene), start=1):
        found = detect(scene, seen, targets, partial(_tell, progress, k - 1, passes))
        l1_files.write_frames(out / "l1" / f"pass_{k}_frames.parquet", attitudes)
        l1_files.write_detections(out / "l1" / f"pass_{k}_detections.parquet", found)
        frames, detections = frames + len(seen), detections + len(found)
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


def _tell(progress: Callable[[float], None] | None, before: int, passes: int, share: float) -> None:
    """Tell the flown share of all passes: some whole ones and a part of this one."""
    if progress is not None:
        progress((before + share) / passes)
