"""Cells of the absolute grid, against loops over tiles."""

import itertools
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan.grid import MOST_TILES, Grid, tile_counts, tiles_along
from spl_batch.airborne.plan.task_memory import halo_m, task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import from_counts
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, grow, overlap, quanta, shared

EDGE = 100

COUNTS = st.dictionaries(
    st.builds(CellId, st.integers(-9, 9), st.integers(-9, 9)), st.integers(1, 1000), min_size=1
)


def workflow(**tiling: Any) -> Workflow:
    return Workflow.model_validate(
        {"survey": {"flightlines": "a"}, "output": "o", "tiling": tiling}
    )


@settings(max_examples=40, deadline=None)
@given(COUNTS, st.sampled_from([100, 300, 250]), st.sampled_from([0, 30, 130]))
def test_cells_own_each_tile_and_read_their_margin(
    counts: dict[CellId, int], edge: int, margin: int
) -> None:
    found = {unit.name: unit for unit in Grid.plain(edge).units(counts, EDGE, margin)}
    assert sorted(found) == Grid.plain(edge).owners(counts, EDGE)
    for name, unit in found.items():
        i, j = unit.cell
        assert unit.core == Bounds(i * edge, j * edge, (i + 1) * edge, (j + 1) * edge)
        mine = [t for t in counts if overlap(cell_bounds(t, EDGE), unit.core)]
        assert unit.points == sum(counts[t] for t in mine)
        assert {t for t in counts if name in Grid.plain(edge).owners([t], EDGE)} == set(mine)
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


@pytest.mark.parametrize("gib", [1, 2, 4, 16])
def test_cells_fit_into_memory(gib: int) -> None:
    asked = workflow()
    tile_q = quanta(asked.tiling.tile_m)
    pieces = list(from_counts(everywhere(600_000, 24), tile_q))
    side = tiles_along(pieces, asked, gib * 2**30, 1)
    peak = max(piece.peak(side * tile_q, quanta(halo_m(asked))).points for piece in pieces)
    assert side == 1 or task_bytes("denoise", peak) <= usable_bytes(gib * 2**30)
    assert side == {1: 1, 2: 2, 4: 4, 16: MOST_TILES}[gib]


def test_every_worker_has_cells_and_a_given_side_is_taken() -> None:
    pieces = list(from_counts(everywhere(1000, 8), 100_000))
    sides = [tiles_along(pieces, workflow(), 2**40, workers) for workers in (0, 1, 2, 4, 16, 99)]
    assert sides == [8, 8, 4, 4, 2, 1]
    assert tiles_along(pieces, workflow(block_tiles=5), 2**30, 99) == 5
