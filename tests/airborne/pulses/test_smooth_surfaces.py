"""Smooth places of single flightlines, against loops and a least-squares solver."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.pulses.level_places import SQUARE_M, places_in
from spl_batch.airborne.pulses.smooth_surfaces import (
    CELLS,
    FEWEST,
    LEVEL,
    STEP_M,
    STEPS,
    TWICE,
    repeatability,
    smooth_sums,
)
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(-12_000, 4_000, 12_000, 28_000)
"""Two by two places lie in it as a whole."""


def sums_of(first, line, core):
    places = places_in(first, line, core)
    if places is None:
        return {name: np.zeros((STEPS, 3), np.int64) for name in CELLS}
    return smooth_sums(places)


def returns(seed: int, n: int = 2600, noise: float = 30.0):
    """Slopes, some of them steep, from two flightlines, and a place that one did not see."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-14_000, 14_000, n), rng.integers(2_000, 30_000, n)
    east, north = rng.normal(0, 0.12, 2)
    z = np.rint(east * x + north * y + rng.normal(0, noise * (1 + (x > 0)), n))
    line = rng.choice([7, 2**40], n)
    seen = (line == 7) | (x < 0)
    return np.column_stack([x, y, z])[seen].astype(np.int64), line[seen]


def by_hand(first, line, core, times):
    """Each place of each flightline by itself: its plane by numpy's solver, its cells by loops."""
    square, edge = round(1000 * SQUARE_M), 2000 * times
    sums = np.zeros((STEPS, 3), np.int64)
    for one in set(line.tolist()):
        mine = first[line == one]
        for i in range(core.xmin // square, core.xmax // square + 1):
            for j in range(core.ymin // square, core.ymax // square + 1):
                low, high = np.array([i, j]) * square, np.array([i + 1, j + 1]) * square
                if (low < core[:2]).any() or (high > core[2:]).any():
                    continue
                held = mine[((mine[:, :2] >= low) & (mine[:, :2] < high)).all(axis=1)]
                fine = [held[((held[:, :2] - low) // 2000 == (p, q)).all(axis=1)]
                        for p in range(4) for q in range(4)]  # fmt: skip
                if min(map(len, fine)) < FEWEST:
                    continue
                design = np.column_stack([held[:, :2] - low, np.ones(len(held))])
                plane, left, *_ = np.linalg.lstsq(design, held[:, 2], rcond=None)
                slope, thickness = np.hypot(*plane[:2]), np.sqrt(left[0] / (len(held) - 3))
                step = int(thickness // (1000 * STEP_M))
                if slope > LEVEL or step >= STEPS:
                    continue
                sums[step, 0] += 1
                for p in range(4 // times):
                    for q in range(4 // times):
                        z = held[((held[:, :2] - low) // edge == (p, q)).all(axis=1), 2]
                        over = z.max() - z.min() - round(slope * edge * np.sqrt(2))
                        sums[step, 1] += 1
                        sums[step, 2] += max(over, 0) ** 2
    return sums


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_each_place_is_what_a_solver_finds(seed: int) -> None:
    first, line = returns(seed)
    found = sums_of(first, line, CORE)
    for level, times in CELLS.items():
        assert np.array_equal(found[level], by_hand(first, line, CORE, times))


def test_places_are_found_at_all() -> None:
    total = sum(sums_of(*returns(seed), CORE)["QL2"][:, 0].sum() for seed in range(20))
    assert total > 20


@given(st.integers(0, 2**32 - 1))
def test_neither_order_nor_place_in_the_survey_matters(seed: int) -> None:
    first, line = returns(seed)
    order = np.random.default_rng(seed).permutation(len(first))
    whole = sums_of(first, line, CORE)["QL1"]
    assert np.array_equal(whole, sums_of(first[order], line[order], CORE)["QL1"])
    # Cells that share an edge on the grid of places add up.
    west = sums_of(first, line, CORE._replace(xmax=0))["QL1"]
    assert np.array_equal(whole, west + sums_of(first, line, CORE._replace(xmin=0))["QL1"])


def test_ranges_of_normal_heights_are_found_as_a_simulation_has_them() -> None:
    rng = np.random.default_rng(5)
    xy = rng.integers(0, 80_000, (80 * 80 * 10, 2))
    z = np.rint(rng.normal(0, 20.0, len(xy)))
    first = np.column_stack([xy, z]).astype(np.int64)
    core = Bounds(0, 0, 80_000, 80_000)
    sums = sums_of(first, np.zeros(len(first), np.int64), core)
    found = repeatability(sums["QL2"])
    assert found is not None
    count = rng.poisson(40, 4000)
    drawn = [np.ptp(rng.normal(0, 0.020, n)) for n in count if n]
    assert found.rmsd_m == pytest.approx(np.sqrt(np.mean(np.square(drawn))), rel=0.03)
    assert (found.places, found.cells) == (100, 1600)
    assert found.noise_m == pytest.approx(0.020, abs=STEP_M)


def test_overgrown_places_do_not_count() -> None:
    sums = np.zeros((STEPS, 3), np.int64)
    sums[4], sums[9], sums[20] = (10, 160, 160 * 50**2), (2, 32, 32 * 50**2), (9, 144, 144 * 900**2)
    found = repeatability(sums)
    assert found is not None
    assert (found.rmsd_m, found.places, found.noise_m) == (0.05, 12, 0.025)
    assert TWICE * found.noise_m == 0.05
    assert repeatability(np.zeros((STEPS, 3), np.int64)) is None


def test_a_pass_for_each_return_needs_no_memory_for_its_squares() -> None:
    """As of times in microseconds, each of which lies in a minute of its own."""
    n = 100_000
    first = np.random.default_rng(1).integers(0, 100_000, (n, 3))
    tracemalloc.start()
    sums = sums_of(first, np.arange(n), Bounds(0, 0, 100_000, 100_000))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert not any(found.any() for found in sums.values())
    assert peak < 300 * n


def test_many_returns_are_looked_at_a_few_columns_of_places_at_a_time() -> None:
    n = 600_000
    first = np.random.default_rng(2).integers(0, (64_000, 64_000, 60), (n, 3))
    line = np.arange(n) % 3
    tracemalloc.start()
    found = sums_of(first, line, Bounds(0, 0, 64_000, 64_000))["QL2"]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found[:, :2].sum(axis=0).tolist() == [3 * 64, 3 * 64 * 16]
    assert peak < 120 * n
