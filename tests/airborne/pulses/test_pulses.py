"""First returns, how evenly they lie and which swaths they make, against loops."""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.products.flown_cells import covered_cells
from spl_batch.airborne.pulses.first_returns import MOST_RETURNS, first_returns
from spl_batch.airborne.pulses.swaths import (
    EDGE_Q,
    SPACINGS,
    SQUARE_M2,
    Swaths,
    by_flightline,
    coverage,
    outlines,
)
from spl_batch.airborne.settings import ProductSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds


def returns(rng: np.random.Generator, n: int) -> PointTable:
    return PointTable(
        {
            "x": rng.integers(0, 40, n),
            "y": rng.integers(0, 40, n),
            "z": rng.integers(0, 9, n).astype(np.int32),
            "gps_time": rng.choice([1.5, 2.0, 2.5, np.nan], n),
            "channel": rng.integers(0, 3, n).astype(np.uint8),
            "return_number": rng.integers(1, 4, n).astype(np.uint8),
        }
    )


@given(st.integers(0, 2**32 - 1), st.integers(0, 60))
def test_the_highest_return_of_a_pulse_is_its_first(seed: int, n: int) -> None:
    table = returns(np.random.default_rng(seed), n)
    first = first_returns(table)
    pulses: dict[tuple, list[int]] = {}
    for k, (time, channel) in enumerate(zip(table["gps_time"], table["channel"], strict=True)):
        pulses.setdefault((f"none {k}" if np.isnan(time) else time, channel), []).append(k)
    for (time, _), members in pulses.items():
        chosen = [k for k in members if first[k]]
        if isinstance(time, str) or len(members) > MOST_RETURNS:
            assert chosen == [k for k in members if table["return_number"][k] <= 1]
        else:
            assert [table["z"][k] for k in chosen] == [table["z"][members].max()]


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_rows_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = returns(rng, 50)
    other = table.take(rng.permutation(50))
    names = ("x", "y", "z", "return_number", "channel")
    one, again = (
        sorted(zip(*(some[name][first_returns(some)] for name in names), strict=True))
        for some in (table, other)
    )
    assert one == again


