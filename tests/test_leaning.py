"""What squares tell beyond counts: how beams lean, how even a voxel is, how an edge counts."""

import numpy as np
import pytest
from scipy import ndimage

from spl_batch.kernels.squares import CHANCE, MOST, density_between, slopes_and_steps
from spl_batch.stages import leaning, local_noise
from spl_batch.stages.beamlet_counts import PRIOR, told, worth_of_mean


def test_how_beams_lean_is_told_by_what_goes_on_from_layer_to_layer() -> None:
    rng = np.random.default_rng(7)
    x, y, z = np.indices((48, 40, 6)).astype(float)
    place = (x + 0.5 - 0.9 * (z - 3), y + 0.5 + 0.5 * (z - 3))
    rate = 100.0 * (1.0 + 0.5 * np.sin(place[0] / 2.5) + 0.4 * np.sin(place[1] / 3.0 + 1.0))
    few, number = np.full((12, 10, 6), 16.0), np.full((12, 10, 6), 1600.0)
    even = np.full((12, 10, 6), 100.0)
    inner = (slice(None), slice(2, -2), slice(2, -2), slice(2, -2))
    found = leaning.lean(rate.astype(np.float32), few, even)[inner]
    np.testing.assert_allclose(found[0], 0.9, atol=0.1)
    np.testing.assert_allclose(found[1], -0.5, atol=0.06)
    # what only half of the beamlets reach is no step of theirs
    half = np.where(z < 3, rate, 0.5 * rate).astype(np.float32)
    mean = np.where(np.arange(6) < 3, even, 0.5 * even)
    np.testing.assert_allclose(leaning.lean(half, few, mean)[inner][0], 0.9, atol=0.15)
    nothing = leaning.lean(np.full(x.shape, 100, np.float32), number, even)
    np.testing.assert_array_equal(nothing, 0.0)
    chance = rng.poisson(100, (48, 40, 1)).repeat(6, axis=2).astype(np.float32)
    assert np.abs(leaning.lean(chance, number, even)).max() < 0.3


def test_slopes_and_steps_are_sums_of_voxels() -> None:
    smooth = np.random.default_rng(8).uniform(0, 99, (16, 12, 5)).astype(np.float32)
    found = np.empty((5, 4, 3, 4))
    slopes_and_steps(smooth, found)
    slope_x, slope_y = (np.gradient(smooth.astype(float), axis=axis) for axis in (0, 1))
    east, north = ((v[:, :, 1:] + v[:, :, :-1]) / 2 for v in (slope_x, slope_y))
    step = np.diff(smooth.astype(float), axis=2)
    wide = [ndimage.convolve1d(step, [0.25, 0.5, 0.25], axis=axis) for axis in (0, 1)]
    products = (east * east, east * north, north * north, east * wide[0], north * wide[1])
    for got, product in zip(found, products, strict=True):
        sums = product.reshape(4, 4, 3, 4, 4).sum(axis=(1, 3))
        # those along the sides of the box have no slope
        np.testing.assert_allclose(got[1:-1, 1:-1], sums[1:-1, 1:-1], rtol=1e-4, atol=1e-3)


def test_the_mean_of_a_voxel_is_worth_the_less_the_more_uneven_squares_are() -> None:
    rng = np.random.default_rng(9)
    even = rng.poisson(100.0, (40, 40, 1)).astype(np.float32)
    smooth = told(even, np.ones_like(even)).smooth
    np.testing.assert_array_equal(worth_of_mean(smooth)[1:-1, 1:-1], PRIOR)
    uneven = rng.poisson(
        100.0 * np.exp(0.5 * np.sin(np.arange(40) / 1.2))[:, None, None], even.shape
    )
    smooth = told(uneven.astype(np.float32), np.ones_like(even)).smooth
    relative = smooth.std(ddof=1) / smooth.mean()
    found = worth_of_mean(smooth)[1:-1, 1:-1]
    assert found.max() < PRIOR
    assert np.median(found) == pytest.approx(1.0 / relative**2, rel=0.4)


def test_a_flightline_counts_for_more_within_a_sharp_edge_and_for_less_beyond() -> None:
    part = np.linspace(0.0, 1.0, 201)
    ones = np.ones(len(part), np.float32)
    sharp = local_noise.beside_an_edge(part, ones)
    assert np.all(np.diff(sharp) >= 0.0)
    assert np.all(sharp[part < local_noise.BEYOND] <= part[part < local_noise.BEYOND])
    assert sharp[40] == pytest.approx(0.5 * part[40])
    assert np.all(sharp[part > 0.53] >= local_noise.BESIDE_NOTHING - 1e-6)
    blurred = local_noise.beside_an_edge(part, 0.5 * ones)
    np.testing.assert_array_equal(blurred[part <= local_noise.BEYOND], part[:81])
    np.testing.assert_array_equal(blurred[part > 0.5], part[part > 0.5])


@pytest.mark.parametrize("seed", range(4))
def test_where_its_beam_crosses_the_layer_a_point_is_between_the_centres_of_squares(
    seed: int,
) -> None:
    rng = np.random.default_rng([9, seed])
    n, shape = 200, (3, 4, 5)
    beamlets = rng.uniform(0, 200, (12, 16, 5)) * (rng.random((12, 16, 5)) < 0.9)
    there = (beamlets * rng.uniform(0, 1.2, beamlets.shape)).astype(np.float32)
    each, usual = rng.uniform(0, 0.01, shape), rng.uniform(0, 1, shape)
    worth, lean = rng.uniform(0, 50, shape), rng.uniform(-2, 2, (2, *shape))
    near = rng.random(beamlets.shape) < 0.8
    edge = np.where(rng.random(near.shape) < 0.3, rng.random(near.shape), -1).astype(np.float32)
    place = rng.uniform(0, 1, (3, n)) * np.array(beamlets.shape)[:, None]
    square, offset = np.floor(place).astype(np.int64), place % 1 - 0.5
    voxel = square // np.array([4, 4, 1])[:, None]
    found, part, sharp = np.empty(n), np.empty(n), np.empty(n, np.float32)
    density_between(
        beamlets, there, near, each, usual, worth, lean, *voxel, *square[:2], *offset, 4.0, edge,
        found, part, sharp,
    )  # fmt: skip
    assert np.count_nonzero((part > 0.0) & (part < 1.0)) > 10
    for p in range(n):
        at, z = tuple(voxel[:, p]), square[2, p]
        crossed = place[:2, p] - lean[(slice(None), *at)] * offset[2, p]
        own = (*np.clip(np.floor(crossed).astype(int), 0, (11, 15)), z)
        assert sharp[p] == edge[own]
        if not near[own]:
            assert found[p] == 0.0
            continue
        count, whole = (
            ndimage.map_coordinates(v[:, :, z], crossed[:, None] - 0.5, order=1, mode="nearest")[0]
            for v in (beamlets, there.astype(float))
        )
        marked = edge[own] >= 0.0 and count > 0.0
        assert part[p] == pytest.approx(min(whole / count, 1.0) if marked else 1.0), p
        known = 4.0 * count
        mean = (known * count * each[at] + worth[at] * usual[at]) / (known + worth[at])
        chance = min(CHANCE * known / (known + worth[at]) ** 2, MOST)
        assert found[p] == pytest.approx(mean * (1.0 + chance)), p
