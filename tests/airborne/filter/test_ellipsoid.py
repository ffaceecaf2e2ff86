"""The ellipsoid's count against numpy: all pairs, eigh, scipy.stats; and the eigensolver."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import count_inside
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.numerics.neighbours.kdtree import build
from spl_batch.numerics.planes.eigen import eigen_symmetric
from tests.numerics.test_kdtree import brute_nearest

SHAPE = Shape(15, 1500.0, 30.0, 12_000.0, 12_000, 1.0)


def mixed_cloud(seed: int, n: int, *, step: int = 1) -> NDArray[np.int32]:
    """Noise, a plane, a line and duplicates [mm]; a coarse step makes ties."""
    rng = np.random.default_rng(seed)
    side = 8000
    noise = rng.uniform(0, side, (n // 3, 3))
    plane = rng.uniform(0, side, (n // 3, 3))
    plane[:, 2] = 2000 + 0.2 * plane[:, 0] + rng.normal(0, 50, len(plane))
    line = np.outer(rng.uniform(0, 1, n // 6), [side, side / 2, 500]) + np.array([0, 0, 6000])
    cloud = np.concatenate([noise, plane, line + rng.normal(0, 40, line.shape)])
    cloud = np.concatenate([cloud, cloud[: n - len(cloud)]])
    return np.rint(cloud / step).astype(np.int32) * step


def brute_counts(
    xyz: NDArray[np.int32], shape: Shape, peers: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Fewest and most inside (they differ where a point lies on the border), and volumes."""
    rows, found = brute_nearest(xyz, shape.neighbours, shape.neighbour_cap)
    low, high = np.zeros(len(xyz), dtype=np.int64), np.zeros(len(xyz), dtype=np.int64)
    volume = np.zeros(len(xyz))
    for i in range(len(xyz)):
        values, vectors = np.ones(3), np.eye(3)
        if found[i] >= 4:
            near = xyz[rows[i, : found[i]]].astype(np.float64)
            values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        spread = np.maximum(values, shape.floor**2) ** shape.power
        axes = np.minimum(shape.radius * spread / np.cbrt(spread.prod()), shape.axis_cap)
        volume[i] = 4 / 3 * np.pi * axes.prod()
        offsets = np.delete(xyz, i, axis=0).astype(np.float64) - xyz[i]
        flag = ((offsets @ vectors / axes) ** 2).sum(axis=1)
        if peers is not None:
            flag = flag[np.delete(peers[i], i)]
        low[i], high[i] = (flag < 1 - 1e-9).sum(), (flag < 1 + 1e-9).sum()
    return low, high, volume


@pytest.mark.parametrize("step", [1, 400])
@pytest.mark.parametrize(
    "shape",
    [
        SHAPE,
        SHAPE._replace(power=0.5),
        SHAPE._replace(neighbours=6, axis_cap=2500.0, neighbour_cap=700),
    ],
)
def test_counts_and_labels_are_the_oracles(shape: Shape, step: int) -> None:
    xyz = mixed_cloud(7, 600, step=step)
    density = np.random.default_rng(3).choice([0.0, 2e-11, 1e-10, 1e-9], len(xyz))
    low, high, volume = brute_counts(xyz, shape)
    query = np.ones(len(xyz), dtype=bool)
    count, expected, tail = count_inside(xyz, build(xyz), query, density, shape, alpha=1e-300)
    np.testing.assert_allclose(expected, density * volume, rtol=1e-9)
    some = density > 0
    assert ((low <= count) & (count <= high))[some].all()
    assert (low == high).mean() > (0.99 if step == 1 else 0.5)
    alpha = 1e-4
    stopped, _, bound = count_inside(xyz, build(xyz), query, density, shape, alpha=alpha)
    clear = some & (low == high)
    full = stats.poisson.sf(low - 1, density * volume)
    np.testing.assert_allclose(tail[clear], full[clear], rtol=1e-7)
    np.testing.assert_array_equal((bound <= alpha)[clear], (full <= alpha)[clear])
    assert (bound >= tail).all()
    assert (stopped <= count)[some].all()
    assert 0.05 < (full <= alpha)[clear].mean() < 0.95
    np.testing.assert_array_equal(
        (bound <= alpha)[~some & (low == high)], (low > 0)[~some & (low == high)]
    )


