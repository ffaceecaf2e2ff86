"""Noise around raster cells: the average, and squares where it is clearly more."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.products.noise_aloft import STEP, noise_by_cell
from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

SIZE = 500
WIDE, NEAR = Bounds(-30_000, 5_000, 90_000, 95_000), Bounds(-10_500, 20_000, 60_000, 80_500)
PER_M3, TIMES, DEPTH_M = 0.05, 4.0, 100.0


def refused(rng: np.random.Generator, times: float) -> PointTable:
    """Noise, ``times`` as dense from 20 to 30 m east, and ground that is returned everywhere."""
    bounds = [(-30, 90, PER_M3), (20, 30, (times - 1) * PER_M3)]
    xyz = np.concatenate([
        rng.uniform((west, 5, 0), (east, 95, DEPTH_M), (rng.poisson(n * (east - west) * 9000), 3))
        for west, east, n in bounds
    ])  # fmt: skip
    ground = rng.uniform((-30, 5, 20), (90, 95, 20), (100_000, 3))
    kinds = np.repeat([NOISE_BACKGROUND, NOISE_SIGNAL], [len(xyz), len(ground)]).astype(np.uint8)
    order = rng.permutation(len(kinds))
    x, y, z = np.rint(np.concatenate([xyz, ground])[order].T * 1000)
    return PointTable({
        "x": x.astype(np.int64), "y": y.astype(np.int64), "z": z.astype(np.int32),
        "noise_class": kinds[order],
    })  # fmt: skip


def cells(bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of each raster cell's west and south side [quanta]."""
    y, x = np.meshgrid(
        np.arange(bounds.ymin, bounds.ymax, SIZE), np.arange(bounds.xmin, bounds.xmax, SIZE),
        indexing="ij",
    )  # fmt: skip
    return y.ravel(), x.ravel()


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 100))
def test_a_dense_strip_has_its_own_density_and_the_rest_the_average(seed: int) -> None:
    found = noise_by_cell(refused(np.random.default_rng(seed), TIMES), WIDE, NEAR, SIZE)
    _, x = cells(NEAR)
    within = (x >= 20_000) & (x < 30_000)
    average = PER_M3 * (1 + (TIMES - 1) * 10 / 120)
    assert len(found) == len(x)
    assert len(set(found[~within])) == 1
    assert abs(found[~within][0] / average - 1) < 0.05
    assert np.all(found[within] > TIMES * PER_M3 * 0.8)
    assert np.all(found[within] < TIMES * PER_M3 * 1.2 * STEP)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 100))
def test_even_noise_has_one_density(seed: int) -> None:
    found = noise_by_cell(refused(np.random.default_rng(seed), 1.0), WIDE, NEAR, SIZE)
    assert len(set(found)) == 1


def test_a_square_has_the_same_density_wherever_it_is_looked_at_from() -> None:
    table = refused(np.random.default_rng(1), TIMES)
    whole = noise_by_cell(table, WIDE, WIDE, SIZE).reshape(-1, 240)
    part = noise_by_cell(table, WIDE, NEAR, SIZE).reshape(-1, 141)
    assert np.array_equal(part, whole[30:151, 39:180])


def test_noise_over_a_sliver_of_a_square_at_the_rim_gives_it_no_density_of_its_own() -> None:
    table = refused(np.random.default_rng(1), TIMES)
    flown = table.take(table["x"] < 20_500)
    assert len(set(noise_by_cell(flown, *[WIDE._replace(xmax=20_500)] * 2, SIZE))) == 1


def test_without_noise_there_is_none() -> None:
    table = refused(np.random.default_rng(1), TIMES)
    signal = table.take(table["noise_class"] == NOISE_SIGNAL)
    assert not noise_by_cell(signal, WIDE, NEAR, SIZE).any()
