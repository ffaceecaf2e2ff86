"""Smooth places of single flightlines, against loops and a least-squares solver."""

import numpy as np
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


def test_overgrown_places_do_not_count() -> None:
    sums = np.zeros((STEPS, 3), np.int64)
    sums[4], sums[9], sums[20] = (10, 160, 160 * 50**2), (2, 32, 32 * 50**2), (9, 144, 144 * 900**2)
    found = repeatability(sums)
    assert found is not None
    assert (found.rmsd_m, found.places, found.noise_m) == (0.05, 12, 0.025)
    assert TWICE * found.noise_m == 0.05
    assert repeatability(np.zeros((STEPS, 3), np.int64)) is None
