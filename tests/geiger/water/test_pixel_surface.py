"""Surfaces and normals: kernels against slow twins, chains against surfaces that are known."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import polynomial

from spl_batch.geiger.water.accuracy import (
    PixelSums,
    angles_deg,
    floor_error,
    middle,
    surface_error,
)
from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, view_of
from spl_batch.geiger.water.ranges.calibration import Calibration
from spl_batch.geiger.water.ranges.hits import Gate, Hits, add_up
from spl_batch.geiger.water.settings import (
    AdaptiveSettings,
    CalibrationSettings,
    CameraSettings,
    MountSettings,
    PixelSettings,
    SurfaceSettings,
    WindowedSettings,
)
from spl_batch.geiger.water.simulate.frames import (
    Instrument,
    Target,
    Wave,
    acquisitions,
    build_array,
)
from spl_batch.geiger.water.surface.pixel_surface import denoised, make_surface, window_median
from spl_batch.geiger.water.surface.polynomial_trend import shrunk_polynomial
from spl_batch.geiger.water.surface.raster import Grid, grid_around, height_raster
from spl_batch.geiger.water.surface.refraction import refracted
from spl_batch.geiger.water.surface.window_planes import fixed_windows, growing_windows

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


@given(st.integers(0, 1000), st.sampled_from([1, 2]))
@settings(max_examples=10, deadline=None)
def test_fixed_windows_are_least_squares(seed: int, half: int) -> None:
    rng = np.random.default_rng(seed)
    north, east = np.mgrid[0:7, 0:6] + 0.1 * rng.standard_normal((2, 7, 6))
    down = rng.standard_normal((7, 6))
    down[rng.random((7, 6)) < 0.3] = np.nan
    out = np.empty((7, 6, 3))
    fixed_windows(north, east, down, half, out)
    for i, j in np.ndindex(7, 6):
        box = np.s_[max(i - half, 0) : i + half + 1, max(j - half, 0) : j + half + 1]
        known = np.isfinite(down[box])
        if np.isnan(down[i, j]) or known.sum() < 3:
            assert np.isnan(out[i, j]).all()
            continue
        design = np.stack([np.ones(known.sum()), north[box][known], east[box][known]], axis=1)
        c, a, b = np.linalg.lstsq(design, down[box][known])[0]
        if np.isfinite(out[i, j]).all():
            expected = [c + a * north[i, j] + b * east[i, j], a, b]
            np.testing.assert_allclose(out[i, j], expected, atol=1e-8)
        else:
            spread = np.linalg.svd(design[:, 1:] - design[:, 1:].mean(axis=0))[1]
            assert spread[1] < 0.05 * spread[0], "only a line has no plane"


def slow_growth(
    value: np.ndarray, weight: np.ndarray, halves: list[int], agreement: float, at: tuple[int, int]
) -> tuple[list[float], list[int]]:
    """What :func:`growing_windows` does for one pixel, with numpy's least squares."""
    i, j = at
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    found, used, agree = [np.nan] * 3, [0, 0], [True, True]
    for half in halves:
        box = np.s_[max(i - half, 0) : i + half + 1, max(j - half, 0) : j + half + 1]
        rows, cols = np.nonzero(weight[box] > 0)
        design = np.stack([np.ones(len(rows)), cols, rows], axis=1).astype(float)
        design[:, 1] += max(j - half, 0) - j
        design[:, 2] += max(i - half, 0) - i
        w = weight[box][rows, cols]
        normal = (design * w[:, None]).T @ design
        if np.linalg.matrix_rank(design) < 3:
            continue
        fit = np.linalg.solve(normal, (design * w[:, None]).T @ value[box][rows, cols])
        spread = np.sqrt(np.diag(np.linalg.inv(normal)))
        low, high = (
            np.maximum(low, fit - agreement * spread),
            np.minimum(high, fit + agreement * spread),
        )
        fine = low <= high
        agree = [agree[0] and fine[0], agree[1] and fine[1:].all()]
        if agree[0]:
            found[0], used[0] = fit[0], half
        if agree[1]:
            found[1:], used[1] = list(fit[1:]), half
        if not any(agree) or half >= max(value.shape):
            break
    return found, used


@given(st.integers(0, 1000), st.sampled_from([0.7, 2.5]))
@settings(max_examples=8, deadline=None)
def test_growing_windows_are_those_of_numpy(seed: int, agreement: float) -> None:
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[0:8, 0:9]
    value = 0.1 * row - 0.3 * col + 2.0 * (col > 5) + 0.1 * rng.standard_normal((8, 9))
    weight = rng.uniform(50, 150, (8, 9)) * (rng.random((8, 9)) < 0.9)
    halves = [1, 2, 4, 9]
    out, used = np.empty((8, 9, 3)), np.empty((8, 9, 2), dtype=np.int64)
    growing_windows(value, weight, np.array(halves), agreement, out, used)
    for at in np.ndindex(8, 9):
        found, chosen = slow_growth(value, weight, halves, agreement, at)
        np.testing.assert_allclose(out[at], found, atol=1e-9)
        assert list(used[at]) == chosen


