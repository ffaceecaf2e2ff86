"""Tasks that compare flightlines with each other: by ground cell, then all together.

Where flightlines are aligned they are compared before the ground is looked for as well.
"""

from collections.abc import Iterator

from spl_batch.airborne.plan.flightlines import is_timeless
from spl_batch.airborne.plan.space_tasks import (
    aligned,
    cell_args,
    cell_in_memory,
    label_needs,
    named_units,
    tile_needs,
)
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.products.product_table import SWATH_DIFFERENCES
from spl_batch.airborne.strips.strip_comparison import RECORDED
from spl_batch.airborne.strips.strip_patches import SQUARE_M
from spl_batch.engine.tasks.task import Task
from spl_batch.lattice.tiles import quanta


def recorded_patches(survey: Survey) -> Iterator[Task]:
    """Ground cells whose flightlines are to be aligned."""
    if survey.workflow.survey.align != "none":
        yield from _patches("recorded_patches", RECORDED, survey)


def is_one_flightline(survey: Survey) -> bool:
    """Whether there is nothing to compare; known once the index is complete."""
    return len(_strips(survey)) < 2 and not _has_timeless(survey)


def align(survey: Survey) -> Iterator[Task]:
    """One task that finds the shifts of all flightlines."""
    done = survey.of("recorded_patches")
    if len(done):
        cells = sorted(name for name, r in done.items() if r.facts["patches"])
        needs = tuple(("recorded_patches", name) for name in cells)
        yield Task("align", "all", {"strips": _strips(survey), "cells": cells}, needs)


def patches(survey: Survey) -> Iterator[Task]:
    """Ground cells, with flightlines as they are delivered."""
    return _patches("strip_patches", "", survey)


def _patches(kind: str, folder: str, survey: Survey) -> Iterator[Task]:
    """Ground cells, where there can be more than one flightline."""
    if is_one_flightline(survey):
        return
    moved, first = aligned(survey) if not folder else ({}, ())
    halo = quanta(SQUARE_M)
    holders = survey.holders
    for cell in survey.ground_cells.units(survey.counts, survey.tile_q, halo):
        noise = holders.of(cell.tiles)
        args = {**cell_args(cell), **moved, "noise": named_units("noise", noise), "folder": folder}
        needs = (*tile_needs(cell), *label_needs("denoise", noise), *first)
        refused, how = cell_in_memory("strip_patches", cell, survey)
        yield Task(kind, cell.name, args, needs, 0, refused, how)


def pairs(survey: Survey) -> Iterator[Task]:
    """One task that puts all cells together."""
    cells = sorted(name for name, r in survey.of("strip_patches").items() if r.facts["patches"])
    if cells:
        args = {"strips": _strips(survey), "cells": cells}
        yield Task("strip_pairs", "all", args, tuple(("strip_patches", name) for name in cells))


def differences(survey: Survey) -> Iterator[Task]:
    """Their map, where maps are asked for and there is a pair."""
    made = survey.of("strip_pairs")
    if survey.workflow.products.maps and any(r.facts["pairs"] for r in made.values()):
        name = SWATH_DIFFERENCES.name
        needs = tuple(("strip_pairs", one) for one in made)
        yield Task("deliver_differences", name, {"target": f"{name}.tif"}, needs)


def _has_timeless(survey: Survey) -> bool:
    """Whether some files have no times: which flightlines they hold shows in their points."""
    return any(is_timeless(r, survey.workflow) for r in survey.of("index_file").values())


def _strips(survey: Survey) -> list[list[object]]:
    """Flightlines with times."""
    return [[line.name, line.psid, line.first_s, line.last_s] for line in survey.flown]
