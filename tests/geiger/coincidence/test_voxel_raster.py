"""Detections and looks on the voxel raster."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import convolve

from spl_batch.geiger.coincidence.surface import voxel_raster as kernels
from spl_batch.geiger.coincidence.surface.voxel_raster import STEPS, UNIT

EDGE_M = 0.045
FAR_CORNER = np.array([11_111_000, 93_333_000, 2_200])


def raster_of(xyz: np.ndarray, corner: np.ndarray, shape: tuple[int, ...], edge: int) -> np.ndarray:
    raster = np.zeros(shape, np.int64)
    kernels.deposit_all(xyz, edge, corner, raster)
    return raster


def tents(xyz: np.ndarray, corner: np.ndarray, shape: tuple[int, ...], edge: int) -> np.ndarray:
    """Tent functions of all points at all voxel centres, rounded to parts of an edge."""
    total = np.zeros(shape)
    for p in xyz.tolist():
        steps = [math.floor(Fraction(v * STEPS, edge) - Fraction(STEPS - 1, 2)) for v in p]
        at = np.array(steps) / STEPS - corner
        x, y, z = (
            np.maximum(0.0, 1.0 - np.abs(np.arange(n) - q)) for n, q in zip(shape, at, strict=True)
        )
        total += np.einsum("i,j,k->ijk", x, y, z)
    return total * UNIT


@settings(deadline=None, max_examples=25)
@given(
    st.integers(0, 10_000),
    # Edges with many factors of two put positions on the boundaries between steps.
    st.sampled_from([5, 45, 64, 128]),
    st.tuples(*[st.integers(-(10**8), 10**8)] * 3),
    st.tuples(*[st.integers(0, 4)] * 3),
)
def test_weights_are_tents_anywhere_whatever_a_raster_is_cut_from(
    seed: int, edge: int, far: tuple[int, int, int], cut: tuple[int, int, int]
) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.integers(-edge, 8 * edge, (20, 3)) + np.array(far) * edge
    whole = raster_of(xyz, np.array(far) - 2, (13, 12, 13), edge)
    assert whole.sum() == 20 * UNIT
    assert whole == pytest.approx(tents(xyz, np.array(far) - 2, whole.shape, edge), abs=1e-6)
    part = raster_of(rng.permutation(xyz), np.array(far) + cut - 1, (5, 6, 7), edge)
    i, j, k = np.array(cut) + 2
    assert np.array_equal(part[1:-1, 1:-1, 1:-1], whole[i : i + 3, j : j + 4, k : k + 5])


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000), st.integers(0, 3))
def test_box_sum_against_convolution(seed: int, half: int) -> None:
    rng = np.random.default_rng(seed)
    raster = rng.integers(0, 1000, tuple(rng.integers(1, 9, 3)))
    cube = np.ones((2 * half + 1,) * 3, np.int64)
    assert np.array_equal(kernels.box_sum(raster, half), convolve(raster, cube, mode="constant"))


def samples(
    origin: NDArray[np.float64], turn: NDArray[np.float64], seen: NDArray[np.float32],
    gate: tuple[float, float],
) -> list[NDArray[np.float64]]:  # fmt: skip
    """Points of all samples of all looks, one after the other."""
    found = []
    for frame, row, column in np.ndindex(seen.shape):
        across = (row - (seen.shape[1] - 1) / 2) * 0.02
        along = (column - (seen.shape[2] - 1) / 2) * 0.02
        way = turn[frame] @ [across, along, -1.0]
        way /= np.linalg.norm(way)
        for k in range(int(gate[0] / EDGE_M), int(gate[1] / EDGE_M) + 1):
            middle = (k + 0.5) * EDGE_M
            last = min(seen[frame, row, column], gate[1])
            if gate[0] <= middle < gate[1] and k * EDGE_M <= last:
                found.append(origin[frame] + middle * way)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_looks_against_every_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    up = rng.normal(size=(3, 3)) * 0.1 + [0, 0, 1]
    up /= np.linalg.norm(up, axis=1)[:, None]
    nose = np.cross(up, rng.normal(size=(3, 3)))
    nose /= np.linalg.norm(nose, axis=1)[:, None]
    turn = np.stack([np.cross(nose, up), nose, up], axis=-1)
    origin = (FAR_CORNER + 4.5) * EDGE_M + 3.0 * up + rng.normal(size=(3, 3)) * 0.05
    seen = np.where(rng.random((3, 4, 5)) < 0.5, np.inf, rng.uniform(2.7, 3.3, (3, 4, 5)))
    seen = seen.astype(np.float32)
    raster, slow = np.zeros((2, 9, 8, 10), np.int64)
    gate = np.array([2.9, 3.15])
    kernels.interrogate(origin, turn, seen, 0.02, gate, EDGE_M, FAR_CORNER, raster)
    for point in samples(origin, turn, seen, (2.9, 3.15)):
        u, v, w = (math.floor(p * STEPS / EDGE_M - (STEPS - 1) / 2) for p in point)
        kernels.deposit(u, v, w, FAR_CORNER, slow)
    assert raster.sum() > 10 * UNIT
    # Directions come from other sums: a sample may round to the next part of an edge.
    assert np.abs(raster - slow).sum() < 0.02 * raster.sum()
    assert abs(int(raster.sum()) - int(slow.sum())) < 0.01 * raster.sum()


@pytest.mark.parametrize(("range_m", "count"), [(np.inf, 30), (3.01, 20), (2.71, 14), (2.0, 0)])
def test_a_detector_is_blind_behind_its_detection(range_m: float, count: int) -> None:
    raster = np.zeros((20, 20, 60), np.int64)
    seen = np.full((1, 1, 1), range_m, np.float32)
    gate, origin = np.array([2.115, 3.465]), np.array([[0.0, 0.0, 3.0]])
    corner = np.array([-10, -10, -30])
    kernels.interrogate(origin, np.eye(3)[None], seen, 1e-3, gate, EDGE_M, corner, raster)
    assert raster.sum() == count * UNIT