def test_windows_stay_off_an_edge() -> None:
    row, col = np.mgrid[0:20, 0:20]
    value = np.where(col < 10, 0.2 * row, 50.0 - 0.1 * row)
    out, used = np.empty((20, 20, 3)), np.empty((20, 20, 2), dtype=np.int64)
    growing_windows(value, np.full((20, 20), 1e4), np.array([1, 2, 4, 8, 16]), 4.0, out, used)
    assert used[10, 2, 1] == 4, "seven columns away from the edge"
    assert out[10, 2, 2] == pytest.approx(0.2)
    assert out[10, 17, 2] == pytest.approx(-0.1)


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
        error = np.abs(made.places_m - VIEW.places(range_m))[part]
        assert np.nanmax(error[sound]) < 1e-4
    assert np.isfinite(made.normals).all(), "dead pixels are lent a place"


def test_a_pixel_far_off_takes_no_part() -> None:
    n = np.array([0.0, 0.0, -1.0])
    hits = exact_hits(a_plane(n, 0.4))
    hits.total[10, 10] += 40 * hits.hits[10, 10]
    hits.square[10, 10] = hits.total[10, 10] ** 2 // hits.hits[10, 10]
    dead = np.zeros((32, 32), dtype=bool)
    made = make_surface(hits, dead, EXACT, VIEW, CAMERA, PixelSettings(), SurfaceSettings())
    assert angles_deg(made.normals, np.broadcast_to(n, (32, 32, 3))).max() < 0.01
    loose = SurfaceSettings(adaptive=AdaptiveSettings(outlier=1e9))
    made = make_surface(hits, dead, EXACT, VIEW, CAMERA, PixelSettings(), loose)
    assert angles_deg(made.normals, np.broadcast_to(n, (32, 32, 3))).max() > 0.1


def test_nothing_is_made_of_nothing() -> None:
    nothing = np.zeros((32, 32), dtype=np.int64)
    hits = Hits(200, Gate(100, 147), nothing, nothing, nothing, nothing)
    for way in (SurfaceSettings(), WINDOWED):
        dead = np.zeros((32, 32), dtype=bool)
        made = make_surface(hits, dead, EXACT, VIEW, CAMERA, PixelSettings(), way)
        assert np.isnan(made.places_m).all()
        assert np.isnan(made.normals).all()
        true = np.zeros((32, 32)), np.zeros((32, 32, 3))
        error, _, _ = surface_error(made.places_m, made.normals, *true)
        assert error.pixels == 0
        found = (made.places_m, made.normals)
        assert floor_error(VIEW.look, found, found, 6.0, 1.33) is None
        assert grid_around(made.places_m, 0.01) is None


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
    found = denoised(image, settings)
    padded = np.pad(image, 6, mode="reflect")
    at = (6, 7)
    own = padded[at[0] + 6 : at[0] + 8, at[1] + 6 : at[1] + 8]
    weights, total = 0.0, 0.0
    for di in range(-2, 3):
        for dj in range(-2, 3):
            i, j = at[0] + di + 6, at[1] + dj + 6
            patch = padded[i : i + 2, j : j + 2]
            weight = np.exp(-((patch - own) ** 2).sum() / 9 / 0.01**2)
            # scikit-image counts a pixel itself twice, and takes a quick exponential.
            weight *= 2 if di == dj == 0 else 1
            weights, total = weights + weight, total + weight * padded[i, j]
    assert found[at] == pytest.approx(total / weights, abs=2e-4)
    assert np.isnan(denoised(np.where(image == image[3, 3], np.nan, image), settings)[3, 3])


def test_errors_are_the_source_s() -> None:
    rng = np.random.default_rng(11)
    places = np.zeros((5, 6, 3))
    places[..., 2] = 2.0 + 0.01 * rng.standard_normal((5, 6))
    normals = rng.standard_normal((5, 6, 3)) * 0.1 + [0, 0, -1]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    places[0, 0] = np.nan
    true = np.full((5, 6), 1.995), np.broadcast_to([0.0, 0.0, -1.0], (5, 6, 3))
    made, error, angle = surface_error(places, normals, *true)
    down = places[..., 2][np.isfinite(places[..., 2])]
    assert made.bias_m == pytest.approx(down.mean() - 1.995)
    assert made.variance_m2 == pytest.approx(((down - down.mean()) ** 2).mean())
    assert made.mse_m2 == pytest.approx(((down - 1.995) ** 2).mean())
    mean = normals.reshape(-1, 3)[1:].mean(axis=0)
    assert made.normal_deg == pytest.approx(np.degrees(np.arccos(-mean[2] / np.linalg.norm(mean))))
    each = np.degrees(np.arccos(-normals[..., 2])).ravel()[1:]
    assert made.pixel_normal_deg == pytest.approx(each.mean())
    assert made.pixels == 29
    sums, again = PixelSums.empty((5, 6)), PixelSums.empty((5, 6))
    sums.add(error, angle)
    again.add(error + 0.01, angle)
    sums.merge(again)
    maps = sums.maps()
    np.testing.assert_allclose(maps["bias_m"][1:], error[1:] + 0.005)
    np.testing.assert_allclose(maps["variance_m2"][1:], 0.005**2, rtol=1e-6)
    assert np.isnan(maps["normal_deg"][0, 0])


