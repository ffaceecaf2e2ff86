"""Tasks of the space domain: tiles, their cells, and flightlines compared with each other."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from spl_batch.airborne.lines.patches import SQUARE_M
from spl_batch.airborne.noise.local_noise import MARGIN_VOXELS
from spl_batch.airborne.plan.flightlines import is_timeless
from spl_batch.airborne.plan.grid import Unit
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import cell_bytes, refusal, surface_reach_m
from spl_batch.airborne.store.label_tables import SHIFTED
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.task import Need, Task
from spl_batch.lattice.tiles import Bounds, BoxIndex, CellId, grow, parse_cell, quanta


def build_tile(survey: Survey) -> Iterator[Task]:
    """Tiles that hold points, each from the stretches that have some of them."""
    scattered = survey.of("scatter")
    stretches, known = sorted(scattered), dict[str, int]()
    # Millions of pieces are numbers: tile, stretch, first row in the stretch's file, and points.
    found = [np.empty((0, 4), np.int32)]
    for number, stretch in enumerate(stretches):
        tiles = scattered[stretch].facts["tiles"].items()
        rows = [[known.setdefault(tile, len(known)), number, *held] for tile, held in tiles]
        found.append(np.array(rows, np.int32).reshape(-1, 4))
    pieces = np.concatenate(found)
    pieces = pieces[np.argsort(pieces[:, 0], kind="stable")]  # stretches stay in the order of names
    starts = np.searchsorted(pieces[:, 0], np.arange(len(known) + 1))
    for tile in sorted(map(parse_cell, known)):
        name = str(tile)
        k = known[name]
        mine = pieces[starts[k] : starts[k + 1], 1:].tolist()
        listed = [(stretches[number], first, count) for number, first, count in mine]
        needs = tuple(("scatter", stretch) for stretch, *_ in listed)
        points = sum(count for *_, count in listed)
        args = {"tile": name, "pieces": listed, "by_line": survey.filtering}
        refused = refusal("build_tile", points, survey.memory_bytes)
        yield Task("build_tile", name, args, needs, points, refused)


def denoise(survey: Survey) -> Iterator[Task]:
    """Cells of tiles, with the stretches whose noise reaches them."""
    voxel_q = quanta(survey.workflow.noise.voxel_m)
    stretch_of: dict[str, str] = {}
    voxels: dict[str, Sequence[int]] = {}
    for stretch, receipt in survey.of("scatter").items():
        boxes = receipt.facts.get("voxels", {})
        voxels |= boxes
        stretch_of |= dict.fromkeys(boxes, stretch)
    flat = {name: (*box[:2], *box[3:5]) for name, box in voxels.items()}
    index = index_of_boxes(flat, voxel_q)
    # what a density depends on, whatever the halo of the points
    margin = survey.halo_q + MARGIN_VOXELS * voxel_q
    for cell in survey.denoise_grid.units(survey.counts, survey.tile_q, survey.halo_q):
        parts = index.overlapping(grow(cell.core, margin))
        shares = [(part, voxels[part][2], voxels[part][5]) for part in parts]
        args = {"halo": survey.halo_q, "voxels": shares, "beamlets": survey.beamlets}
        needs = [("scatter", s) for s in dict.fromkeys(map(stretch_of.__getitem__, parts))]
        yield _cell_task("denoise", cell, survey, args, (), needs)


def ground(survey: Survey) -> Iterator[Task]:
    """Ground cells with their buffers."""
    halo = quanta(survey.workflow.ground.buffer_m)
    for cell in survey.ground_cells(halo):
        yield _cell_task("ground", cell, survey, {"halo": halo}, ("denoise",))


def surface(survey: Survey) -> Iterator[Task]:
    """Ground cells whose ground is found, with what their rasters read around them."""
    halo = quanta(surface_reach_m(survey.workflow))
    known = knows_reflectance(survey)
    index = index_of_boxes(_fired(survey), QUANTA_PER_M) if known else None
    for cell in survey.ground_cells(halo):
        parts = None if index is None else index.overlapping(grow(cell.core, halo))
        args = {
            "halo": halo,
            "polygons": survey.inputs.checksums("aoi", "water", "breaklines"),
            "fired": parts,
        }
        needs = [("scatter", name) for name in parts or ()]
        yield _cell_task("surface", cell, survey, args, ("denoise", "ground"), needs)


def _cell_task(
    kind: str,
    cell: Unit,
    survey: Survey,
    args: Mapping[str, object],
    labels: Collection[str],
    needs: Collection[Need] = (),
) -> Task:
    """A task of a cell: what it owns, and the tiles that it reads with labels of some steps."""
    tiles = [str(tile) for tile in cell.tiles]
    name = str(cell.cell)
    place = {"cell": name, "core": list(cell.core), "tiles": tiles}
    needed = cell_bytes(kind, cell.core, cell.held, survey.workflow)
    refused = refusal(kind, cell.held, survey.memory_bytes, needed)
    whole = (*points_of(survey, cell.tiles, *labels), *needs)
    return Task(kind, name, {**place, **args}, whole, cell.points, refused)


def knows_reflectance(survey: Survey) -> bool:
    """Whether the intensity raster is made of detections, and not of the input's values."""
    workflow = survey.workflow
    if workflow.filter.method == "none" or workflow.products.intensity != "detection":
        return False
    return any(box[2] > box[0] for box in _fired(survey).values())


