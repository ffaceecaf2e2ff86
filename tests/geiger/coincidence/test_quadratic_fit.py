"""Polynomials, their maxima, and which of them are points."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.geiger.coincidence.surface import quadratic_fit as kernels
from spl_batch.geiger.coincidence.surface.voxel_raster import UNIT


def coefficients(raster: np.ndarray, half: int) -> np.ndarray:
    moment = np.empty(10, np.int64)
    kernels.moments(raster, half, half, half, half, moment)
    return kernels.fit_matrix(half) @ moment


def maximum(c: np.ndarray, ratio: float, reach: float) -> tuple[int, float, np.ndarray]:
    offset = np.empty(3)
    kind, value = kernels.closest_maximum(c, ratio, reach, np.empty(3), np.empty((3, 3)), offset)
    return kind, value, offset


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 4))
def test_fit_against_least_squares(seed: int, half: int) -> None:
    raster = np.random.default_rng(seed).poisson(0.3, (2 * half + 1,) * 3) * 1000
    axis = np.arange(-half, half + 1)
    x, y, z = (a.ravel() for a in np.meshgrid(axis, axis, axis, indexing="ij"))
    m = np.stack([x**0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=-1)
    slow = np.linalg.lstsq(m.astype(float), raster.ravel().astype(float))[0]
    assert coefficients(raster, half) == pytest.approx(slow, abs=1e-6 * max(raster.max(), 1))


@pytest.mark.parametrize(
    ("curvatures", "kind"),
    [
        ([0.0, 0.1, -2.0], kernels.SURFACE),
        ([-0.1, -0.3, -2.0], kernels.SURFACE),
        ([-0.1, -1.8, -2.0], kernels.RIDGE),
        ([-1.7, -1.8, -2.0], kernels.PEAK),
        ([1.0, 2.0, 3.0], kernels.NOTHING),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_maxima_of_known_polynomials(curvatures: list[float], kind: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    h, gradient = basis @ np.diag(curvatures) @ basis.T, rng.uniform(-0.3, 0.3, 3)
    c = np.array([5.0, *gradient, h[0, 0] / 2, h[1, 1] / 2, h[2, 2] / 2, h[0, 1], h[0, 2], h[1, 2]])
    found, value, offset = maximum(c, 0.5, 10.0)
    assert found == kind
    if kind == kernels.NOTHING:
        return
    # The gradient is nothing along each maximum, the offset lies in their span.
    slope = (gradient + h @ offset) @ basis
    assert slope[3 - kind :] == pytest.approx(0.0, abs=1e-9)
    assert (offset @ basis)[: 3 - kind] == pytest.approx(0.0, abs=1e-9)
    assert value == pytest.approx(5.0 + gradient @ offset + offset @ h @ offset / 2)
    if kind == kernels.PEAK:
        assert offset == pytest.approx(-np.linalg.inv(h) @ gradient)  # [M20] Eq. 4
    far = float(np.abs(offset).max())
    assert maximum(c, 0.5, far * 1.01)[0] == kind
    assert maximum(c, 0.5, far * 0.99)[0] == kernels.NOTHING


def surfaces(
    raster: np.ndarray, voxel: np.ndarray, looks: float, half: int, *limits: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Offsets, normals, values and kinds."""
    summed = np.full(len(voxel), round((2 * half + 1) ** 3 * looks * UNIT))
    return kernels.find_surfaces(raster, summed, voxel, half, kernels.fit_matrix(half), *limits)


