"""Surfaces and normals: kernels against slow twins, chains against surfaces that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import polynomial

from spl_batch.geiger.water.accuracy import (
    angles_deg,
    floor_error,
    middle,
    pixel_maps,
    pixel_sums,
    surface_error,
)
from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, refracted, view_of
from spl_batch.geiger.water.ranges import Calibration, Gate, Hits
from spl_batch.geiger.water.settings import (
    AdaptiveSettings,
    CalibrationSettings,
    CameraSettings,
    MountSettings,
    PixelSettings,
    SurfaceSettings,
    WindowedSettings,
)
from spl_batch.geiger.water.simulate import (
    Target,
    Wave,
)
from spl_batch.geiger.water.surface import (
    denoised,
    growing_windows,
    make_surface,
    planes,
    shrunk_polynomial,
    window_median,
)
from spl_batch.geiger.water.tasks import grid_around, height_raster, known_points

CAMERA = CameraSettings(last_rows_unused=0)
VIEW = view_of(CAMERA, MountSettings(position_m=(1.0, 2.0, -3.0)))
EXACT = Calibration(
    CalibrationSettings(range_walk="none", scale=1.0, offset_ns=0.0), np.zeros((32, 32))
)
WINDOWED = SurfaceSettings(method="windowed")


def exact_hits(range_m: np.ndarray) -> Hits:
    """Hits whose mean is a range, to a millionth of a bin."""
    many = np.full((32, 32), 1_000_000, dtype=np.int64)
    bins = range_m / HALF_C_M_NS / CAMERA.bin_ns
    total = np.rint(bins * many).astype(np.int64)
    return Hits(1_000_000, Gate(0, 8000), many, total, total**2 // many, 0 * many)


def a_plane(normal: np.ndarray, down_m: float) -> np.ndarray:
    """Range of each pixel to a plane below the origin."""
    point = np.array([VIEW.origin_m[0] + 1.0, VIEW.origin_m[1], down_m])
    return ((point - VIEW.origin_m) @ normal) / (VIEW.look @ normal)


def slow_plane(
    value: np.ndarray, weight: np.ndarray, x: np.ndarray, y: np.ndarray, half: int, at: tuple
) -> tuple[np.ndarray, np.ndarray] | None:
    """Plane and standard deviations of one window, by numpy's least squares."""
    i, j = at
    box = np.s_[max(i - half, 0) : i + half + 1, max(j - half, 0) : j + half + 1]
    known = weight[box] > 0
    dx, dy = (v[box][known] - v[at] for v in (x, y))
    design = np.stack([np.ones(len(dx)), dx, dy], axis=1)
    root = np.sqrt(weight[box][known])
    if np.linalg.matrix_rank(design) < 3:
        return None
    fit = np.linalg.lstsq(design * root[:, None], value[box][known] * root)[0]
    normal = (design * root[:, None]).T @ (design * root[:, None])
    return fit, np.sqrt(np.diag(np.linalg.inv(normal)))


@given(st.integers(0, 1000), st.sampled_from([1, 2, 9]))
@settings(max_examples=10, deadline=None)
def test_planes_are_least_squares(seed: int, half: int) -> None:
    rng = np.random.default_rng(seed)
    north, east = np.mgrid[0:7, 0:6] + 0.1 * rng.standard_normal((2, 7, 6))
    down, weight = rng.standard_normal((7, 6)), rng.uniform(1, 3, (7, 6))
    weight[rng.random((7, 6)) < 0.3] = 0.0
    plane, spread = planes(down, weight, north, east, half)
    for at in np.ndindex(7, 6):
        slow = slow_plane(down, weight, north, east, half, at)
        if slow is None:
            assert np.isnan(plane[at]).all()
        elif np.isfinite(plane[at]).all():
            np.testing.assert_allclose(plane[at], slow[0], atol=1e-7)
            np.testing.assert_allclose(spread[at], slow[1], rtol=1e-7)
        else:
            assert half == 1, "only a line has no plane"


