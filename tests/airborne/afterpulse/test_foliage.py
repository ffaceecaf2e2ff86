"""Density of returns among leaves: the formula against loops, and evenly spread or clumped."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import foliage
from spl_batch.airborne.afterpulse.weighted_counts import UNIT, weigh_around
from spl_batch.lattice.lattice_columns import columns

KERNELS = len(foliage.KERNELS_M)
VOLUME_M3 = [8 / 35 * 4 / 3 * math.pi * across**2 * up for across, up in foliage.KERNELS_M]


def counts_around(xyz: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.int64]:
    """Kernel sums around some points, each of its own beamlet."""
    n = len(xyz)
    made = columns((xyz - xyz.min(axis=0)).astype(np.int32), np.arange(n), (0, 0, 0), 1500)
    order, place = made.points[3], np.empty(n, np.int32)
    place[order] = np.arange(n)
    radii = np.array([[round(1000 * r) for r in pair] for pair in foliage.KERNELS_M])
    out = np.empty((len(rows), KERNELS), np.int64)
    weigh_around(
        made, np.arange(float(n))[order], np.zeros(n, np.uint8), np.full(n, UNIT, np.int16),
        place[rows], radii, np.zeros((len(rows), 2)), 0, out,
    )  # fmt: skip
    return out


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(0, 40))
@settings(max_examples=40, deadline=None)
def test_clumping_is_that_of_a_plain_loop(seed: int, n: int, p: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = (rng.integers(-9000, 9000, n) for _ in range(2))
    parents = rng.integers(0, n, p)
    weight, counts = rng.integers(0, UNIT + 1, p), rng.integers(0, 2**30, (p, KERNELS))
    rows = np.arange(n)
    got = foliage.clumping(x, y, parents, weight.astype(np.int16), counts, rows)
    cell = round(1000 * foliage.CELL_M)
    for row in rows:
        sums = [0] * KERNELS
        for parent, worth, found in zip(parents, weight, counts, strict=True):
            near = abs(x[parent] // cell - x[row] // cell) <= foliage.CELLS
            if near and abs(y[parent] // cell - y[row] // cell) <= foliage.CELLS:
                sums = [a + int(worth) * int(b) for a, b in zip(sums, found, strict=True)]
        wide, narrow = (found / volume for found, volume in zip(sums, VOLUME_M3, strict=True))
        assert got[row] == pytest.approx(narrow / wide if wide else 1.0)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_density_is_that_of_the_formula_and_between_those_of_the_spheres(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.uniform(0, 50, KERNELS) * rng.integers(0, 2, KERNELS)
    near = rng.uniform(0.5, 6)
    wide = (counts[0] + foliage.LEAST) / VOLUME_M3[0]
    more = max(near - 1, 0)
    assert foliage.clumped(np.array([near]))[0] == pytest.approx(more / (more + foliage.HALF))
    got = foliage.density(counts[None], np.array([near]))[0]
    if more > 0:
        prior = foliage.SHAPE / more**2
        assert got == pytest.approx((counts[1] + prior) / (VOLUME_M3[1] + prior / wide))
    else:
        assert got == pytest.approx(wide)
    each = (wide, counts[1] / VOLUME_M3[1])
    assert min(each) * (1 - 1e-9) <= got <= max(each) * (1 + 1e-9)


def test_clumps_are_told_from_even_leaves() -> None:
    rng = np.random.default_rng(2)
    found = []
    for clumps in (1500, 100):
        middle = rng.uniform(0, 9, (clumps, 3))
        points = np.repeat(middle, 1500 // clumps, axis=0)
        points += rng.normal(0, 0.2 if clumps < 1500 else 0.0, points.shape)
        xyz = np.rint(1000 * points).astype(np.int64)
        rows = np.flatnonzero(np.all(np.abs(points - 4.5) < 2.5, axis=1))
        weight = np.full(len(rows), UNIT, np.int16)
        found.append(
            foliage.clumping(xyz[:, 0], xyz[:, 1], rows, weight, counts_around(xyz, rows), rows[:1])
        )
    even, dense = found
    assert 0.7 < even[0] < 1.3
    assert dense[0] > 3.0
    # One other return near by is a clump's among clumps, and chance where leaves are even.
    lone = np.array([[0.5, 0.5]])
    assert foliage.density(lone, dense) > 3 * foliage.density(lone, even)
