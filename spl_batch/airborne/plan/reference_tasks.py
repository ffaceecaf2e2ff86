"""What results are compared with: reference points, by files and by squares; checkpoints."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final

import shapely

from spl_batch.airborne.accuracy.differences import OPEN_M
from spl_batch.airborne.plan.space_tasks import points_of
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import STRETCH_POINTS, UNEVEN, points_within, refusal
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.plan.input_files import source_key
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.task import Task
from spl_batch.lattice.tiles import cell_bounds, overlap, parse_cell, quanta

MARGIN_CELLS: Final = 2
"""Raster cells whose tops show whether their neighbour is a roof's edge [count]."""

COMPARED: Final = ("dtm", "dsm", "chm")
"""Rasters that are looked at; nothing is compared without the first two."""


def reference(survey: Survey) -> Iterator[Task]:
    """Reference files, each to be cut into squares."""
    if not survey.of("surface"):
        return
    for error in survey.inputs.reference.bad:
        name = str(source_key(error.path))
        yield Task("reference", name, {"path": error.path}, (), 0, str(error))
    edge, margin = _lattice(survey)
    for facts in survey.inputs.reference.usable:
        name = str(source_key(str(facts.path)))
        args = {
            "file": name,
            "path": str(facts.path),
            "stamp": stamp_if_there(facts.path),
            "edge": edge,
            "margin": margin,
        }
        yield Task("reference", name, args, (), facts.n_points)


def accuracy(survey: Survey) -> Iterator[Task]:
    """Squares that hold reference points."""
    if not {"dtm", "dsm"} <= survey.of("mosaic").keys():
        return
    files: dict[str, list[str]] = {}
    points = Counter[str]()
    for name, receipt in sorted(survey.of("reference").items()):
        for square, count in receipt.facts["squares"].items():
            files.setdefault(square, []).append(name)
            points[square] += count
    made = survey.of("mosaic")
    rasters = [name for name in COMPARED if name in made]
    edge, _ = _lattice(survey)
    for square in sorted(files):
        within = cell_bounds(parse_cell(square), edge)
        tiles = [t for t in survey.counts if overlap(cell_bounds(t, survey.tile_q), within)]
        args = {
            "square": square,
            "edge": edge,
            "files": files[square],
            "rasters": rasters,
            "tiles": [str(tile) for tile in tiles],
        }
        needs = (
            *(("reference", name) for name in files[square]),
            *(("mosaic", name) for name in rasters),
            *points_of(survey, tiles, "denoise"),
        )
        refused = refusal("accuracy", points[square], survey.memory_bytes)
        yield Task("accuracy", square, args, needs, points[square], refused)


def checkpoints(survey: Survey) -> Iterator[Task]:
    """The file of checkpoints, to be compared with the terrain."""
    found = survey.inputs.checkpoints
    if found is None or "dtm" not in survey.of("mosaic"):
        return
    args = {
        "name": found.name,
        "path": str(found.path),
        "stamp": stamp_if_there(found.path),
    }
    yield Task("checkpoints", "all", args, (("mosaic", "dtm"),))


def squares(survey: Survey) -> int:
    """Squares that the headers of reference files reach, by which they are compared [count]."""
    edge, _ = _lattice(survey)
    ends = shapely.bounds(survey.inputs.reference.boxes) * QUANTA_PER_M // edge
    return int((ends[:, 2:] - ends[:, :2] + 1).prod(axis=1).sum())


def _lattice(survey: Survey) -> tuple[int, int]:
    """Edge of a square, and of what it reads around itself [quanta].

    The edge is a power of two of raster cells: a file more seldom changes it.
    """
    cell = quanta(survey.workflow.products.cell_m)
    # what stands beside a point stands above ground that is beside it
    margin = max(quanta(2 * OPEN_M), MARGIN_CELLS * cell)
    boxes = survey.inputs.reference.holding
    area_m2 = sum(facts.area_m2 for facts in boxes)
    points = sum(facts.n_points for facts in boxes)
    held = min(STRETCH_POINTS, points_within("accuracy", survey.memory_bytes) // UNEVEN)
    wanted = quanta(math.sqrt(area_m2 * held / max(points, 1)))
    edge = cell
    while edge <= 2 * margin or 2 * edge <= wanted:
        edge *= 2
    return edge, margin