@given(st.integers(0, 1000), st.sampled_from([0.7, 2.5]))
@settings(max_examples=8, deadline=None)
def test_windows_grow_while_their_intervals_agree(seed: int, agreement: float) -> None:
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0:8, 0:9].astype(float)
    value = 0.1 * row - 0.3 * col + 2.0 * (col > 5) + 0.1 * rng.standard_normal((8, 9))
    weight = rng.uniform(50, 150, (8, 9)) * (rng.random((8, 9)) < 0.9)
    halves = [1, 2, 4, 9]
    plane = growing_windows(value, weight, halves, agreement)
    for at in np.ndindex(8, 9):
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        found = [np.nan] * 3
        for half in halves:
            slow = slow_plane(value, weight, col, row, half, at)
            if slow is None:
                continue
            fit, spread = slow
            low = np.maximum(low, fit - agreement * spread)
            high = np.minimum(high, fit + agreement * spread)
            if low[0] <= high[0]:
                found[0] = fit[0]
            if (low[1:] <= high[1:]).all():
                found[1:] = list(fit[1:])
        np.testing.assert_allclose(plane[at], found, atol=1e-9)


def test_the_polynomial_is_exact_where_nothing_is_noisy() -> None:
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-0.8, 0.8, 15))
    numbers = rng.standard_normal((4, 4)) * (np.add.outer(np.arange(4), np.arange(4)) < 4)
    value = 5 + polynomial.polyval2d(x, y, numbers)
    found = shrunk_polynomial(value, np.full(x.shape, 1e14), x, y, 4)
    np.testing.assert_allclose(found[..., 0], value, atol=1e-6)
    slope = polynomial.polyval2d(x, y, polynomial.polyder(numbers, axis=0))
    np.testing.assert_allclose(found[..., 1], slope, atol=1e-5)
    slope = polynomial.polyval2d(x, y, polynomial.polyder(numbers, axis=1))
    np.testing.assert_allclose(found[..., 2], slope, atol=1e-5)
    assert not shrunk_polynomial(value, np.full(x.shape, 1.0), x, y, 0).any()
    few = np.where(np.arange(x.size).reshape(x.shape) < 5, 1.0, 0.0)
    assert not shrunk_polynomial(value, few, x, y, 4).any()


def test_noise_buys_no_curvature() -> None:
    rng = np.random.default_rng(8)
    x, y = np.meshgrid(np.linspace(-1, 1, 30), np.linspace(-1, 1, 30))
    bent = []
    for _ in range(20):
        value = 3.0 + 0.2 * x + 0.01 * rng.standard_normal(x.shape)
        found = shrunk_polynomial(value, np.full(x.shape, 1e4), x, y, 6)
        plane = shrunk_polynomial(value, np.full(x.shape, 1e4), x, y, 1)
        bent.append(np.abs(found - plane).max())
    assert np.median(bent) < 0.01, "a free polynomial of this order bends by 0.05"


