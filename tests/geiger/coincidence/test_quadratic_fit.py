"""Coincidence processing: polynomials, their maxima, and the test per detection."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.geiger.coincidence.surface import quadratic_fit as kernels
from spl_batch.geiger.coincidence.surface.posterior import log_odds
from spl_batch.geiger.coincidence.surface.voxel_raster import UNIT


def coefficients(raster: np.ndarray, half: int) -> np.ndarray:
    moment = np.empty(10, np.int64)
    kernels.moments(raster, half, half, half, half, moment)
    return kernels.fit_matrix(half) @ moment


def maximum(c: np.ndarray, ratio: float, reach: float) -> tuple[int, float, np.ndarray]:
    place = np.empty(3)
    scratch = np.empty(3), np.empty((3, 3))
    kind, value = kernels.closest_maximum(c, ratio, reach, *scratch, place)
    return kind, value, place


def polynomial(c: np.ndarray, p: np.ndarray) -> float:
    x, y, z = p
    return float(c @ [1, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 4))
def test_fit_against_least_squares(seed: int, half: int) -> None:
    raster = np.random.default_rng(seed).poisson(0.3, (2 * half + 1,) * 3) * 1000
    axis = np.arange(-half, half + 1)
    x, y, z = (a.ravel() for a in np.meshgrid(axis, axis, axis, indexing="ij"))
    m = np.stack([x**0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=-1)
    slow = np.linalg.lstsq(m.astype(float), raster.ravel().astype(float))[0]
    assert coefficients(raster, half) == pytest.approx(slow, abs=1e-6 * max(raster.max(), 1))


def turned(curvatures: list[float], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A Hessian of these eigenvalues, and its eigenvectors as rows."""
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return basis @ np.diag(curvatures) @ basis.T, basis.T


