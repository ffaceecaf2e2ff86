"""Lines of sight beside plain numpy."""

import statistics
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.beams.rays import in_voxels, meet_planes, reach
from spl_batch.airborne.products.reflectance.shot_pattern import TERMS, motion, normal_equations

STEP_M = 0.001
seeds = st.integers(0, 10_000)


def scene(seed: int) -> tuple[Any, NDArray[np.float64], NDArray[np.float64]]:
    """Places in steps, in metres, and directions downwards."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 40))
    x, y = rng.integers(-(10**9), 10**9, (2, n))
    place = (x, y, rng.integers(-(10**6), 10**6, n).astype(np.int32))
    direction = rng.normal(size=(n, 3)) - (0.0, 0.0, 4.0)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return place, np.stack(place, axis=1) * STEP_M, direction


def starts_of(rng: np.random.Generator, n: int) -> NDArray[np.int64]:
    inner = np.flatnonzero(rng.random(n - 1) < 0.3) + 1
    return np.concatenate([[0], inner, [n]]).astype(np.int64)


@settings(deadline=None)
@given(seeds)
def test_box_around_pieces_of_lines(seed: int) -> None:
    place, metres, direction = scene(seed)
    near, far = np.sort(np.random.default_rng(seed).uniform(-99, 99, (2, len(metres))), axis=0)
    low, high = reach(place, STEP_M, direction, near, far)
    ends = np.stack([metres + d[:, None] * direction for d in (near, far)])
    np.testing.assert_array_equal(low, ends.min(axis=(0, 1)))
    np.testing.assert_array_equal(high, ends.max(axis=(0, 1)))


@settings(deadline=None)
@given(seeds, st.sampled_from([1, 7, 10_000]))
def test_voxel_and_place_in_it_add_up_to_the_point(seed: int, edge: int) -> None:
    place, _, _ = scene(seed)
    steps = np.stack(place, axis=1)
    corner = np.array([-3, 5, 2])
    voxel, point = np.empty(steps.shape, np.int64), np.empty(steps.shape)
    in_voxels(place, edge, corner, 0.5, voxel, point)
    np.testing.assert_array_equal(voxel, steps // edge - corner)
    np.testing.assert_array_equal(point, steps % edge - edge / 2)


@settings(deadline=None)
@given(seeds)
def test_beams_meet_the_plane_of_their_block(seed: int) -> None:
    rng = np.random.default_rng(seed)
    returns, origin, direction = scene(seed)
    start = starts_of(rng, len(origin))
    place, anchor = meet_planes(start, returns[2], STEP_M, origin, direction)
    for b, (first, end) in enumerate(pairwise(start)):
        level = statistics.median(z * STEP_M for z in returns[2][first:end].tolist())
        assert anchor[b, 2] == level
        for row in range(first, end):
            away = (level - origin[row, 2]) / direction[row, 2]
            met = [origin[row, axis] + away * direction[row, axis] for axis in (0, 1)]
            if row == first:
                assert anchor[b, :2].tolist() == [round(at) for at in met]
            assert place[row].tolist() == [met[axis] - anchor[b, axis] for axis in (0, 1)]


def test_without_returns_there_are_no_planes() -> None:
    none = np.zeros((0, 3))
    place, anchor = meet_planes(np.zeros(1, np.int64), np.zeros(0, np.int32), 1.0, none, none)
    assert place.shape == (0, 2)
    assert anchor.shape == (0, 3)


@settings(deadline=None)
@given(seeds)
def test_the_sensor_flies_straight_during_a_block(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, origin, _ = scene(seed)
    start = starts_of(rng, len(origin))
    tau = rng.choice(np.linspace(-1, 1, 9), len(origin))
    anchor = np.rint(origin[start[:-1]])
    found = np.empty((len(start) - 1, 2, 3))
    motion(start, tau, origin, anchor, found)
    for b, (low, high) in enumerate(pairwise(start)):
        t, at = tau[low:high], origin[low:high] - anchor[b]
        still = np.ptp(t) == 0.0
        line = np.polyfit(t, at, 0 if still else 1)[::-1]
        scale = np.abs(at).max() / (1.0 if still else np.ptp(t))
        np.testing.assert_allclose(found[b, 0], line[0], atol=1e-9 * scale)
        np.testing.assert_allclose(found[b, 1], 0.0 if still else line[1], atol=1e-9 * scale)


@settings(deadline=None)
@given(seeds)
def test_sums_of_the_fit_are_those_of_its_terms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = np.concatenate([[0], np.cumsum(rng.integers(0, 80, 3))])
    n, pattern = int(start[-1]), rng.uniform(-1, 1, (3, 5, 2))
    pattern[0, 2] = np.nan
    tau, channel = rng.uniform(-1, 1, n), rng.integers(0, 5, n).astype(np.uint8)
    place = rng.normal(size=(n, 2))
    matrix, right = np.empty((3, TERMS, TERMS)), np.empty((3, TERMS, 2))
    normal_equations((start, tau, channel, place), pattern, matrix, right)
    for b, (low, high) in enumerate(pairwise(start)):
        rows = np.arange(low, high)[~np.isnan(pattern[b, channel[low:high], 0])]
        t, (gx, gy) = tau[rows], pattern[b, channel[rows]].T
        terms = np.array([t**0, t, t**2, t**3, gx, gx * t, gy, gy * t])
        np.testing.assert_allclose(matrix[b], terms @ terms.T, atol=1e-9)
        np.testing.assert_allclose(right[b], terms @ place[rows], atol=1e-9)
