"""Noise expected where a flightline listens: shares, edges, gaps, and what is out of reach."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import ndimage

from spl_batch.airborne.noise import local_noise
from spl_batch.airborne.noise.local_noise import unpack
from spl_batch.airborne.noise.voxel_chords import cover
from spl_batch.airborne.noise.voxel_noise import BEAMLET, sphere_radius_m
from spl_batch.lattice.tables import FIXED_POINT

PER_M3 = 0.2
SIZE = (9, 8, 5)
MIDDLE = 2
RADIUS = sphere_radius_m(10.0)


def pack(squares: np.ndarray) -> np.ndarray:
    """Counts of squares, voxel by voxel."""
    nx, ny, nz = squares.shape
    apart = squares.reshape(nx // 4, 4, ny // 4, 4, nz).transpose(0, 2, 4, 1, 3)
    return apart.reshape(nx // 4, ny // 4, nz, 16).astype(np.uint32)


def spheres(until_m: float) -> np.ndarray:
    """Part of the sphere of each voxel along x that lies below x = until_m."""
    centres = (np.arange(SIZE[0]) + 0.5) * 10.0
    fine = np.linspace(-6.2035, 6.2035, 4001)
    disc = 6.2035**2 - fine**2
    return np.array([disc[c + fine < until_m].sum() / disc.sum() for c in centres])


def made(share: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """A line with that share of the noise in each sphere, by x and z, and beamlets over squares."""
    share = share.reshape(SIZE[0], 1, -1)
    amount = np.broadcast_to(share, SIZE) * PER_M3 * 1000.0 * FIXED_POINT
    heard = local_noise.listened(np.rint(amount).astype(np.int64), BEAMLET * pack(squares), 10.0)
    assert heard is not None
    return heard


def along_x(x_m: np.ndarray, *heard: np.ndarray, z_m: float = 25.0) -> np.ndarray:
    """Density of lines together at places along x."""
    place = np.stack([x_m, np.full(len(x_m), 44.5), np.full(len(x_m), z_m)])
    return at_places(heard, place)


def at_places(heard: Sequence[np.ndarray], place_m: np.ndarray) -> np.ndarray:
    """Density of lines together at places from the corner of their voxels of 10 m."""
    return local_noise.around(heard, np.rint(place_m * 1e3).astype(np.int64), 10_000, (0, 0, 0))


def up_to(until_m: float, beamlets: float = 200.0) -> np.ndarray:
    """Beamlets over squares up to x = until_m."""
    part = np.clip((until_m - 2.5 * np.arange(SIZE[0] * 4)) / 2.5, 0, 1)
    whole = np.broadcast_to(part[:, None, None], (SIZE[0] * 4, SIZE[1] * 4, SIZE[2]))
    return np.rint(whole * beamlets).astype(np.uint32)


@pytest.mark.parametrize("until_m", [40.3, 43.9, 47.5])
def test_across_a_clear_edge_the_density_rises_over_two_squares(until_m: float) -> None:
    heard = made(spheres(until_m), up_to(until_m))
    inside = np.array([-12.0, -6.0, -4.0, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 4.0, 8.0])
    found = along_x(until_m - inside, heard) / PER_M3
    assert (np.diff(found) > -0.1).all()
    np.testing.assert_array_equal(found[inside < -5.1], 0)
    np.testing.assert_allclose(found[inside > 5.1], 1, atol=0.04)
    # linear between squares, which the true edge cuts anywhere
    linear = np.interp(inside, [-3.2, -2, -1, 0, 1, 2, 3.2], [0, 0.03, 0.2, 0.5, 0.8, 0.97, 1])
    some = found > 0
    np.testing.assert_allclose(found[some], linear[some], atol=0.3)


def test_beside_an_edge_flightlines_add_up() -> None:
    x = np.linspace(42, 52, 200)
    cut, whole = made(spheres(47.0), up_to(47.0)), made(np.full(SIZE[0], 0.3), up_to(1e3))
    alone, together = along_x(x, cut), along_x(x, cut, whole)
    np.testing.assert_allclose(together, 0.3 * PER_M3 + alone, rtol=1e-5)
    heard = alone > 0
    assert 47.0 < x[heard].max() < 47.0 + 2 * 2.5


@pytest.mark.parametrize("end_m", [20.3, 24.3, 29.1])
@pytest.mark.parametrize("upper", [True, False])
def test_where_a_gate_ends_in_a_layer_it_counts_up_to_there(end_m: float, *, upper: bool) -> None:
    centres = (np.arange(SIZE[2]) + 0.5) * 10.0
    depth = np.clip((end_m - centres) / RADIUS, -1, 1)
    share = (2 + 3 * depth - depth**3) / 4
    squares = np.where(centres - RADIUS < end_m, 200, 0)
    way = 1 if upper else -1
    share, squares = np.tile(share[::way], (SIZE[0], 1)), squares[::way]
    squares = np.tile(squares, (SIZE[0] * 4, SIZE[1] * 4, 1)).astype(np.uint32)
    heard = made(share, squares)
    x = np.linspace(20, 70, 20)
    for inside in (0.4, 2.5, 8.0, 15.0):
        height = 25.0 + way * (end_m - inside - 25.0)
        np.testing.assert_allclose(along_x(x, heard, z_m=height), PER_M3, rtol=0.03)
    beyond = 25.0 + way * (end_m + 11.0 - 25.0)
    np.testing.assert_allclose(along_x(x, heard, z_m=beyond), 0.0, atol=0.5 * PER_M3)


@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (0.2, -0.3, -0.93), (0.9, 0.1, -0.4)])
def test_a_beam_marks_squares_half_way_up(direction: tuple[float, float, float]) -> None:
    unit = np.array(direction) / np.linalg.norm(direction)
    point, voxel = np.array([3.1, -2.2, 1.7]), np.array([6, 6, 6])
    counts = np.zeros((12, 12, 12, 16), dtype=np.uint16)
    cover(voxel, point, unit, -12.0, 21.0, 10.0, RADIUS, 1, counts)
    assert set(np.unique(counts)) == {0, 1}
    squares = unpack(counts) > 0
    expected = np.zeros_like(squares)
    for s in np.linspace(-12.0, 21.0, 5001):
        z = point[2] + s * unit[2]
        layer = int(np.floor((z + 5.0) / 10.0))
        for reached in (layer - 1, layer, layer + 1):
            if abs(z - 10.0 * reached) < RADIUS:
                at = (reached * 10.0 - point[2]) / unit[2]
                at = np.clip(at, -12.0 - 1.5 * RADIUS, 21.0 + 1.5 * RADIUS)
                x, y = np.floor((point[:2] + at * unit[:2] + 65.0) / 2.5).astype(int)
                expected[x, y, reached + 6] = True
    np.testing.assert_array_equal(squares, expected)


@pytest.mark.parametrize("seed", range(3))
def test_what_lies_beyond_the_margin_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng([8, seed])
    shape = (9, 9, 8)
    number = rng.poisson(10.0 ** rng.uniform(-1, 2), (36, 36, 8)) * (rng.random((36, 36, 8)) < 0.9)
    number[:, :, 5:] *= rng.random(3) < 0.5
    amount = np.rint(number.reshape(9, 4, 9, 4, 8).sum(axis=(1, 3)) * 1e6 * rng.random(shape))
    counts = BEAMLET * pack(number)

    def density(first: int) -> np.ndarray:
        inner = (slice(first, 9 - first), slice(first, 9 - first), slice(first, 8 - first))
        found = local_noise.listened(amount[inner].astype(np.int64), counts[inner], 10.0)
        assert found is not None
        keep = local_noise.MARGIN_VOXELS - first + 1
        n = found.shape
        cut = (slice(4 * keep, n[0] - 4 * keep), slice(4 * keep, n[1] - 4 * keep))
        square = np.stack(np.indices(n), -1)[*cut, keep : n[2] - keep].reshape(-1, 3)
        within = np.random.default_rng(1).uniform(0.0, 1.0, square.shape)
        return at_places([found], ((square + within) * (2.5, 2.5, 10.0)).T)

    np.testing.assert_array_equal(density(0), density(1))


def square_shares() -> np.ndarray:
    """Share of a sphere over each square of its voxel; what sticks out is over the outer ones."""
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(400_000, 3))
    ball *= RADIUS * (rng.random((len(ball), 1)) ** (1 / 3)) / np.linalg.norm(ball, axis=1)[:, None]
    index = np.clip(np.floor((ball[:, :2] + 5.0) / 2.5).astype(int), 0, 3)
    counts = np.zeros((4, 4))
    np.add.at(counts, tuple(index.T), 1)
    return counts / len(ball)


def strip(rate: np.ndarray, beamlets: np.ndarray) -> np.ndarray:
    """A line of that relative rate by x and layer, and so many beamlets over squares."""
    rates = np.repeat(rate[:, None], SIZE[1] * 4, axis=1).reshape(SIZE[0], 4, SIZE[1], 4, -1)
    amount = np.einsum("xiyjz,ij->xyz", rates, square_shares())
    fixed = np.rint(amount * PER_M3 * 1000.0 * FIXED_POINT).astype(np.int64)
    heard = local_noise.listened(
        np.broadcast_to(fixed, SIZE).copy(), BEAMLET * pack(beamlets), 10.0
    )
    assert heard is not None
    return heard


def ridge(x_m: np.ndarray) -> np.ndarray:
    """Relative rate across a ridge as high as two thirds of it."""
    return 1.0 + 2.0 * np.exp(-(((x_m - 46.3) / 4.0) ** 2))


def test_over_a_ridge_of_beamlets_the_noise_is_theirs() -> None:
    fine = (np.arange(SIZE[0] * 4 * 50) + 0.5) / 20.0
    rate = ridge(fine).reshape(-1, 50).mean(axis=1)
    rate = np.repeat(rate[:, None], SIZE[2], axis=1)
    beamlets = np.repeat(np.rint(rate[:, None] * 400).astype(int), SIZE[1] * 4, axis=1)
    x = np.linspace(25, 65, 300)
    ratio = along_x(x, strip(rate, beamlets)) / PER_M3 / ridge(x)
    assert np.abs(ratio - 1).mean() < 0.05
    assert np.abs(ratio - 1).max() < 0.2
    top = np.abs(x - 46.3) < 1.25
    assert ratio[top].mean() == pytest.approx(1, abs=0.1)


def test_behind_the_last_metres_of_a_leaning_edge_the_noise_is_the_true_one() -> None:
    """As the edges of scans. In the last two metres few beamlets tell, and too much is expected."""
    fine = (np.arange(SIZE[0] * 4 * 50) + 0.5) / 20.0

    def rise(x_m: np.ndarray, z_m: float) -> np.ndarray:
        inside = 48.3 + 0.3 * (z_m - 25.0) - x_m
        return np.clip(inside / 6.5, 0, 1) ** 1.5

    rates = [rise(fine, 10.0 * k + 5.0).reshape(-1, 50).mean(axis=1) for k in range(SIZE[2])]
    rate = np.array(rates).T
    heard = strip(rate, np.rint(rate[:, None] * 200).astype(int).repeat(SIZE[1] * 4, axis=1))
    off = []
    for z in (20.5, 22.5, 25.0, 27.5, 29.5):
        edge = 48.3 + 0.3 * (z - 25.0)
        for low, high in ((0.0, 2.0), (2.0, 5.0), (5.0, 10.0)):
            x = edge - np.linspace(low, high, 41)
            true = rise(x, z)
            # as many points are there as there is noise
            off.append((along_x(x, heard, z_m=z) / PER_M3 / true.mean()).mean() - 1)
    last, near, behind = np.mean([off[k::3] for k in range(3)], axis=1)
    assert 0.0 < last < 2.6
    assert abs(near) < 0.2
    assert abs(behind) < 0.05


def test_beyond_the_end_of_a_gate_the_next_layer_only_tells_where() -> None:
    """A layer in which half of the beamlets end does not take from the one that all cross."""
    counts = np.full((SIZE[0] * 4, SIZE[1] * 4, SIZE[2]), 200, dtype=np.uint32)
    counts[:, :, MIDDLE + 1 :] = 100
    share = np.where(np.arange(SIZE[2]) > MIDDLE, 0.5, 1.0)
    heard = made(np.tile(share, (SIZE[0], 1)), counts)
    x = np.linspace(20, 70, 20)
    for z in (21.0, 25.0):
        np.testing.assert_allclose(along_x(x, heard, z_m=z), PER_M3, rtol=1e-3)
    # between layers it is linear
    np.testing.assert_allclose(along_x(x, heard, z_m=30.0), 0.75 * PER_M3, rtol=1e-3)
    np.testing.assert_allclose(along_x(x, heard, z_m=41.0), 0.5 * PER_M3, rtol=1e-3)


def test_a_point_lies_between_the_centres_of_squares_and_of_layers() -> None:
    rng = np.random.default_rng(9)
    n, shape = 300, (12, 16, 5)
    density = rng.uniform(0.2, 1, shape).astype(np.float32)
    density[rng.random(shape) < 0.1] = 0.0
    place = rng.uniform(0, 1, (3, n)) * np.array(shape)[:, None]
    # to whole quanta
    edges = np.array([[2500], [2500], [10_000]])
    quanta = np.floor(place * edges).astype(np.int64)
    place = quanta / edges
    square, offset = np.floor(place).astype(np.int64), place % 1 - 0.5
    found = local_noise.around([density], quanta, 10_000, (0, 0, 0))
    for p in range(n):
        layer = []
        for z in range(shape[2]):
            flat, at = density[:, :, z].astype(float), place[:2, p, None] - 0.5
            linear = ndimage.map_coordinates(flat, at, order=1, mode="nearest")[0]
            layer.append(linear)
        z = square[2, p]
        beside = layer[min(max(z + (1 if offset[2, p] > 0 else -1), 0), shape[2] - 1)]
        both = layer[z] > 0 and beside > 0
        expected = layer[z] + abs(offset[2, p]) * (beside - layer[z]) * both
        assert found[p] == pytest.approx(expected, rel=1e-5), p
