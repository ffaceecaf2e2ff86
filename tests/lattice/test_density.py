"""Where points lie by headers and by tiles, beside sums made one by one."""

from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan.grid import Grid
from spl_batch.lattice import density
from spl_batch.lattice.density import Box, Peak, from_boxes, from_counts, largest
from spl_batch.lattice.tiles import (
    Bounds,
    BoxIndex,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
)

EDGE = 100


@st.composite
def bounds(draw: st.DrawFn, within: int = 900) -> Bounds:
    """Return a rectangle that is not empty."""
    x, y = (draw(st.integers(-within, within)) for _ in "xy")
    return Bounds(x, y, x + draw(st.integers(1, 500)), y + draw(st.integers(1, 500)))


boxes = st.lists(st.builds(Box, bounds(), st.integers(1, 10**6)), min_size=1, max_size=6)


def shared(a: Bounds, b: Bounds) -> float:
    width = min(a.xmax, b.xmax) - max(a.xmin, b.xmin)
    height = min(a.ymax, b.ymax) - max(a.ymin, b.ymin)
    return max(width, 0) * max(height, 0)


def area(a: Bounds) -> int:
    return (a.xmax - a.xmin) * (a.ymax - a.ymin)


def tiles_of(listed: list[Box]) -> dict[CellId, float]:
    """Points of each tile that a box touches, tile by tile."""
    held: dict[CellId, float] = {}
    for box in listed:
        for tile in cells_touching(box.bounds, EDGE):
            part = shared(box.bounds, cell_bounds(tile, EDGE)) / area(box.bounds)
            held[tile] = held.get(tile, 0.0) + part * box.points
    return held


def peaks(tiles: dict[CellId, float], unit: int, halo: int) -> Iterator[Peak]:
    """What each unit reads where every tile's points spread evenly over it."""
    owning = {c for t in tiles for c in cells_touching(cell_bounds(t, EDGE), unit)}
    for cell in owning:
        wide = grow(cell_bounds(cell, unit), halo)
        read = sum(n * shared(cell_bounds(t, EDGE), wide) / EDGE**2 for t, n in tiles.items())
        yield Peak(read, cell_bounds(cell, unit))


@settings(max_examples=60, deadline=None)
@given(boxes, st.sampled_from([100, 200, 70, 250]), st.sampled_from([0, 30, 130]))
def test_headers_give_the_fullest_unit(listed: list[Box], unit: int, halo: int) -> None:
    pieces = list(from_boxes(listed, EDGE))
    tiles = tiles_of(listed)
    total = sum(box.points for box in listed)
    assert sum(float(p.points.sum()) for p in pieces) == pytest.approx(total)
    assert sum(p.units(EDGE) for p in pieces) == len(tiles)
    if unit >= EDGE:
        expected = list(peaks(tiles, unit, halo))
        assert sum(p.units(unit) for p in pieces) == len(expected)
        found = largest(p.peak(unit, halo) for p in pieces)
        assert found.points == pytest.approx(largest(expected).points, abs=1e-6 * total)
        at_core = next(p for p in expected if p.core == found.core)
        assert at_core.points == pytest.approx(found.points, abs=1e-6 * total)


counts = st.dictionaries(
    st.builds(CellId, st.integers(-8, 8), st.integers(-8, 8)), st.integers(1, 10**6), min_size=1
)


@settings(max_examples=60, deadline=None)
@given(counts, st.sampled_from([100, 300, 250]), st.sampled_from([0, 30, 130]))
def test_tiles_give_the_fullest_unit(held: dict[CellId, int], unit: int, halo: int) -> None:
    pieces = list(from_counts(held, EDGE))
    grid = Grid.of_boxes([cell_bounds(tile, EDGE) for tile in held], unit, 0)
    listed = list(grid.units(held, EDGE, halo))
    assert sum(p.units(unit) for p in pieces) == len(listed)
    share = largest(p.peak(unit, halo) for p in pieces)
    assert share.points == pytest.approx(max(u.held for u in listed), abs=1.0 + 1e-9 * share.points)


def test_pieces_far_apart_are_counted_apart() -> None:
    near, far = Bounds(0, 0, 250, 250), Bounds(10**9, -(10**9), 10**9 + 250, 250 - 10**9)
    found = list(from_boxes([Box(near, 10), Box(far, 30), Box(near, 7)], EDGE))
    assert sorted(float(p.points.sum()) for p in found) == pytest.approx([17, 30])
    assert max(p.points.size for p in found) <= 16
    cells = {CellId(0, 0): 3, CellId(1, 1): 4, CellId(10**7, -(10**7)): 5}
    assert sorted(float(p.points.sum()) for p in from_counts(cells, EDGE)) == [5, 7]


def test_a_header_that_spans_the_world_takes_coarse_squares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(density, "MAX_CELLS", 100)
    wide = [Box(Bounds(0, 0, 40 * EDGE, 40 * EDGE), 1600), Box(Bounds(0, 0, 400, 400), 800)]
    (piece,) = from_boxes(wide, EDGE)
    assert piece.edge == 4 * EDGE
    assert piece.units(EDGE) == 1600
    assert piece.peak(EDGE, 0) == (pytest.approx(51), Bounds(0, 0, 100, 100))
    assert piece.peak(8 * EDGE, 0).points == pytest.approx(864)


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.text("ab", max_size=4), bounds(), max_size=12), bounds(2000))
def test_an_index_finds_what_a_scan_finds(named: dict[str, Bounds], region: Bounds) -> None:
    named["empty"] = Bounds(0, 0, 0, 5)
    named["large"] = Bounds(-(10**6), -5, 10**6, 5)
    index = BoxIndex(named)
    for near in (region, grow(region, 5000)):
        expected = [n for n in sorted(named) if n != "empty" and overlap(named[n], near)]
        assert index.overlapping(near) == expected
    assert BoxIndex({"one": Bounds(0, 0, 10, 10)}).overlapping(Bounds(9, 9, 20, 20)) == ["one"]
    for beside in (Bounds(10, 0, 20, 10), Bounds(0, -5, 10, 0), Bounds(5, 5, 5, 9)):
        assert BoxIndex({"one": Bounds(0, 0, 10, 10)}).overlapping(beside) == []
