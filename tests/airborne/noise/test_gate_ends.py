"""Where within a layer a gate ends: against planes that cut spheres."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.airborne.noise.local_noise import Gate, without_ends
from spl_batch.airborne.noise.voxel_noise import sphere_radius_m
from spl_batch.lattice.tables import VOXEL_FIXED_POINT

SIZE = (7, 7, 7)
RADIUS = sphere_radius_m(10.0)
EACH = 0.002
NUMBER = 300


def gate(share: np.ndarray, number: np.ndarray) -> Gate:
    """Gate of so many beamlets over each square, which listen to that share of their spheres."""
    fixed = share * number * EACH * 1000.0 * VOXEL_FIXED_POINT
    beamlets = np.broadcast_to(number, SIZE).repeat(4, axis=0).repeat(4, axis=1)
    return without_ends(np.rint(fixed).astype(np.int64), beamlets.astype(np.float32), 10.0)


def spheres(end_m: float, lean: tuple[float, float]) -> np.ndarray:
    """Share of each sphere below a plane that is as high as ``end_m`` in the middle of the box."""
    centres = (np.stack(np.indices(SIZE), -1) + 0.5) * 10.0
    over = end_m + (centres[..., :2] - 35.0) @ np.array(lean) - centres[..., 2]
    t = np.clip(over / np.hypot(1.0, np.hypot(*lean)) / RADIUS, -1, 1)
    return (2 + 3 * t - t**3) / 4


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("lean", [(0.0, 0.0), (-0.1, 0.15)])
@pytest.mark.parametrize("end_m", [31.5, 36.8])
def test_the_end_is_as_high_as_the_plane(end_m: float, lean: tuple[float, float], way: int) -> None:
    share = spheres(end_m, lean)
    number = np.where(share > 0, NUMBER, 0)
    found = gate(share[:, :, ::way], number[:, :, ::way])
    assert found.side[3, 3, 3] == way
    # the mean of nine spheres is flatter than one under a plane that leans
    far = 0.1 if lean == (0.0, 0.0) else 0.5
    assert 10.0 * found.end[3, 3, 3] == pytest.approx(way * (end_m - 35.0), abs=far)
    # below it a beamlet stands for as much as everywhere
    inner = found.each[2:-2, 2:-2, ::way]
    np.testing.assert_allclose(inner[:, :, 1:3], EACH, rtol=0.01)
    np.testing.assert_allclose(inner[1, 1, 3], EACH, rtol=0.01)


@given(st.integers(0, 10_000))
def test_whatever_the_amounts_an_end_lies_in_its_sphere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    share = rng.uniform(0, 3, SIZE) * (rng.random(SIZE) < 0.8)
    found = gate(share, rng.poisson(NUMBER, SIZE) * (rng.random(SIZE) < 0.8))
    assert np.isfinite(found.each).all()
    assert (found.each >= 0).all()
    assert (np.abs(found.end) <= RADIUS / 10.0 + 1e-6).all()
    assert set(np.unique(found.side)) <= {-1, 0, 1}


@pytest.mark.parametrize(
    ("less", "cut", "inside"), [(0.02, False, False), (0.06, True, False), (0.2, True, True)]
)
def test_what_takes_off_less_than_sticks_out_of_a_voxel_is_no_end(
    *, less: float, cut: bool, inside: bool
) -> None:
    """Beamlets are many, and tell such a difference beyond chance: lean and ridges make it."""
    # less above it again, so that it has a side
    share = np.choose(np.clip(np.arange(SIZE[2]) - 2, 0, 2), [1.0, 1.0 - less, 0.5])
    found = gate(np.broadcast_to(share, SIZE), np.full(SIZE, NUMBER))
    whole = 1.0 if cut else 1.0 - less
    np.testing.assert_allclose(found.each[2:-2, 2:-2, 3], whole * EACH, rtol=1e-4)
    assert np.all(found.side[2:-2, 2:-2, 3] == int(inside))