@pytest.mark.parametrize("method", ["adaptive", "windowed"])
@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.1, -0.2, -1.0)])
def test_planes_are_found_exactly(method: str, normal: tuple[float, ...]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    range_m = a_plane(n, 0.4)
    way = SurfaceSettings(method=method, windowed=WindowedSettings(strength_m=1e-6))
    dead = np.zeros((32, 32), dtype=bool)
    dead[4, 5] = dead[20:23, 7] = True
    made = make_surface(exact_hits(range_m), dead, EXACT, VIEW, CAMERA, PixelSettings(), way)
    inner = np.s_[4:-4, 4:-4]
    # Mirrored medians and means bend the rim, and level a slope inside by nothing.
    part = np.s_[:, :] if method == "adaptive" else inner
    sound = ~dead[part] if method == "adaptive" else slice(None)
    angle = angles_deg(made.normals[part], np.broadcast_to(n, (32, 32, 3))[part])
    if method == "adaptive" or normal[0] == 0:
        assert np.nanmax(angle[sound]) < 0.01
        error = np.abs(made.points_m - VIEW.points(range_m))[part]
        assert np.nanmax(error[sound]) < 1e-4
    assert np.isfinite(made.normals).all(), "dead pixels are lent a point"


def test_a_pixel_far_off_takes_no_part() -> None:
    n = np.array([0.0, 0.0, -1.0])
    hits = exact_hits(a_plane(n, 0.4))
    hits.total[10, 10] += 40 * hits.hits[10, 10]
    hits.square[10, 10] = hits.total[10, 10] ** 2 // hits.hits[10, 10]
    dead = np.zeros((32, 32), dtype=bool)
    made = make_surface(hits, dead, EXACT, VIEW, CAMERA, PixelSettings(), SurfaceSettings())
    assert angles_deg(made.normals, np.broadcast_to(n, (32, 32, 3))).max() < 0.01
    loose = SurfaceSettings(adaptive=AdaptiveSettings(outlier=1e9))
    unsure = Calibration(EXACT.settings, EXACT.pixel_ns, residual_ns=10.0)
    for calibration, way in ((EXACT, loose), (unsure, SurfaceSettings())):
        made = make_surface(hits, dead, calibration, VIEW, CAMERA, PixelSettings(), way)
        assert angles_deg(made.normals, np.broadcast_to(n, (32, 32, 3))).max() > 0.1


@pytest.mark.parametrize("way", [SurfaceSettings(), WINDOWED])
def test_nothing_is_made_of_nothing(way: SurfaceSettings) -> None:
    nothing = np.zeros((32, 32), dtype=np.int64)
    hits = Hits(200, Gate(100, 147), nothing, nothing, nothing, nothing)
    made = make_surface(hits, nothing > 0, EXACT, VIEW, CAMERA, PixelSettings(), way)
    assert np.isnan(made.points_m).all()
    assert np.isnan(made.normals).all()
    found = (made.points_m, made.normals)
    assert surface_error(*found, np.zeros((32, 32)), np.zeros((32, 32, 3)))[0].pixels == 0
    assert np.isnan(floor_error(VIEW.look, found, found, 6.0, 1.33)).all()
    assert not len(known_points(made.points_m, (1.0, 2.0, 3.0)))


def test_medians_are_those_of_their_windows() -> None:
    image = np.random.default_rng(9).standard_normal((7, 8))
    image[2:4, 3] = np.nan
    found = window_median(image, 1)
    assert found[3, 3] == np.median([v for v in image[2:5, 2:5].ravel() if np.isfinite(v)])
    corner = [image[0, 0]] * 4 + [image[0, 1]] * 2 + [image[1, 0]] * 2 + [image[1, 1]]
    assert found[0, 0] == np.median(corner), "edges are mirrored"
    assert np.isnan(window_median(np.full((4, 4), np.nan), 1)).all()


def test_non_local_means_weigh_patches_as_the_source_says() -> None:
    image = np.random.default_rng(10).standard_normal((12, 12)) * 0.01
    settings = WindowedSettings(search=5, patch=3, strength_m=0.01)
    padded = np.pad(image, 6, mode="reflect")
    near = [(12 + di, 13 + dj) for di in range(-2, 3) for dj in range(-2, 3)]
    off = [((padded[i : i + 2, j : j + 2] - padded[12:14, 13:15]) ** 2).sum() for i, j in near]
    weight = np.exp(-np.array(off) / 9 / 0.01**2)
    # scikit-image counts a pixel itself twice, and takes a quick exponential.
    weight[12] *= 2
    expected = np.average([padded[at] for at in near], weights=weight)
    assert denoised(image, settings)[6, 7] == pytest.approx(expected, abs=2e-4)
    assert np.isnan(denoised(np.where(image == image[3, 3], np.nan, image), settings)[3, 3])


def test_errors_are_the_source_s() -> None:
    rng = np.random.default_rng(11)
    points = np.zeros((5, 6, 3))
    points[..., 2] = 2.0 + 0.01 * rng.standard_normal((5, 6))
    normals = rng.standard_normal((5, 6, 3)) * 0.1 + [0, 0, -1]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points[0, 0] = np.nan
    true = np.full((5, 6), 1.995), np.broadcast_to([0.0, 0.0, -1.0], (5, 6, 3))
    made, error, angle = surface_error(points, normals, *true)
    down = points[..., 2][np.isfinite(points[..., 2])]
    assert made.bias_m == pytest.approx(down.mean() - 1.995)
    assert made.variance_m2 == pytest.approx(((down - down.mean()) ** 2).mean())
    assert made.mse_m2 == pytest.approx(((down - 1.995) ** 2).mean())
    mean = normals.reshape(-1, 3)[1:].mean(axis=0)
    assert made.normal_deg == pytest.approx(np.degrees(np.arccos(-mean[2] / np.linalg.norm(mean))))
    each = np.degrees(np.arccos(-normals[..., 2])).ravel()[1:]
    assert made.pixel_normal_deg == pytest.approx(each.mean())
    assert made.pixels == 29
    maps = pixel_maps(pixel_sums(error, angle) + pixel_sums(error + 0.01, angle))
    np.testing.assert_allclose(maps["bias_m"][1:], error[1:] + 0.005)
    np.testing.assert_allclose(maps["variance_m2"][1:], 0.005**2, rtol=1e-6)
    assert np.isnan(maps["normal_deg"][0, 0])


def test_floor_errors_vanish_for_the_true_surface() -> None:
    target = Target(down_m=0.8, waves=(Wave(amplitude_m=0.05, length_m=1.5, heading_deg=30.0),))
    range_m, normals = target.meet(VIEW, 0.3)
    true = VIEW.points(range_m), normals
    made = floor_error(VIEW.look, true, true, 6.0, 1.33)
    assert made.refracted_m == pytest.approx(0)
    assert made.refracted_beam_m == pytest.approx(0)
    deep = floor_error(VIEW.look, (true[0] + [0.0, 0.0, 0.1], normals), true, 6.0, 1.33)
    assert deep.refracted_m == pytest.approx(0.1)
    level = refracted(VIEW.look, np.array([0.0, 0.0, -1.0]), 1.33)
    ends = 6.0 * (level - refracted(VIEW.look, normals, 1.33))
    assert made.level_m == pytest.approx(np.linalg.norm(ends, axis=-1).mean())
    assert made.straight_m > made.level_m > 0.02
    assert middle((32, 32), 16) == (slice(8, 24), slice(8, 24))
    assert middle((5, 9), 16) == (slice(0, 5), slice(0, 9))


def test_rasters_interpolate_the_surface_on_an_absolute_grid() -> None:
    n = np.array([0.05, -0.1, -1.0])
    n /= np.linalg.norm(n)
    points = VIEW.points(a_plane(n, 0.4))
    known = known_points(points, (0.0, 0.0, 0.0))
    grid = grid_around(known, 0.01)
    assert grid.east * 0.01 <= points[..., 1].min() < (grid.east + 1) * 0.01
    assert (grid.north + grid.rows) * 0.01 > points[..., 0].max()
    height = height_raster(known, grid)
    centre_n = (grid.north + np.arange(grid.rows) + 0.5) * 0.01
    centre_e = (grid.east + np.arange(grid.cols) + 0.5) * 0.01
    plane = points[16, 16]
    expected = (
        -plane[2] - ((centre_n[:, None] - plane[0]) * n[0] + (centre_e - plane[1]) * n[1]) / -n[2]
    )
    filled = np.isfinite(height)
    assert filled.mean() > 0.75
    # Outside the triangles, the rim takes the nearest pixel's height.
    assert np.median(np.abs(height - expected)[filled]) < 1e-9
    assert np.abs(height - expected)[filled].max() < 0.004
    # Cells of a local frame that begins elsewhere are the same.
    away = known_points(points + np.array([0.125, -0.25, 7.0]), (0.25, -0.125, 7.0))
    assert grid_around(away, 0.01) == grid
    np.testing.assert_allclose(height_raster(away, grid)[filled], height[filled], atol=1e-6)
