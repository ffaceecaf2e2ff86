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
    """Counts of squares, voxel by voxel."""
    nx, ny, nz = (n // f for n, f in zip(squares.shape, (4, 4, 1), strict=True))
    out = np.zeros((nx, ny, nz, 16), dtype=np.uint32)
    for x, y, z in np.argwhere(squares):
        out[x // 4, y // 4, z, x % 4 * 4 + y % 4] = squares[x, y, z]
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
    heard = local_noise.listened(np.rint(amount).astype(np.int64), pack(squares), 10.0)
    assert heard is not None
    found = heard.at(voxel, (x, y))
    return found.reshape(squares.shape[:2])[:, 8:-8]


def test_counts_and_squares() -> None:
    squares = np.random.default_rng(1).poisson(1.5, (12, 8, 3))
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
    counts = np.zeros((12, 12, 12, 16), dtype=np.uint16)
    cover(voxel, point, unit, -12.0, 21.0, 10.0, counts)
    assert set(np.unique(counts)) == {0, 1}
    squares = local_noise.unpack(counts) > 0
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


def test_counts_stop_where_they_are_full() -> None:
    counts = np.zeros((3, 3, 3, 16), dtype=np.uint16)
    counts[1, 1, 1] = 65534
    down, middle = np.array([0.0, 0.0, -1.0]), np.array([1, 1, 1])
    for _ in range(3):
        cover(middle, np.zeros(3), down, -4.0, 4.0, 10.0, counts)
    assert sorted(np.unique(counts)) == [0, 65534, 65535]


def ridge(per_square: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Density over that far from a ridge two squares wide, and the true one of each square."""
    rng = np.random.default_rng(3)
    rate = np.ones((SIZE[0] * 4, SIZE[1] * 4))
    rate[18:20] = height
    true = np.pad(rate, 4, mode="edge") * PER_M3
    sphere = local_noise.square_shares()
    blocks = rate.reshape(SIZE[0], 4, SIZE[1], 4)
    amount = np.einsum("xiyj,ij->xy", blocks, sphere) * PER_M3 * 1000.0 * VOXEL_FIXED_POINT
    beamlets = rng.poisson(rate[:, :, None] * per_square, (*rate.shape, SIZE[2])) + 1
    x, y = np.indices(rate.shape).reshape(2, -1)
    voxel = (x // 4, y // 4, np.full(len(x), MIDDLE))
    amounts = np.repeat(np.rint(amount).astype(np.int64)[:, :, None], SIZE[2], axis=2)
    heard = local_noise.listened(amounts, pack(beamlets), 10.0)
    assert heard is not None
    found = heard.at(voxel, (x, y))
    return found.reshape(rate.shape)[8:-8, 8:-8], true[12:-12, 12:-12]


def test_a_ridge_of_beamlets_is_a_ridge_of_noise() -> None:
    found, true = ridge(400.0, 3.0)
    top = true > 2 * PER_M3
    assert found[top].min() > 0.8 * 3.0 * PER_M3
    assert found.max() < 1.05 * 3.0 * PER_M3
    # no farther than a square and its blur
    flat = np.ones(true.shape, dtype=bool)
    flat[18 - 8 - 6 : 20 - 8 + 6] = False
    assert found[flat].max() < 1.05 * PER_M3


@pytest.mark.parametrize("per_square", [1.0, 5.0, 25.0, 100.0])
def test_chance_makes_no_ridge(per_square: float) -> None:
    found, _ = ridge(per_square, 1.0)
    assert found.mean() == pytest.approx(PER_M3, rel=0.01)
    assert found.max() < 1.5 * PER_M3