def by_hand(x, y, core, counted, spacing):
    """Loops over absolute squares, each looked at by itself."""
    size = (core.xmax - core.xmin) // counted.shape[1]
    held = set(zip(x // spacing, y // spacing, strict=True))
    pairs = set(zip(x // (2 * spacing), y // (2 * spacing), strict=True))

    def counts(cx: int, cy: int) -> bool:
        if not (core.xmin <= cx < core.xmax and core.ymin <= cy < core.ymax):
            return False
        return bool(counted[(cy - core.ymin) // size, (cx - core.xmin) // size])

    def in_void(i: int, j: int) -> bool:
        return any(
            all((i - a + p, j - b + q) not in held for p in range(4) for q in range(4))
            for a in range(4)
            for b in range(4)
        )

    def indices(edge: int):
        return itertools.product(
            range(core.xmin // edge - 1, core.xmax // edge + 2),
            range(core.ymin // edge - 1, core.ymax // edge + 2),
        )

    places = [(i, j) for i, j in indices(spacing)
              if counts(i * spacing + spacing // 2, j * spacing + spacing // 2)]  # fmt: skip
    squares = [(i, j) for i, j in indices(2 * spacing)
               if counts(2 * i * spacing + spacing, 2 * j * spacing + spacing)]  # fmt: skip
    void = sum(in_void(i, j) for i, j in places)
    return [len(squares), sum(square in pairs for square in squares), len(places), void]


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(SPACINGS)), st.integers(0, 400))
def test_squares_and_voids_equal_loops(seed: int, level: str, n: int) -> None:
    rng = np.random.default_rng(seed)
    west, south = rng.integers(-30, 30, 2) * 1000
    core = Bounds(int(west), int(south), int(west) + 12_000, int(south) + 9_000)
    x = rng.integers(core.xmin - 15_000, core.xmax + 15_000, n)
    y = rng.integers(core.ymin - 15_000, core.ymax + 15_000, n)
    counted = rng.random((9, 12)) < 0.8
    found = coverage(x, y, counted, core, SPACINGS[level])
    assert list(found) == by_hand(x, y, core, counted, SPACINGS[level])


@pytest.mark.parametrize("gap_m", [30, 60])
def test_a_wide_hole_is_not_covered(gap_m: int) -> None:
    core = Bounds(0, 0, 200_000, 200_000)
    side = np.arange(-150_000, 350_000, 500)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    kept = np.maximum(abs(x - 100_000), abs(y - 100_000)) > gap_m * 500
    covered = covered_cells(x[kept], y[kept], core, ProductSettings())
    assert covered.all() == (gap_m < 40)
    assert covered[100, 100] == (gap_m < 40)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(0, 400))
def test_swaths_of_regions_side_by_side_equal_loops(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-20_000, 60_000, (2, n))
    line = rng.integers(1, 3, n)
    size, cores = 1000, [Bounds(0, 0, 21_000, 30_000), Bounds(21_000, 0, 40_000, 30_000)]
    dry = rng.random((30, 40)) < 0.9
    found = [
        Swaths(x, y, line, core).facts(dry[:, core.xmin // size : core.xmax // size])
        for core in cores
    ]
    totals = by_flightline(found, {1: "a", 2: "b"}, "QL3")
    for number, name in ((1, "a"), (2, "b")):
        mine = list(zip((x // EDGE_Q)[line == number], (y // EDGE_Q)[line == number], strict=True))
        held = set(mine)
        middle = {s for s in held if all((s[0] + i, s[1] + j) in held for i in (-1, 0, 1)
                                         for j in (-1, 0, 1))}  # fmt: skip
        area, inner = (
            {(i, j) for i, j in some if 0 <= i < 8 and 0 <= j < 6 and dry[5 * j + 2, 5 * i + 2]}
            for some in (held, middle)
        )
        if not area:
            assert name not in totals
            continue
        one = totals[name]
        assert (one.area_m2, one.pulses) == (
            len(area) * SQUARE_M2, sum(square in area for square in mine)
        )  # fmt: skip
        inner_or_all = inner or area
        assert one.middle_m2 == len(inner_or_all) * SQUARE_M2
        assert one.middle_pulses == sum(square in inner_or_all for square in mine)
        fine = set(zip((x // 2820)[line == number], (y // 2820)[line == number], strict=True))
        centres = [
            (i, j)
            for i, j in itertools.product(range(15), range(11))
            if ((i * 2820 + 1410) // EDGE_Q, (j * 2820 + 1410) // EDGE_Q) in inner
        ]
        assert abs(one.squares - len(centres)) <= 3, "a square may be cut by a region's rim"
        assert one.filled <= one.squares
        if one.squares == len(centres):
            assert one.filled == sum(square in fine for square in centres)


def test_places_overlap_where_two_flightlines_share_a_square() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.integers(-8_000, 28_000, (2, 60))
    line = rng.integers(0, 3, 60)
    core = Bounds(0, 0, 20_000, 20_000)
    px, py = rng.integers(0, 20_000, (2, 200))
    seen: dict[tuple[int, int], set[int]] = {}
    for east, north, one in zip(x.tolist(), y.tolist(), line.tolist(), strict=True):
        seen.setdefault((east // EDGE_Q, north // EDGE_Q), set()).add(one)
    places = zip((px // EDGE_Q).tolist(), (py // EDGE_Q).tolist(), strict=True)
    wanted = [len(seen.get(place, ())) > 1 for place in places]
    assert Swaths(x, y, line, core).overlapping(px, py).tolist() == wanted
    assert any(wanted)


def test_outlines_of_cells_side_by_side_are_one() -> None:
    # A swath of 60 m that crosses two cells at an angle, and another one that nobody flew.
    rng = np.random.default_rng(3)
    along, across = rng.uniform(0, 380, 60_000), rng.uniform(-30, 30, 60_000)
    x = np.rint((along * 0.8 - across * 0.6 + 40) * 1000).astype(np.int64)
    y = np.rint((along * 0.6 + across * 0.8 + 60) * 1000).astype(np.int64)
    number = np.full(len(x), 7)
    cores = (Bounds(0, 0, 200_000, 400_000), Bounds(200_000, 0, 400_000, 400_000))
    found = [Swaths(x, y, number, core).outlines() for core in cores]
    (shape,) = outlines(found, {7: "a", 8: "b"}).values()
    true = shapely.Polygon([(58, 36), (362, 264), (326, 312), (22, 84)])
    assert len(shape.geoms) == 1
    assert shapely.covers(shapely.buffer(shape, 6), true)
    assert shapely.covers(shapely.buffer(true, 9), shape)
    assert len(shapely.get_coordinates(shape)) < 80, "most steps of squares become lines"
    assert outlines([], {7: "a"}) == {}
