"""First returns and how evenly they lie, against loops over pulses and squares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.products.footprint import Covered
from spl_batch.airborne.pulses.pulse_coverage import SPACINGS, Coverage, EmptySquares
from spl_batch.airborne.pulses.pulse_returns import (
    MOST_RETURNS,
    pulse_ends,
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
    first, last = pulse_ends(table)
    rows = [tuple(table[c][k] for c in ("gps_time", "channel", "z")) for k in range(n)]
    pulses: dict[tuple, list[int]] = {}
    for k, (time, channel, _) in enumerate(rows):
        pulses.setdefault((f"none {k}" if np.isnan(time) else time, channel), []).append(k)
    for (time, _), members in pulses.items():
        known = not isinstance(time, str) and len(members) <= MOST_RETURNS
        only = [k for k in members if table["return_number"][k] <= 1]
        assert first[members].sum() == last[members].sum() == (1 if known else len(only))
        if known:
            z = table["z"][members]
            assert table["z"][first][np.isin(np.flatnonzero(first), members)] == z.max()
            assert table["z"][last][np.isin(np.flatnonzero(last), members)] == z.min()
        else:
            assert set(np.flatnonzero(first)) & set(members) == set(only)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_rows_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = returns(rng, 50)
    order = rng.permutation(50)
    names = ("x", "y", "z", "return_number", "channel")
    for one, other in zip(pulse_ends(table), pulse_ends(table.take(order)), strict=True):
        there = [sorted(zip(*(t[c][m] for c in names), strict=True))
                 for t, m in ((table, one), (table.take(order), other))]  # fmt: skip
        assert there[0] == there[1]


def by_hand(x, y, core, flown, spacing):
    """Loops over absolute squares, each looked at by itself."""
    size = (core.xmax - core.xmin) // flown.shape[1]
    held = set(zip(x // spacing, y // spacing, strict=True))

    def is_flown(cx: float, cy: float) -> bool:
        if not (core.xmin <= cx < core.xmax and core.ymin <= cy < core.ymax):
            return False
        return bool(flown[int(cy - core.ymin) // size, int(cx - core.xmin) // size])

    def in_void(i: int, j: int) -> bool:
        return any(
            all((i - a + p, j - b + q) not in held for p in range(4) for q in range(4))
            for a in range(4)
            for b in range(4)
        )

    found = [0, 0, 0, 0]
    for i in range(core.xmin // spacing - 2, core.xmax // spacing + 3):
        for j in range(core.ymin // spacing - 2, core.ymax // spacing + 3):
            if is_flown((i + 0.5) * spacing, (j + 0.5) * spacing):
                found[2] += 1
                found[3] += in_void(i, j)
            if i % 2 == j % 2 == 0 and is_flown((i + 1) * spacing, (j + 1) * spacing):
                found[0] += 1
                found[1] += any((i + p, j + q) in held for p in (0, 1) for q in (0, 1))
    return found


def coverage(x, y, core, flown, spacing) -> tuple[Coverage, np.ndarray]:
    """What is found in two parts, one of every second return."""
    empty = EmptySquares(core)
    for start in (0, 1):
        empty.add(x[start::2], y[start::2])
    return empty.coverage(flown, spacing)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(SPACINGS)), st.integers(0, 400))
def test_squares_and_voids_equal_loops(seed: int, level: str, n: int) -> None:
    rng = np.random.default_rng(seed)
    west, south = rng.integers(-30, 30, 2) * 1000
    core = Bounds(int(west), int(south), int(west) + 12_000, int(south) + 9_000)
    x = rng.integers(core.xmin - 15_000, core.xmax + 15_000, n)
    y = rng.integers(core.ymin - 15_000, core.ymax + 15_000, n)
    flown = rng.random((9, 12)) < 0.8
    found, cells = coverage(x, y, core, flown, SPACINGS[level])
    assert list(found) == by_hand(x, y, core, flown, SPACINGS[level])
    assert not (cells & ~flown).any()


def test_regions_side_by_side_count_as_one() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.integers(-20_000, 40_000, (2, 900))
    whole = Bounds(0, 0, 20_000, 10_000)
    flown = np.ones((10, 20), np.bool_)
    halves = [Bounds(0, 0, 11_000, 10_000), Bounds(11_000, 0, 20_000, 10_000)]
    parts = [
        coverage(x, y, half, flown[:, : (half.xmax - half.xmin) // 1000], 710)[0] for half in halves
    ]
    assert list(coverage(x, y, whole, flown, 710)[0]) == [sum(v) for v in zip(*parts, strict=True)]


@pytest.mark.parametrize("gap_m", [30, 60])
def test_a_wide_hole_lies_beyond_the_signal(gap_m: int) -> None:
    core, products = Bounds(0, 0, 200_000, 200_000), ProductSettings()
    side = np.arange(-150_000, 350_000, 500)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    kept = np.maximum(abs(x - 100_000), abs(y - 100_000)) > gap_m * 500
    covered = Covered(core, products)
    for start in (0, 1):
        covered.add(x[kept][start::2], y[kept][start::2])
    inside = covered.squares()
    assert inside.all() == (gap_m < 40)
    assert inside[400, 400] == (gap_m < 40)
