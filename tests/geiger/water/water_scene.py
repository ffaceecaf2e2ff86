"""A small tank with waves: two files of three surfaces each, and frames of targets."""

from pathlib import Path
from typing import Any

import yaml

from spl_batch.geiger.water.simulate import simulate_file

TANK: dict[str, Any] = {
    "kind": "water_surface",
    "name": "tank",
    "files": 2,
    "camera": {"rows": 20, "cols": 18},
    "acquisitions": 3,
    "frames_per_acquisition": 60,
    "in_water_m": 6.0,
    "mount": {"position_m": [0, 0, -3.0]},
    "target": {"down_m": 0.1, "waves": [{"amplitude_m": 0.02, "length_m": 1.0}]},
    "instrument": {"dead": 30, "peak_photoelectrons": 1.5, "beam_centre_px": [9, 9]},
    "calibration": {"frames": 250, "distances_m": [2.5, 3.5], "lights": [0.3, 2]},
}


def write_tank(folder: Path, **changes: Any) -> Path:
    """Simulate the tank, or one that differs, into ``folder/data``; its workflow."""
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump({**TANK, **changes}))
    return simulate_file(scene, folder / "data").workflow
