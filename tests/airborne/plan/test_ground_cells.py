"""Ground cells: squares of the absolute grid, with the strips at a survey's edge."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan.grid import Grid, strip_q
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.store.raster_cells import create_raster_store, read_window, write_cell
from spl_batch.airborne.tasks.surfaces import _write_rasters
from spl_batch.constants import NODATA
from spl_batch.engine.store.working_store import Store, read_receipt, write_receipt
from spl_batch.engine.tasks.task import Receipt
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
    owned = [square for cell in keepers for square in cells.squares(cell)]
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
    store = tmp_path / "rasters.zarr"
    create_raster_store(store, ["dtm"], ground_cell=4000, raster_cell=1000)
    values = np.arange(8 * 12, dtype=np.float32).reshape(8, 12)
    values[:4, 8:] = NODATA
    written = write_cell(store, CellId(-2, 5), {"dtm": values})
    assert len(written) == 6, "a square that holds nothing is told from one that is gone"
    bounds = Bounds(-8000, 20_000, 4000, 28_000)
    np.testing.assert_array_equal(read_window(store, "dtm", bounds), values)
    write_cell(store, CellId(-1, 5), {"dtm": np.full((4, 4), NODATA, np.float32)})
    values[4:, 4:8] = NODATA
    np.testing.assert_array_equal(read_window(store, "dtm", bounds), values)


@pytest.mark.parametrize(
    ("before", "name", "now", "left"),
    [
        # the survey lost a strip: the cell beside it takes over what was a cell by itself
        ({"0_0": (0, 1), "1_0": (1, 2), "2_0": (2, 3)}, "1_0", (0, 2), ["1_0", "2_0"]),
        # it grew: what belonged to the cell beside it is a cell by itself
        ({"1_0": (0, 2), "2_0": (2, 3)}, "0_0", (0, 1), ["2_0"]),
        # as it was
        ({"0_0": (0, 1), "1_0": (1, 2), "2_0": (2, 3)}, "1_0", (1, 2), ["0_0", "1_0", "2_0"]),
    ],
)
def test_a_receipt_does_not_speak_for_chunks_that_another_cell_writes_over(
    tmp_path: Path,
    before: dict[str, tuple[int, int]],
    name: str,
    now: tuple[int, int],
    left: list[str],
) -> None:
    survey = {"name": "s", "flightlines": "*.laz", "trajectory": "t.txt"}
    workflow = parse_workflow({"survey": survey, "output": "o"}, "w")
    edge, pixel = quanta(workflow.ground.cell_m), quanta(workflow.products.cell_m)
    store = Store(tmp_path)
    context: Any = SimpleNamespace(
        workflow=workflow, store=store, rasters=store.path("rasters.zarr")
    )
    create_raster_store(context.rasters, ["dtm"], ground_cell=edge, raster_cell=pixel)
    for cell, (west, east) in before.items():
        facts = {"core": [west * edge, 0, east * edge, edge]}
        write_receipt(store, Receipt("surface", cell, "k", "d", "", {}, facts, 1, 0.0, 0.0))
    write_receipt(store, Receipt("surface", "1_1", "k", "", "failed", {}, {}, 0, 0.0, 0.0))
    side, wide = edge // pixel, now[1] - now[0]
    arrays = {"dtm": np.ones((side, wide * side), np.float32)}
    core = Bounds(now[0] * edge, 0, now[1] * edge, edge)
    paths = _write_rasters(name, core, arrays, context)
    assert [path.is_file() for path in paths] == [True] * wide
    names = ["0_0", "1_0", "2_0", "1_1"]
    assert [n for n in names if read_receipt(store, "surface", n)] == [*left, "1_1"]


def test_strips_are_not_joined_where_squares_hold_many_raster_cells() -> None:
    survey = {"name": "s", "flightlines": "*.laz", "trajectory": "t.txt"}

    def width(pixel_m: float) -> int:
        products = {"cell_m": pixel_m}
        return strip_q(parse_workflow({"survey": survey, "output": "o", "products": products}, "w"))

    assert (width(1.0), width(0.4), width(0.25)) == (60_000, 60_000, 0)
