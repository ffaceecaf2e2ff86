"""Surveys that the groups share, each made and run once, and hashes of what was delivered."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import laspy
import numpy as np
import rasterio

from benchmarks.airborne import sky
from benchmarks.airborne.ground.whole_runs import WORKFLOWS
from benchmarks.held.figures import Figure
from spl_batch import api
from spl_batch.airborne.simulate import preset_scene, simulate

HASH_DIGITS = 16
"""Hexadecimal digits that are kept of a hash [count]."""


class Given(NamedTuple):
    """Folder for surveys, and that of the real data where it was given."""

    scratch: Path
    data: Path | None

    def real(self, pattern: str) -> list[Path]:
        """Files of the real data, sorted; none without the folder."""
        return sorted(self.data.glob(pattern)) if self.data else []


def once(folder: Path, make: Callable[[Path], object], *overrides: str) -> Path:
    """Folder of a survey that is simulated and run unless this process has done so."""
    if not folder.exists():
        make(folder)
        run(folder / "workflow.yaml", *overrides)
    return folder


def run(workflow: Path, *overrides: str) -> None:
    """Run a workflow in this process; a failed one ends the command."""
    if api.run(workflow, workers=0, overrides=overrides).exit_status:
        raise SystemExit(f"{workflow}: the run failed; see log.jsonl in its output")


def quickstart(given: Given) -> Path:
    """The survey of ``spl-batch quickstart``, run with diagnostics."""
    return once(
        given.scratch / "quickstart",
        lambda folder: simulate(preset_scene("quickstart"), folder),
        "outputs.diagnostics=true",
    )


def in_sky(given: Given, name: str) -> Path:
    """A survey of two flightlines under a sky of :mod:`benchmarks.airborne.sky`."""
    survey = given.scratch / "sky" / name
    if not survey.exists():
        made = sky.simulated(survey, name, 1.0)
        run(made / "workflow.yaml", *sky.SETTINGS.get(name, ()))
    return next(survey.iterdir())


def plot(cloud: Path, given: Given) -> Path:
    """Output of a real plot's run."""
    folder = given.scratch / cloud.stem
    folder.mkdir()
    workflow = folder / "workflow.yaml"
    workflow.write_text(WORKFLOWS["spl100"].format(cloud.resolve()), encoding="utf-8")
    run(workflow)
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
            labels.update(np.ascontiguousarray(las[dimension], dtype=np.uint8))
    yield Figure(f"{name}: labels", labels.hexdigest()[:HASH_DIGITS])
    for path in sorted(out.glob("*.tif")):
        with rasterio.open(path) as source:
            cells = hashlib.sha256(repr((source.shape, tuple(source.transform))).encode())
            cells.update(np.ascontiguousarray(source.read()))
        yield Figure(f"{name}: {path.stem}", cells.hexdigest()[:HASH_DIGITS])
