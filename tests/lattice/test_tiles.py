"""Ownership and index arithmetic: every point has exactly one owner, wherever it lies."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.lattice.tiles import (
    Bounds,
    CellId,
    cell_bounds,
    cell_index,
    cells_touching,
    grow,
    inside,
    overlap,
    whole_cells,
)

SIZES = st.integers(1, 200_000)
COORDINATES = st.integers(-(10**10), 10**10)


@st.composite
def near_edges(draw: st.DrawFn) -> tuple[int, int]:
    """A cell size, and a coordinate that mostly lies on an edge or beside one."""
    size = draw(SIZES)
    edge = draw(st.integers(-1000, 1000)) * size
    return size, edge + draw(st.sampled_from([-1, 0, 1, size - 1, draw(st.integers(0, 10**6))]))


@st.composite
def regions(draw: st.DrawFn) -> Bounds:
    x, y = draw(COORDINATES), draw(COORDINATES)
    return Bounds(x, y, x + draw(st.integers(0, 5000)), y + draw(st.integers(0, 5000)))


@given(near_edges(), COORDINATES)
def test_a_point_has_exactly_one_owner(across: tuple[int, int], y: int) -> None:
    size, x = across
    i, j = (int(cell_index(np.array([v], np.int64), size)[0]) for v in (x, y))
    xs, ys = np.array([x], np.int64), np.array([y], np.int64)
    around = [CellId(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    owned_by = [cell for cell in around if inside(xs, ys, cell_bounds(cell, size))[0]]
    assert owned_by == [CellId(i, j)]
    assert list(cells_touching(Bounds(x, y, x + 1, y + 1), size)) == [CellId(i, j)]


@given(regions(), st.integers(500, 4000))
def test_cells_touching_covers_and_no_more(region: Bounds, size: int) -> None:
    cells = list(cells_touching(region, size))
    assert len(set(cells)) == len(cells)
    assert all(overlap(cell_bounds(c, size), region) for c in cells)
    # The cells are a full rectangle that holds the region and whose rim it reaches.
    if region.xmin < region.xmax and region.ymin < region.ymax:
        hull = [cell_bounds(c, size) for c in (cells[0], cells[-1])]
        assert hull[0].xmin <= region.xmin < hull[0].xmax
        assert hull[1].xmin < region.xmax <= hull[1].xmax
        assert hull[0].ymin <= region.ymin < hull[0].ymax
        assert hull[1].ymin < region.ymax <= hull[1].ymax
        columns = cells[-1].i - cells[0].i + 1
        assert len(cells) == columns * (cells[-1].j - cells[0].j + 1)
    else:
        assert cells == []


@given(regions(), st.integers(500, 4000))
def test_whole_cells_are_those_that_a_region_touches(region: Bounds, size: int) -> None:
    wide = grow(region, 1)
    whole = whole_cells(wide, size)
    assert all(side % size == 0 for side in whole)
    assert list(cells_touching(whole, size)) == list(cells_touching(wide, size))


@given(regions(), regions())
def test_overlap_means_shared_area(a: Bounds, b: Bounds) -> None:
    width = min(a.xmax, b.xmax) - max(a.xmin, b.xmin)
    height = min(a.ymax, b.ymax) - max(a.ymin, b.ymin)
    empty = a.area_m2 == 0 or b.area_m2 == 0
    assert overlap(a, b) == overlap(b, a)
    if not empty:
        assert overlap(a, b) == (width > 0 and height > 0)


@given(regions(), st.integers(0, 10**6))
def test_a_halo_reaches_as_far_as_stated(region: Bounds, halo: int) -> None:
    wide = grow(region, halo)
    corner = np.array([region.xmin - halo]), np.array([region.ymin - halo])
    assert inside(*corner, wide)[0] == (wide.area_m2 > 0)
    outside = np.array([region.xmax + halo]), np.array([region.ymin])
    assert not inside(*outside, wide)[0]
    assert grow(grow(region, halo), 7) == grow(region, halo + 7)