def test_ties_are_broken_by_the_outermost_peer_inside() -> None:
    power = 0.5
    xyz = mixed_cloud(8, 500)
    shape = SHAPE._replace(power=power)
    rng = np.random.default_rng(5)
    density = rng.choice([2e-11, 1e-10, 1e-9], len(xyz))
    spacing = rng.integers(1, 20, len(xyz)).astype(np.float64)
    query = np.ones(len(xyz), dtype=bool)
    tree = build(xyz)
    stop = rng.choice([1e-12, 1e-3], len(xyz))
    count, expected, score = count_inside(
        xyz, tree, query, density, shape, alpha=stop, spacing=tree.by_slot(spacing),
        peer_ratio=2.0, tie=True,
    )  # fmt: skip
    rows, found = brute_nearest(xyz, 15, 12_000)
    for i in range(len(xyz)):
        values, vectors = np.linalg.eigh(np.cov(xyz[rows[i, : found[i]]].T, bias=True))
        spread = np.maximum(values, shape.floor**2) ** power
        axes = np.minimum(shape.radius * spread / np.cbrt(spread.prod()), shape.axis_cap)
        offsets = np.delete(xyz, i, axis=0).astype(np.float64) - xyz[i]
        flag = ((offsets @ vectors / axes) ** 2).sum(axis=1)
        flag = flag[(flag < 1) & (np.delete(spacing, i) * 4 >= spacing[i])]
        k = len(flag)
        tail, more = stats.poisson.sf([k - 1, k], expected[i])
        if tail <= stop[i]:
            assert score[i] <= stop[i]
            assert count[i] <= k
            continue
        outermost = flag.max(initial=0.0) if k else 1.0
        assert count[i] == k
        assert score[i] == pytest.approx(more + outermost ** (1.5 * k) * (tail - more), rel=1e-6)
    assert 0.1 < (score > stop).mean() < 0.9


def test_scores_alone_and_limits_by_other_words_are_the_same() -> None:
    xyz, rng = mixed_cloud(8, 500), np.random.default_rng(5)
    density, stop = rng.choice([2e-11, 1e-9], len(xyz)), rng.choice([1e-12, 1e-3], len(xyz))
    tree, query = build(xyz), rng.random(len(xyz)) < 0.7
    lower = np.minimum(stop, 1e-6)
    _, _, score = count_inside(xyz, tree, query, density, SHAPE, alpha=lower, tie=True)
    count, expected, again = count_inside(
        xyz, tree, query, density * 64, SHAPE, alpha=stop, at_most=1e-6, unit=4, tie=True,
        scores_only=True,
    )  # fmt: skip
    np.testing.assert_array_equal(again, score)
    assert len(count) == len(expected) == 0
    _, _, wide = count_inside(xyz, tree, query, density, SHAPE, alpha=stop, tie=True)
    assert (wide != score).any()


@pytest.mark.parametrize(
    "cloud",
    [
        np.zeros((1, 3)),
        np.zeros((3, 3)),
        np.zeros((40, 3)),
        np.outer(np.arange(40), [70, 0, 0]),
        np.stack([np.arange(49) % 7, np.arange(49) // 7, np.zeros(49)], axis=1) * 300,
    ],
    ids=["one", "three in one place", "forty in one place", "line", "grid"],
)
def test_degenerate_neighbourhoods(cloud: NDArray[np.float64]) -> None:
    xyz = cloud.astype(np.int32)
    low, high, volume = brute_counts(xyz, SHAPE)
    density = np.full(len(xyz), 1e-11)
    query = np.ones(len(xyz), dtype=bool)
    count, expected, _ = count_inside(xyz, build(xyz), query, density, SHAPE, alpha=1e-300)
    np.testing.assert_allclose(expected, density * volume, rtol=1e-9)
    assert ((low <= count) & (count <= high)).all()


@given(
    st.integers(0, 2**32 - 1),
    st.tuples(*[st.sampled_from([0.0, 1e-12, 1.0, 1.0 + 1e-9, 3.0, 1e8])] * 3),
)
@settings(max_examples=200, deadline=None)
def test_eigenvectors_rebuild_the_matrix(seed: int, spread: tuple[float, float, float]) -> None:
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    matrix = basis @ np.diag(spread) @ basis.T
    matrix = 0.5 * (matrix + matrix.T)
    values, vectors = np.empty(3), np.empty((3, 3))
    eigen_symmetric(matrix[np.triu_indices(3)], values, vectors)
    size = max(spread) or 1.0
    np.testing.assert_allclose(values, np.sort(spread)[::-1], atol=2e-7 * size)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(vectors.T @ np.diag(values) @ vectors, matrix, atol=5e-7 * size)
