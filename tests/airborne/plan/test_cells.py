"""Cells of the absolute grid, against loops over tiles."""

import itertools
import math
from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan.grid import MARGIN_COST, MOST_TILES, Grid, denoise_grid, tile_counts
from spl_batch.airborne.plan.task_memory import halo_m, task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import Box, from_boxes, from_counts
from spl_batch.lattice.tiles import (
    Bounds,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
    quanta,
    shared,
)

EDGE = 100

COUNTS = st.dictionaries(
    st.builds(CellId, st.integers(-9, 9), st.integers(-9, 9)), st.integers(1, 1000), min_size=1
)


def workflow(**tiling: Any) -> Workflow:
    return Workflow.model_validate(
        {"survey": {"flightlines": "a"}, "output": "o", "tiling": tiling}
    )


def extents(counts: Iterable[CellId], edge: int) -> list[Bounds]:
    return [cell_bounds(cell, edge) for cell in counts]


@settings(max_examples=40, deadline=None)
@given(
    COUNTS, st.sampled_from([70, 100, 300, 250]), st.sampled_from([0, 30, 130]),
    st.sampled_from([0, 60]),
)  # fmt: skip
def test_cells_own_each_tile_and_read_their_margin(
    counts: dict[CellId, int], edge: int, margin: int, buffer: int
) -> None:
    grid = Grid.of_boxes(extents(counts, EDGE), edge, buffer)
    units = list(grid.units(counts, EDGE, margin))
    assert [unit.cell for unit in units] == sorted({unit.cell for unit in units})
    squares = {c for t in counts for c in cells_touching(cell_bounds(t, EDGE), edge)}
    assert squares <= {c for unit in units for c in cells_touching(grid.core(unit.cell), edge)}
    assert not any(overlap(a.core, b.core) for a, b in itertools.combinations(units, 2))
    found = {str(unit.cell): unit for unit in units}
    assert sorted(found) == grid.owners(counts, EDGE)
    for name, unit in found.items():
        i, j = unit.cell
        alone = Bounds(i * edge, j * edge, (i + 1) * edge, (j + 1) * edge)
        assert unit.core == (grid.core(unit.cell) if buffer else alone)
        mine = [t for t in counts if overlap(cell_bounds(t, EDGE), unit.core)]
        assert unit.points == sum(counts[t] for t in mine)
        assert {t for t in counts if name in grid.owners([t], EDGE)} == set(mine)
        reach = grow(unit.core, margin)
        near = {t: shared(cell_bounds(t, EDGE), reach) for t in counts}
        near = {t: part for t, part in near.items() if overlap(cell_bounds(t, EDGE), reach)}
        assert set(unit.tiles) == set(near)
        held = sum(
            counts[t] * (b.xmax - b.xmin) * (b.ymax - b.ymin) / EDGE**2 for t, b in near.items()
        )
        assert held <= unit.held <= held + 1.001


def test_empty_tiles_do_not_count() -> None:
    receipts = {
        name: Receipt("build_tile", name, "", "", "", {}, {"points": n}, n, 0.0, 0.0)
        for name, n in (("0_0", 5), ("-1_2", 0), ("-3_-4", 1))
    }
    assert tile_counts(receipts) == {CellId(-3, -4): 1, CellId(0, 0): 5}


def everywhere(points: int, side: int) -> dict[CellId, int]:
    return dict.fromkeys(
        itertools.starmap(CellId, itertools.product(range(side), repeat=2)), points
    )


def chosen(counts: dict[CellId, int], asked: Workflow, memory: int, workers: int) -> Grid:
    tile_q = quanta(asked.tiling.tile_m)
    pieces, boxes = list(from_counts(counts, tile_q)), extents(counts, tile_q)
    grid, cells, work = denoise_grid(pieces, boxes, asked, memory, workers)
    assert work >= 0.999 * sum(counts.values())
    assert cells == len(list(grid.units(counts, tile_q, 0)))
    return grid


@pytest.mark.parametrize("gib", [1, 2, 4, 16])
def test_cells_fit_into_memory(gib: int) -> None:
    asked = workflow()
    tile_q, margin = quanta(asked.tiling.tile_m), quanta(halo_m(asked))
    counts = everywhere(600_000, 24)
    grid = chosen(counts, asked, gib * 2**30, 1)
    peak = max(unit.held for unit in grid.units(counts, tile_q, margin))
    side = grid.edge // tile_q
    assert side == 1 or task_bytes("denoise", peak) <= usable_bytes(gib * 2**30)
    assert side == {1: 1, 2: 2, 4: 4, 16: MOST_TILES}[gib]


def test_every_worker_has_cells_and_a_given_side_is_taken() -> None:
    counts = everywhere(1000, 8)
    sides = [chosen(counts, workflow(), 2**40, w).edge // 100_000 for w in (0, 1, 2, 4, 16, 99)]
    assert sides == [8, 8, 4, 4, 2, 1]
    assert chosen(counts, workflow(block_tiles=5), 2**30, 99).edge == 500_000


@pytest.mark.parametrize("far_m", [(2e4, 0.0), (0.0, 2e4), (2e4, 3e4)])
def test_small_files_far_apart(far_m: tuple[float, float]) -> None:
    boxes = [
        Bounds(x + 70_000, y + 70_000, x + 80_000, y + 80_000)
        for x, y in ((0, 0), map(quanta, far_m))
    ]
    asked = workflow()
    pieces = list(from_boxes((Box(box, 300.0) for box in boxes), quanta(asked.tiling.tile_m)))
    assert len(pieces) == 2
    found = denoise_grid(pieces, boxes, asked, 2**30, 2)
    assert (found.cells, found.work) == (2, pytest.approx(600.0))


@settings(max_examples=25, deadline=None)
@given(COUNTS, st.integers(1, 9))
def test_the_cells_are_those_that_end_soonest(counts: dict[CellId, int], workers: int) -> None:
    asked = workflow()
    tile_q, margin = quanta(asked.tiling.tile_m), quanta(halo_m(asked))

    def takes(side: int) -> float:
        grid = Grid.of_boxes(extents(counts, tile_q), side * tile_q, margin)
        own, read = ([u.held for u in grid.units(counts, tile_q, m)] for m in (0, margin))
        work = [a + MARGIN_COST * (b - a) for a, b in zip(own, read, strict=True)]
        rounds = math.ceil(len(work) / workers)
        return min(sum(work) / workers + (1 - 1 / workers) * max(work), rounds * max(work))

    grid = chosen(counts, asked, 2**50, workers)
    least = min(takes(side) for side in range(1, MOST_TILES + 1))
    # what a cell holds is a whole number of points
    assert takes(grid.edge // tile_q) <= least + 2 * len(counts) + 2
