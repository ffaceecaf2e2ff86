"""How wide cells of ``denoise`` are: k x k tiles, one k for the survey; which stretches reach one.

Labels and rasters are the same whatever k is.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from spl_batch.airborne.plan.halo import halo_m
from spl_batch.airborne.plan.task_memory import task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import Piece, largest
from spl_batch.lattice.tiles import (
    Bounds,
    BoxIndex,
    CellId,
    parse_cell,
    quanta,
)

MOST_TILES: Final = 8
"""Tiles along one side of a cell of ``denoise``, at most [count]: wider ones read hardly less."""

MARGIN_COST: Final = 0.4
"""Time that a point of a margin takes, over that of one that a cell owns: what the quickstart's
cells took."""


def tiles_along(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, workers: int
) -> int:
    """Tiles along one side of the cells of ``denoise``.

    Those that fit with their margin into a worker, even where the survey is densest, and of these
    the ones with which the workers finish soonest: wide cells read little twice, many of them
    share the work evenly. ``pieces``: where the points lie; ``memory_bytes``: limit of a worker.
    """
    if workflow.tiling.block_tiles is not None:
        return workflow.tiling.block_tiles
    tile_m, margin_m = workflow.tiling.tile_m, halo_m(workflow)
    best, least = 1, math.inf
    for side in range(1, MOST_TILES + 1):
        edge_m = side * tile_m
        peak = largest(piece.peak(quanta(edge_m), quanta(margin_m)) for piece in pieces)
        if side > 1 and task_bytes("denoise", peak.points) > usable_bytes(memory_bytes):
            break
        cells = sum(piece.units(quanta(edge_m)) for piece in pieces)
        rounds = -(-cells // max(workers, 1))
        cost = edge_m**2 + MARGIN_COST * ((edge_m + 2.0 * margin_m) ** 2 - edge_m**2)
        if rounds * cost < least:
            best, least = side, rounds * cost
    return best


def tile_counts(tiles: Mapping[str, Receipt]) -> dict[CellId, int]:
    """Points of each tile that holds some, from the receipts of the built tiles."""
    counts = {parse_cell(name): int(r.facts["points"]) for name, r in tiles.items()}
    return {tile: n for tile, n in sorted(counts.items()) if n}


def index_of_boxes(boxes: Mapping[str, Sequence[int]], unit_q: int) -> BoxIndex:
    """Stretches by place; ``boxes``: xmin, ymin, xmax, ymax of each, in units [quanta]."""
    return BoxIndex({name: Bounds(*(unit_q * end for end in box)) for name, box in boxes.items()})
