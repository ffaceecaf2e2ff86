"""Surveys that the groups share, each made and run once, and hashes of what was delivered."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import laspy
import numpy as np
import rasterio

from benchmarks.held import scenes
from benchmarks.held.figures import Figure
from spl_batch import api
from spl_batch.airborne.simulate import preset_scene, simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene

HASH_DIGITS = 16
"""Hexadecimal digits that are kept of a hash [count]."""

PHOTON_COUNTING = (
    "{{survey: {{flightlines: {0}, sensor: spl100, channel_dimension: user_data}}, output: out}}"
)
LINEAR = (
    "{{survey: {{flightlines: {0}}}, filter: {{method: none}}, afterpulse: {{enabled: false}}, "
    "output: out}}"
)
"""Workflows of a cloud."""


class Given(NamedTuple):
    """Folder for surveys, and that of the real data where it was given."""

    scratch: Path
    data: Path | None

    def real(self, pattern: str) -> list[Path]:
        """Files of the real data, sorted; none without the folder."""
        return sorted(self.data.glob(pattern)) if self.data else []


def simulated(content: Mapping[str, Any] | Scene, folder: Path) -> Path:
    """Folder of a survey, simulated unless this process has done so."""
    if not (folder / "workflow.yaml").exists():
        scene = content if isinstance(content, Scene) else parse_scene(dict(content), "scene")
        simulate(scene, folder)
    return folder


def once(content: Mapping[str, Any] | Scene, folder: Path, *overrides: str) -> Path:
    """Folder of a survey that is simulated and run unless this process has done so."""
    if not (folder / "out").exists():
        run(simulated(content, folder) / "workflow.yaml", *overrides)
    return folder


def run(workflow: Path, *overrides: str) -> None:
    """Run a workflow in this process; a failed one ends the command."""
    if api.run(workflow, workers=0, overrides=overrides).exit_status:
        raise SystemExit(f"{workflow}: the run failed; see log.jsonl in its output")


def quickstart(given: Given) -> Path:
    """The survey of ``spl-batch quickstart``, run with diagnostics."""
    folder = given.scratch / "quickstart"
    return once(preset_scene("quickstart"), folder, "outputs.diagnostics=true")


def in_sky(given: Given, name: str) -> Path:
    """Two flightlines under a sky of :data:`~benchmarks.held.scenes.SKIES`."""
    return once(scenes.sky(name), given.scratch / "sky" / name.replace(" ", "_"))


def of_cloud(cloud: Path, workflow: str, folder: Path) -> Path:
    """Output of a run on one cloud."""
    if not folder.exists():
        folder.mkdir(parents=True)
        path = folder / "workflow.yaml"
        path.write_text(workflow.format(cloud.resolve()), encoding="utf-8")
        run(path)
    return folder / "out"


def hashes(out: Path, name: str) -> Iterator[Figure]:
    """Hash of the labels of all clouds of an output, and of each raster.

    They are those of the decoded values, so that no compression matters: classification and noise
    class of each LAZ file, shape, place and cells of each raster.
    """
    labels = hashlib.sha256()
    for path in sorted((out / "laz").rglob("*.laz")):
        las = laspy.read(path)
        for dimension in ("classification", "noise_class"):
            labels.update(np.asarray(las[dimension]).astype(np.uint8).tobytes())
    yield Figure(f"{name}: labels", labels.hexdigest()[:HASH_DIGITS])
    for path in sorted(out.glob("*.tif")):
        with rasterio.open(path) as source:
            cells = hashlib.sha256(repr((source.shape, tuple(source.transform))).encode())
            cells.update(source.read().tobytes())
        yield Figure(f"{name}: {path.stem}", cells.hexdigest()[:HASH_DIGITS])
