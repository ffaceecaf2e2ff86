"""Tasks that compare flightlines with each other: by ground cell, then all together."""

from collections.abc import Iterator
from dataclasses import replace

from spl_batch.airborne.lines.patches import SQUARE_M
from spl_batch.airborne.plan.flightlines import is_timeless
from spl_batch.airborne.plan.space_tasks import aligned, cell_task, labels_of
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.engine.tasks.task import Task
from spl_batch.lattice.tiles import quanta


def is_one_flightline(survey: Survey) -> bool:
    """Whether there is nothing to compare; known once the index is complete.

    Which flightlines files without times hold shows in their points alone.
    """
    indexed = survey.of("index_file").values()
    return len(survey.flown) < 2 and not any(is_timeless(r, survey.workflow) for r in indexed)


def recorded_patches(survey: Survey) -> Iterator[Task]:
    """Ground cells whose flightlines are to be aligned, before the ground is looked for."""
    if survey.workflow.survey.align != "none":
        yield from _patches("recorded_patches", survey)


def align(survey: Survey) -> Iterator[Task]:
    """One task that finds the shifts of all flightlines."""
    if len(survey.of("recorded_patches")):
        yield _together("align", "recorded_patches", survey)


def patches(survey: Survey) -> Iterator[Task]:
    """Ground cells whose flightlines stay as they are."""
    if survey.workflow.survey.align == "none":
        yield from _patches("strip_patches", survey)


def pairs(survey: Survey) -> Iterator[Task]:
    """One task that puts all cells together, with the shifts where there are any."""
    first = aligned(survey)
    task = _together("strip_pairs", "recorded_patches" if first else "strip_patches", survey)
    if task.args["cells"]:
        yield replace(task, needs=(*task.needs, *first))


def _patches(kind: str, survey: Survey) -> Iterator[Task]:
    """Ground cells, where there can be more than one flightline."""
    if is_one_flightline(survey):
        return
    for cell in survey.ground_cells(quanta(SQUARE_M)):
        needs = labels_of(survey, cell.tiles, "denoise")
        task = cell_task(kind, cell, survey, {"lines": _lines(survey)}, needs)
        yield replace(task, points=0)


def _together(kind: str, of: str, survey: Survey) -> Task:
    """One task on all cells with patches."""
    cells = sorted(name for name, r in survey.of(of).items() if r.facts["patches"])
    args = {"lines": _lines(survey), "cells": cells}
    return Task(kind, "all", args, tuple((of, name) for name in cells))


def _lines(survey: Survey) -> list[list[object]]:
    """Flightlines with times."""
    return [[*line.as_pass] for line in survey.flown]