def _fired(survey: Survey) -> dict[str, Sequence[int]]:
    """Where stretches fired, near the ground: west, south, east, north [m]."""
    scattered = ((name, r.facts) for name, r in survey.of("scatter").items())
    return {name: facts["fired"] for name, facts in scattered if "fired" in facts}


def aligned(survey: Survey) -> tuple[Need, ...]:
    """The task that finds the shifts of heights, if one has."""
    return (SHIFTED,) if SHIFTED[1] in survey.of(SHIFTED[0]) else ()


def points_of(
    survey: Survey, tiles: Collection[CellId], *steps: str, margin: int = 0
) -> tuple[Need, ...]:
    """Tasks that give the points of some tiles, their labels by some steps, and shifts of heights.

    ``margin``: of the tiles, in which labels are asked for too [quanta].
    """
    grids = {step: survey.denoise_grid if step == "denoise" else survey.grid for step in steps}
    labels = (
        (step, unit)
        for step, grid in grids.items()
        for unit in grid.owners(tiles, survey.tile_q, margin)
    )
    return (*(("build_tile", str(tile)) for tile in tiles), *labels, *aligned(survey))


def index_of_boxes(boxes: Mapping[str, Sequence[int]], unit_q: int) -> BoxIndex:
    """Stretches by place; ``boxes``: xmin, ymin, xmax, ymax of each, in units [quanta]."""
    return BoxIndex({name: Bounds(*(unit_q * end for end in box)) for name, box in boxes.items()})


def is_one_flightline(survey: Survey) -> bool:
    """Whether there is nothing to compare; known once the index is complete.

    Which flightlines files without times hold shows in their points alone.
    """
    indexed = survey.of("index_file").values()
    return len(survey.flown) < 2 and not any(is_timeless(r, survey.workflow) for r in indexed)


def strip_patches(survey: Survey) -> Iterator[Task]:
    """Ground cells, where there can be more than one flightline, with heights as recorded."""
    if is_one_flightline(survey):
        return
    for cell in survey.ground_cells(quanta(SQUARE_M)):
        yield replace(_cell_task("strip_patches", cell, survey, {}, ("denoise",)), points=0)


def align(survey: Survey) -> Iterator[Task]:
    """One task that finds the shifts of all flightlines, where they are to be aligned."""
    if survey.workflow.survey.align != "none":
        yield from _together("align", survey)


def strip_pairs(survey: Survey) -> Iterator[Task]:
    """One task that puts all cells together, with the shifts where there are any."""
    for task in _together("strip_pairs", survey):
        yield replace(task, needs=(*task.needs, *aligned(survey)))


def _together(kind: str, survey: Survey) -> Iterator[Task]:
    """One task on what was found in all cells, if anything was, and flightlines with times."""
    if cells := sorted(survey.of("strip_patches")):
        args = {"lines": [[*line.as_pass] for line in survey.flown], "cells": cells}
        yield Task(kind, "all", args, tuple(("strip_patches", name) for name in cells))