@pytest.mark.parametrize(
    ("curvatures", "kind", "maxima"),
    [
        ([0.0, 0.1, -2.0], kernels.SURFACE, [2]),
        ([-0.1, -0.3, -2.0], kernels.SURFACE, [2]),
        ([-0.1, -1.8, -2.0], kernels.RIDGE, [1, 2]),
        ([-1.7, -1.8, -2.0], kernels.PEAK, [0, 1, 2]),
        ([1.0, 2.0, 3.0], kernels.NOTHING, []),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_maxima_of_known_polynomials(
    curvatures: list[float], kind: int, maxima: list[int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    hessian, basis = turned(curvatures, rng)
    gradient = rng.uniform(-0.3, 0.3, 3)
    h = hessian
    c = np.array([5.0, *gradient, h[0, 0] / 2, h[1, 1] / 2, h[2, 2] / 2, h[0, 1], h[0, 2], h[1, 2]])
    found, value, place = maximum(c, 0.5, 10.0)
    assert found == kind
    if kind == kernels.NOTHING:
        return
    # The gradient is nothing along each maximum, the place lies in their span.
    slope = gradient + hessian @ place
    for k in range(3):
        if k in maxima:
            assert slope @ basis[k] == pytest.approx(0.0, abs=1e-9)
        else:
            assert place @ basis[k] == pytest.approx(0.0, abs=1e-9)
    assert value == pytest.approx(polynomial(c, place))
    if kind == kernels.PEAK:
        assert place == pytest.approx(-np.linalg.inv(hessian) @ gradient)  # [M20] Eq. 4
    far = float(np.abs(place).max())
    assert maximum(c, 0.5, far * 1.01)[0] == kind
    assert maximum(c, 0.5, far * 0.99)[0] == kernels.NOTHING


def test_a_level_surface_is_found_at_its_height() -> None:
    half, sigma, height = 3, 1.2, 0.3
    k = np.arange(-6, 7)
    layer = np.exp(-0.5 * ((k - height) / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    raster = np.rint(np.broadcast_to(layer * UNIT, (13, 13, 13))).astype(np.int64)
    voxel = np.array([[6, 6, z] for z in range(3, 10)])
    looks = np.full(7, 7**3 * 2 * UNIT)
    place, normal, value, kind = np.zeros((7, 3)), np.zeros((7, 3)), np.zeros(7), np.zeros(7, "u1")
    fit = kernels.fit_matrix(half)
    args = (raster, looks, voxel, half, fit, 0.05, 0.5, 0.5, 0.5, 9.0, place, normal, value, kind)
    kernels.find_surfaces(*args)
    # A parabola bends towards its own centre, so the voxel above claims the surface as well.
    assert kind.tolist() == [0, 0, 0, kernels.SURFACE, kernels.SURFACE, 0, 0]
    row_of, keep = np.full((13, 13, 13), -1, np.int32), np.empty(2, np.bool_)
    row_of[6, 6, 6:8] = [0, 1]
    found = (voxel[3:5], place[3:5], normal[3:5], value[3:5])
    kernels.drop_weaker(*found, row_of, half, half, 0.0, keep)
    assert keep.tolist() == [True, False]
    assert place[3] == pytest.approx([0, 0, height], abs=0.15)
    assert np.abs(normal[3]) == pytest.approx([0, 0, 1], abs=1e-6)
    # A parabola over seven layers flattens a peak of 0.33 / 2 detections per look.
    assert 0.1 < value[3] < 0.17
    kernels.find_surfaces(*args[:5], 0.2, *args[6:])
    assert not kind.any()
    kernels.find_surfaces(*args[:6], 2.5, *args[7:])
    assert not kind.any()


@pytest.mark.parametrize("half", [1, 2, 3, 4])
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
    raster = np.zeros((size, size, size))
    raster += column[:, None, None] if axis == 0 else column[None, :, None]
    raster = np.rint(raster * z * UNIT).astype(np.int64)
    at = np.arange(middle - half - 1, middle + half + 2)
    voxel = np.full((len(at), 3), middle)
    voxel[:, axis] = at
    n = len(at)
    place, normal, value, kind = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n, "u1")
    looks = np.full(n, (2 * half + 1) ** 3 * UNIT)
    offset = kernels.edge_offset(half)
    for factor, last in ((1.01, middle), (0.99, middle - 1)):
        kernels.find_surfaces(
            *(raster, looks, voxel, half, kernels.fit_matrix(half), 1e-6, 0.5, 1.0, 0.5),
            *(factor * offset, place, normal, value, kind),
        )
        assert at[kind > 0].tolist() == list(range(at[0], last + 1))


@pytest.mark.parametrize("height", np.linspace(-0.5, 0.5, 11))
def test_heights_are_drawn_to_the_centre_by_little(height: float) -> None:
    sigma, k = 1.17, np.arange(-8, 9)  # 5 cm and a bin of 5 cm in voxels of 4.5 cm
    layer = np.exp(-0.5 * ((k - height) / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    raster = np.rint(np.broadcast_to(layer * UNIT, (17, 17, 17))).astype(np.int64)
    c = coefficients(raster[6:11, 6:11, 6:11], 2)
    found = maximum(c, 0.5, 1.0)[2][2]
    assert abs(found - height) < 0.12
    assert abs(found) <= abs(height) + 1e-9


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("reach", "share"), [(2, 0.0), (3, 0.6)])
def test_weaker_points_against_all_pairs(seed: int, reach: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    filled = rng.random((7, 6, 8)) < 0.3
    voxel = np.argwhere(filled)
    n = len(voxel)
    place = rng.uniform(-0.5, 0.5, (n, 3))
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    value = rng.integers(1, 9, n) / 8
    row_of = np.full(filled.shape, -1, np.int32)
    row_of[tuple(voxel.T)] = np.arange(n)
    keep = np.empty(n, np.bool_)
    kernels.drop_weaker(voxel, place, normal, value, row_of, 2, reach, share, keep)
    slow = np.ones(n, np.bool_)
    edges = np.zeros(n, np.bool_)
    for row in range(n):
        away = voxel + place - voxel[row] - place[row]
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


@pytest.mark.parametrize(("beyond", "kept"), [(0.0, 11), (0.2, 14), (0.6, 15)])
def test_a_blurred_edge_ends_where_it_is(beyond: float, kept: int) -> None:
    """A level surface whose values fall over five voxels to what there is beyond its edge."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(20), np.arange(9), indexing="ij"))
    inside = np.clip((12.0 - x) / 5.0, 0.0, 1.0)  # half at 9.5, where the edge is
    value = inside + (1.0 - inside) * beyond
    x, y, value = (a[value > 0] for a in (x, y, value))
    voxel = np.stack([x, y, np.full_like(x, 2)], axis=-1)
    row_of = np.full((20, 9, 5), -1, np.int32)
    row_of[tuple(voxel.T)] = np.arange(len(voxel))
    keep = np.empty(len(voxel), np.bool_)
    up = np.tile([0.0, 0.0, 1.0], (len(voxel), 1))
    kernels.drop_weaker(voxel, 0.0 * up, up, value, row_of, 2, 3, 0.5, keep)
    middle = y == 4
    assert keep[middle & (x < 10)].all()
    # Of a surface that is five times darker one row is lost, of one of 0.6 nothing.
    assert keep[middle & (x < 15)].sum() == kept
    assert keep[middle & (x > 12)].all()


def test_log_odds_against_two_poisson_laws() -> None:
    from scipy.stats import poisson  # noqa: PLC0415

    k = np.arange(0, 6)
    window, noise, surface, prior = 5, 4.5e-7, 0.05, 1e-3
    looks = np.full(6, 300.0)
    out = np.empty(6)
    detections, passed = ((k + 1) * UNIT).astype(np.int64), (looks * UNIT).astype(np.int64)
    log_odds(detections, passed, window, noise, surface, prior, out)
    alone = noise * looks
    both = alone + surface * looks / window
    slow = math.log(prior / (1 - prior)) + poisson.logpmf(k, both) - poisson.logpmf(k, alone)
    assert out == pytest.approx(slow, rel=1e-9)
    assert out[0] < 0 < out[2]
