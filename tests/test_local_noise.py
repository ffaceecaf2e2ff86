"""Noise expected where a flightline listens: shares, edges, gaps, and what is out of reach."""

import numpy as np
import pytest

from spl_batch.kernels.chords import cover
from spl_batch.model import VOXEL_FIXED_POINT
from spl_batch.stages import local_noise

PER_M3 = 0.2
SIZE = (9, 8, 5)
MIDDLE = 2


def pack(squares: np.ndarray) -> np.ndarray:
    """Bits of squares, one after the other."""
    nx, ny, nz = (n // f for n, f in zip(squares.shape, (4, 4, 1), strict=True))
    out = np.zeros((nx, ny, nz), dtype=np.uint16)
    for x, y, z in np.argwhere(squares):
        out[x // 4, y // 4, z] |= np.uint16(1 << (x % 4 * 4 + y % 4))
    return out


def listened(until_m: float, *, holes: np.ndarray | None = None) -> np.ndarray:
    """Density at every square of a line that listens up to x = until_m, evenly."""
    centres = (np.arange(SIZE[0]) + 0.5) * 10.0
    fine = np.linspace(-6.2035, 6.2035, 4001)
    disc = 6.2035**2 - fine**2
    share = np.array([disc[c + fine < until_m].sum() / disc.sum() for c in centres])
    amount = np.broadcast_to(share[:, None, None], SIZE) * PER_M3 * 1000.0 * VOXEL_FIXED_POINT
    squares = np.zeros((SIZE[0] * 4, SIZE[1] * 4, SIZE[2]), dtype=bool)
    squares[: int(np.ceil(until_m / 2.5))] = True
    if holes is not None:
        squares &= ~holes
    x, y = np.indices(squares.shape[:2]).reshape(2, -1)
    voxel = (x // 4, y // 4, np.full(len(x), MIDDLE))
    found = local_noise.listened_density(
        np.rint(amount).astype(np.int64), pack(squares), voxel, (x, y), 10.0
    )
    return found.reshape(squares.shape[:2])[:, 8:-8]


def test_bits_and_squares() -> None:
    squares = np.random.default_rng(1).random((12, 8, 3)) < 0.4
    np.testing.assert_array_equal(local_noise.unpack(pack(squares)), squares)


def test_shares_of_a_sphere_by_chance() -> None:
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(400_000, 3))
    ball *= 6.2035 * (rng.random((len(ball), 1)) ** (1 / 3)) / np.linalg.norm(ball, axis=1)[:, None]
    index = np.clip(np.floor((ball[:, :2] + 5.0) / 2.5).astype(int), 0, 3)
    counts = np.zeros((4, 4))
    np.add.at(counts, tuple(index.T), 1)
    np.testing.assert_allclose(local_noise.square_shares(), counts / len(ball), atol=2e-3)


@pytest.mark.parametrize("until_m", np.arange(40.5, 51.0, 1.3).tolist())
def test_up_to_an_edge_the_density_is_that_of_the_part_listened_to(until_m: float) -> None:
    found = listened(until_m)
    inside = found[8 : int(until_m // 2.5) + 1]
    assert inside.min() > 0.93 * PER_M3
    assert inside.max() < 1.6 * PER_M3
    assert np.all(found[int(np.ceil(until_m / 2.5)) + 1 :] == 0.0)


def test_far_from_edges_it_is_the_mean_with_gaps_or_without() -> None:
    holes = np.zeros((SIZE[0] * 4, SIZE[1] * 4, SIZE[2]), dtype=bool)
    holes[::3, ::3] = True
    for found in (listened(90.0), listened(90.0, holes=holes)):
        np.testing.assert_allclose(found[8:-8], PER_M3, rtol=1e-6)


@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (0.2, -0.3, -0.93), (0.9, 0.1, -0.4)])
def test_a_beam_marks_squares_half_way_up(direction: tuple[float, float, float]) -> None:
    unit = np.array(direction) / np.linalg.norm(direction)
    point, voxel = np.array([3.1, -2.2, 1.7]), np.array([6, 6, 6])
    covered = np.zeros((12, 12, 12), dtype=np.uint16)
    cover(voxel, point, unit, -12.0, 21.0, 10.0, covered)
    squares = local_noise.unpack(covered)
    expected = np.zeros_like(squares)
    for s in np.linspace(-12.0, 21.0, 5001):
        layer = int(np.floor((point[2] + s * unit[2] + 5.0) / 10.0))
        at = (layer * 10.0 - point[2]) / unit[2]
        x, y = np.floor((point[:2] + at * unit[:2] + 65.0) / 2.5).astype(int)
        if abs(unit[2]) > 0.7:
            expected[x, y, layer + 6] = True
            continue
        i, j = np.floor((point[:2] + s * unit[:2] + 65.0) / 10.0).astype(int) * 4
        expected[i : i + 4, j : j + 4, layer + 6] = True
    if abs(unit[2]) > 0.7:
        np.testing.assert_array_equal(squares, expected)
    else:
        assert squares.sum() >= 0.6 * expected.sum()
        assert not np.any(squares & ~expected)