def test_floor_errors_vanish_for_the_true_surface() -> None:
    target = Target(0.8, (Wave(0.05, 1.5, 30.0),))
    range_m, normals = target.meet(VIEW, 0.3)
    true = VIEW.places(range_m), normals
    made = floor_error(VIEW.look, true, true, 6.0, 1.33)
    assert made is not None
    assert made.refracted_m == pytest.approx(0)
    assert made.refracted_beam_m == pytest.approx(0)
    level = refracted(VIEW.look, np.array([0.0, 0.0, -1.0]), 1.33)
    ends = 6.0 * (level - refracted(VIEW.look, normals, 1.33))
    assert made.level_m == pytest.approx(np.linalg.norm(ends, axis=-1).mean())
    assert made.straight_m > made.level_m > 0.02
    assert middle((32, 32), 16) == (slice(8, 24), slice(8, 24))
    assert middle((5, 9), 16) == (slice(0, 5), slice(0, 9))


def test_rasters_interpolate_the_surface_on_an_absolute_grid() -> None:
    n = np.array([0.05, -0.1, -1.0])
    n /= np.linalg.norm(n)
    places = VIEW.places(a_plane(n, 0.4))
    grid = grid_around(places, 0.01)
    assert grid is not None
    assert grid.east * 0.01 <= places[..., 1].min() < (grid.east + 1) * 0.01
    assert (grid.north + grid.rows) * 0.01 > places[..., 0].max()
    height = height_raster(places, grid)
    centre_n = (grid.north + np.arange(grid.rows) + 0.5) * 0.01
    centre_e = (grid.east + np.arange(grid.cols) + 0.5) * 0.01
    plane = places[16, 16]
    expected = (
        -plane[2] - ((centre_n[:, None] - plane[0]) * n[0] + (centre_e - plane[1]) * n[1]) / -n[2]
    )
    known = np.isfinite(height)
    assert known.mean() > 0.75
    # Outside the triangles, the rim takes the nearest pixel's height.
    assert np.median(np.abs(height - expected)[known]) < 1e-9
    assert np.abs(height - expected)[known].max() < 0.004
    wider = height_raster(
        places, Grid(grid.east - 3, grid.north - 2, grid.rows + 5, grid.cols + 9, 0.01)
    )
    inner = wider[2 : 2 + grid.rows, 3 : 3 + grid.cols]
    both = np.isfinite(inner) & known
    np.testing.assert_allclose(inner[both], height[both], atol=1e-9)


@given(
    away=st.tuples(st.integers(-(2**24), 2**24), st.integers(-(2**24), 2**24)),
    cell_m=st.sampled_from([0.005, 0.01, 0.1, 0.3]),
)
def test_cells_lie_where_they_do_wherever_the_local_frame_begins(
    away: tuple[int, int], cell_m: float
) -> None:
    places = VIEW.places(a_plane(np.array([0.05, -0.1, -1.0]), 0.4))
    moved = places + np.array([0.125, -0.25, 0.0])
    east, north = (v / 8.0 for v in away)
    origin = (east + 0.25, north - 0.125)
    grid, other = grid_around(places, cell_m, (east, north)), grid_around(moved, cell_m, origin)
    assert grid is not None
    assert grid.east == math.floor((places[..., 1].min() + east) / cell_m)
    assert grid.north == math.floor((places[..., 0].min() + north) / cell_m)
    assert other == dataclasses.replace(grid, origin_m=origin)
    height, again = height_raster(places, grid), height_raster(moved, other)
    both = np.isfinite(height) & np.isfinite(again)
    assert both.sum() >= 0.98 * np.isfinite(height).sum() > 0
    assert np.median(np.abs(height - again)[both]) < 1e-6


def test_ours_beats_the_source_s_way_on_the_same_frames() -> None:
    instrument = Instrument(delay_ns=0.0, pattern_ns=0.0, scale=1.0, offset_ns=80.0)
    known = CalibrationSettings(scale=1.0, offset_ns=80.0 - 0.125, pulse_ns=1.0)
    exact = Calibration(known, np.zeros((32, 32)))
    dead = build_array(instrument, CAMERA).dead
    for target in (Target(0.1), Target(0.1, (Wave(0.02, 0.6, 40.0),))):
        found = []
        for acquired in acquisitions(target, instrument, CAMERA, VIEW, 2, 200, 12):
            hits = add_up(acquired.frames, Gate(390, 437))
            true = acquired.true_down_m, acquired.true_normals
            row = []
            for way in (WINDOWED, SurfaceSettings()):
                made = make_surface(hits, dead, exact, VIEW, CAMERA, PixelSettings(), way)
                row.append(surface_error(made.places_m, made.normals, *true)[0].pixel_normal_deg)
            found.append(row)
        source, ours = np.mean(found, axis=0)
        assert ours < 0.5 * source
        assert ours < 4.5
