"""Ground cells: squares of the absolute grid, with the strips at a survey's edge."""

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan.grid import Grid, strip_q
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.store.raster_cells import stored_blocks, write_cell
from spl_batch.constants import NODATA
from spl_batch.engine.store.working_store import Store
from spl_batch.lattice.tiles import (
    Bounds,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
    shared,
)

EDGE, BUFFER = 200, 60

sides = st.tuples(st.integers(-900, 900), st.integers(1, 1000))
boxes = st.lists(
    st.tuples(sides, sides).map(lambda s: Bounds(s[0][0], s[1][0], sum(s[0]), sum(s[1]))),
    min_size=1,
    max_size=4,
)


def hull(listed: list[Bounds]) -> Bounds:
    west, south, east, north = zip(*listed, strict=True)
    return Bounds(min(west), min(south), max(east), max(north))


@given(boxes, st.sampled_from([0, 60, 199, 500]))
@settings(max_examples=200, deadline=None)
def test_every_square_of_a_survey_belongs_to_one_cell(listed: list[Bounds], buffer: int) -> None:
    cells = Grid.of_boxes(listed, EDGE, buffer)
    squares = list(cells_touching(hull(listed), EDGE))
    keepers = {cells.keeper(square) for square in squares}
    owned = [square for cell in keepers for square in cells_touching(cells.core(cell), EDGE)]
    assert sorted(owned) == sorted(squares)
    for square in squares:
        keeper = cells.keeper(square)
        assert overlap(cell_bounds(square, EDGE), cells.core(keeper))
        assert cells.keeper(keeper) == keeper


@given(boxes)
@settings(max_examples=200, deadline=None)
def test_a_cell_reads_no_more_for_the_strip_that_it_owns(listed: list[Bounds]) -> None:
    cells, survey = Grid.of_boxes(listed, EDGE, BUFFER), hull(listed)
    for cell in {cells.keeper(square) for square in cells_touching(survey, EDGE)}:
        core = cells.core(cell)
        alone = grow(cell_bounds(cell, EDGE), BUFFER)
        assert shared(grow(core, BUFFER), survey) == shared(alone, survey)


def test_strips_up_to_the_buffer_belong_to_the_next_cell() -> None:
    cells = Grid.of_boxes([(140, 139, 660, 661)], EDGE, BUFFER)
    assert cells.core(CellId(1, 1)) == Bounds(0, 200, 400, 400)  # 60 m enter in the west
    assert cells.core(CellId(1, 0)) == Bounds(0, 0, 400, 200)  # 61 m in the south stay a cell
    assert cells.core(CellId(2, 3)) == Bounds(400, 600, 800, 800)
    assert cells.keeper(CellId(0, 0)) == CellId(1, 0)


def test_rasters_of_several_squares_come_back_in_their_places(tmp_path: Path) -> None:
    store, core = Store(tmp_path), Bounds(-8000, 20_000, 4000, 28_000)
    values = np.arange(8 * 12, dtype=np.float32).reshape(8, 12)
    values[:4, 8:] = NODATA
    (path,) = write_cell(store, "-2_5", core, {"dtm": values})
    assert path.is_file()
    ((row, col, block),) = stored_blocks(store, "dtm", ["-2_5"], core)
    assert (row, col) == (0, 0)
    np.testing.assert_array_equal(block, values)
    # Where the survey was another, a cell beside it owns some of its squares: neither harms either.
    write_cell(store, "-1_5", Bounds(-4000, 20_000, 0, 24_000), {"dtm": np.zeros((4, 4))})
    ((*_, again),) = stored_blocks(store, "dtm", ["-2_5"], core)
    np.testing.assert_array_equal(again, values)


def test_strips_are_not_joined_where_squares_hold_many_raster_cells() -> None:
    survey = {"name": "s", "flightlines": "*.laz", "trajectory": "t.txt"}

    def width(pixel_m: float) -> int:
        products = {"cell_m": pixel_m}
        return strip_q(parse_workflow({"survey": survey, "output": "o", "products": products}, "w"))

    assert (width(1.0), width(0.4), width(0.25)) == (60_000, 60_000, 0)
