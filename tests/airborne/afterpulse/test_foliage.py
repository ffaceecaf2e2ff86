"""Density of returns among leaves: the formula against loops, and evenly spread or clumped."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import foliage
from spl_batch.airborne.afterpulse.weighted_counts import UNIT, weigh_around
from spl_batch.numerics.neighbours.lattice_columns import columns

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
        for k in range(1, KERNELS):
            lent = foliage.PAIRS * UNIT**3
            pairs = (sums[k] + lent) / VOLUME_M3[k]
            wide = sums[0] / VOLUME_M3[0] + lent / VOLUME_M3[k]
            assert got[row, k - 1] == pytest.approx(pairs / wide)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_density_is_that_of_a_plain_loop_and_between_those_of_the_kernels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.uniform(0, 50, KERNELS) * rng.integers(0, 2, KERNELS)
    near = rng.uniform(0.5, 6, KERNELS - 1)
    surface = near[0] >= foliage.SURFACE_MIN
    found = (counts[0] + foliage.LEAST) / VOLUME_M3[0]
    each = [found]
    for k in range(1, KERNELS):
        if k == 1 and not surface:
            clumped = 1.0
        elif k > 1 and surface:
            clumped = near[k - 1] / near[0]
        else:
            clumped = near[k - 1]
        prior = foliage.SHAPE / max(clumped - 1, foliage.CLUMPED_MIN) ** 2
        found = (counts[k] + prior) / (VOLUME_M3[k] + prior / found)
        each.append(counts[k] / VOLUME_M3[k])
    more = max(clumped - 1, 0)
    even, dense = foliage.SIGHT
    share = more / (more + foliage.HALF)
    assert foliage.clumped(near[None])[0] == pytest.approx(share)
    got = foliage.density(counts[None], near[None])[0] / (even ** (1 - share) * dense**share)
    assert got == pytest.approx(found)
    assert min(each) * (1 - 1e-9) <= got <= max(each) * (1 + 1e-9)


def test_parents_on_a_plane_are_told_from_foliage_and_a_bed_below_is_believed() -> None:
    rng = np.random.default_rng(2)
    found = []
    for spread in (0.05, 3.0):
        points = np.column_stack([rng.uniform(0, 9, (1500, 2)), rng.normal(0, spread, 1500)])
        xyz = np.rint(1000 * points).astype(np.int64)
        rows = np.flatnonzero(np.all(np.abs(points - [4.5, 4.5, 0]) < 2.5, axis=1))
        weight = np.full(len(rows), UNIT, np.int16)
        near = foliage.clumping(
            xyz[:, 0], xyz[:, 1], rows, weight, counts_around(xyz, rows), rows[:1]
        )
        found.append(near)
    assert found[0][0, 0] > 4 > foliage.SURFACE_MIN > 2 > found[1][0, 0]
    sparse_bed = np.array([[3.0, 3.0, 0.2, 0.0]])
    assert foliage.density(sparse_bed, found[0]) > 4 * foliage.density(sparse_bed, found[1])