def layer(size: int, height: float, sigma: float) -> np.ndarray:
    """A level surface at a height above the middle of a cube."""
    k = np.arange(size) - size // 2
    share = np.exp(-0.5 * ((k - height) / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    return np.rint(np.broadcast_to(share * UNIT, (size,) * 3)).astype(np.int64)


def test_a_level_surface_is_found_once_at_its_height() -> None:
    raster, voxel = layer(13, 0.3, 1.2), np.array([[6, 6, z] for z in range(3, 10)])
    limits = (0.05, 0.5, 0.5, 0.5, 9.0)
    offset, normal, value, kind = surfaces(raster, voxel, 2.0, 3, *limits)
    # A parabola bends towards its own centre, so the voxel above claims the surface as well.
    assert kind.tolist() == [0, 0, 0, kernels.SURFACE, kernels.SURFACE, 0, 0]
    row_of = np.full(raster.shape, -1, np.int32)
    row_of[6, 6, 6:8] = [0, 1]
    rows = (voxel[3:5], offset[3:5], normal[3:5], value[3:5])
    for along, kept in ((3, [True, False]), (-1, [True, True])):
        assert kernels.drop_weaker(*rows, row_of, along, 3, 0.0).tolist() == kept
    assert offset[3] == pytest.approx([0, 0, 0.3], abs=0.15)
    assert np.abs(normal[3]) == pytest.approx([0, 0, 1], abs=1e-6)
    # A parabola over seven layers flattens a peak of 0.33 / 2 detections per look.
    assert 0.1 < value[3] < 0.17
    assert not surfaces(raster, voxel, 2.0, 3, 0.2, *limits[1:])[3].any()
    assert not surfaces(raster, voxel, 2.0, 3, 0.05, 2.5, *limits[2:])[3].any()


@pytest.mark.parametrize("half", [1, 2, 4])
@pytest.mark.parametrize("axis", [0, 1])
def test_points_end_at_a_straight_edge(half: int, axis: int) -> None:
    """A level target with an edge that is smeared over a detector and by trilinear weights."""
    size = 4 * half + 9
    middle, fine = size // 2, 240
    steps = (np.arange(size * fine) + 0.5) / fine - 0.5
    inside = (steps < middle).astype(float)
    for width in (2, 1, 1):
        inside = np.convolve(np.pad(inside, fine * width, "edge"), np.ones(fine * width), "same")
        inside = inside[fine * width : -fine * width] / (fine * width)
    column = inside[fine // 2 :: fine]
    z = np.exp(-0.5 * ((np.arange(size) - middle) / 1.2) ** 2)
    along = column[:, None, None] if axis == 0 else column[None, :, None]
    raster = np.rint(np.broadcast_to(along, (size,) * 3) * z * UNIT).astype(np.int64)
    at = np.arange(middle - half - 1, middle + half + 2)
    voxel = np.full((len(at), 3), middle)
    voxel[:, axis] = at
    for factor, last in ((1.01, middle), (0.99, middle - 1)):
        offset = factor * kernels.edge_offset(half)
        kind = surfaces(raster, voxel, 1.0, half, 1e-6, 0.5, 1.0, 0.5, offset)[3]
        assert at[kind > 0].tolist() == list(range(at[0], last + 1))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("reach", "share"), [(2, 0.0), (3, 0.6)])
def test_weaker_points_against_all_pairs(seed: int, reach: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    filled = rng.random((7, 6, 8)) < 0.3
    voxel = np.argwhere(filled)
    n = len(voxel)
    offset, normal = rng.uniform(-0.5, 0.5, (n, 3)), rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    value = rng.integers(1, 9, n) / 8
    row_of = np.full(filled.shape, -1, np.int32)
    row_of[tuple(voxel.T)] = np.arange(n)
    keep = kernels.drop_weaker(voxel, offset, normal, value, row_of, 2, reach, share)
    slow, edges = np.ones(n, np.bool_), np.zeros(n, np.bool_)
    for row in range(n):
        away = voxel + offset - voxel[row] - offset[row]
        apart = np.abs(voxel - voxel[row]).max(axis=1)
        cosine = np.abs(away @ normal[row]) >= math.sqrt(0.5) * np.linalg.norm(away, axis=1)
        others = np.arange(n) != row
        stronger = (value > value[row]) | ((value == value[row]) & (np.arange(n) < row))
        beside = value[(apart <= reach) & ((~cosine & others) | ~others)]
        edges[row] = value[row] < share * (beside @ beside) / beside.sum()
        slow[row] = not ((apart <= 2) & cosine & others & stronger).any() and not edges[row]
    assert np.array_equal(keep, slow)
    assert 0 < keep.sum() < n
    assert edges.any() == (share > 0)
