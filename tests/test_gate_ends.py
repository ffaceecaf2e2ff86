"""Where within a layer a gate ends: against planes that cut spheres."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.model import VOXEL_FIXED_POINT
from spl_batch.stages.gate_ends import BELOW_AN_END, at_least, ends, to_the_ends
from spl_batch.stages.voxel_noise import sphere_radius_m

SIZE = (7, 7, 7)
RADIUS = sphere_radius_m(10.0)
EACH = np.full(SIZE, 0.002)


def spheres(end_m: float, lean: tuple[float, float]) -> np.ndarray:
    """Share of each sphere below a plane that is as high as ``end_m`` in the middle of the box."""
    centres = (np.stack(np.indices(SIZE), -1) + 0.5) * 10.0
    over = end_m + (centres[..., :2] - 35.0) @ np.array(lean) - centres[..., 2]
    t = np.clip(over / np.hypot(1.0, np.hypot(*lean)) / RADIUS, -1, 1)
    return (2 + 3 * t - t**3) / 4


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("rest", [0.0, 0.4])
@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.2, 0.0), (-0.1, 0.15)])
@pytest.mark.parametrize("end_m", [31.5, 33.0, 35.0, 36.8, 38.2])
def test_the_part_is_that_below_the_plane(
    end_m: float, lean: tuple[float, float], rest: float, way: int
) -> None:
    below = spheres(end_m, lean)
    share = rest + (1 - rest) * below
    reached = np.where(below > 0, 300.0, 300.0 * rest)
    share, reached = share[:, :, ::way], reached[:, :, ::way]
    cut = (share > 0) & (share < 0.98)
    found = ends(share * 300.0 * EACH, reached, EACH, cut & (reached == 300.0))
    rng = np.random.default_rng(4)
    xyz = rng.uniform((30, 30, 30), (40, 40, 40), (400, 3))
    over = end_m + (xyz[:, :2] - 35.0) @ np.array(lean)
    listened = np.clip(0.5 + (over - xyz[:, 2]) / 2.5, 0, 1)
    expected = rest + (1 - rest) * at_least(listened, BELOW_AN_END, 0.5)
    height = 35.0 + way * (xyz[:, 2] - 35.0)
    voxel = (np.full(400, 3),) * 3
    assert found.side[3, 3, 3] == way
    part = found.part(voxel, (xyz[:, 0] / 10 - 3.5, xyz[:, 1] / 10 - 3.5, height / 10 - 3.5))
    assert np.abs(part - expected).mean() < 0.04
    assert np.abs(part - expected).max() < (0.08 if lean == (0.0, 0.0) else 0.6)


@given(st.integers(0, 10_000))
def test_whatever_the_amounts_a_part_is_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    amount, number = rng.uniform(0, 1, (2, *SIZE)) * (rng.random((2, *SIZE)) < 0.8)
    found = ends(amount, number * 300.0, EACH * rng.uniform(0, 3), rng.random(SIZE) < 0.5)
    voxel = tuple(rng.integers(0, SIZE[0], (3, 50)))
    part = found.part(voxel, tuple(rng.uniform(-0.5, 0.5, (3, 50))))
    assert np.isfinite(found.height).all()
    assert ((part >= found.rest[voxel] - 1e-12) & (part <= 1.0 + 1e-12)).all()


def test_below_an_end_it_counts_in_part_and_beyond_it_as_listened_to() -> None:
    part = np.linspace(0, 1, 201)
    found = at_least(part, 0.75, 0.5)
    np.testing.assert_array_equal(found[part <= 0.5], part[part <= 0.5])
    np.testing.assert_array_equal(found[part >= 0.75], part[part >= 0.75])
    assert (found[(part > 0.57) & (part < 0.75)] == 0.75).all()
    assert (np.diff(found) >= 0).all()
    # an edge so blurred that its least part lies below where it would begin
    np.testing.assert_array_equal(at_least(part, 0.3, 0.4), part)


@pytest.mark.parametrize(("less", "cut"), [(0.02, False), (0.06, True)])
def test_what_takes_off_less_than_sticks_out_of_a_voxel_is_no_end(less: float, cut: bool) -> None:  # noqa: FBT001
    """Beamlets are many, and tell such a difference beyond chance: lean and ridges make it."""
    share = np.where(np.arange(SIZE[2]) == 3, 1.0 - less, 1.0)
    beamlets = np.full((4 * SIZE[0], 4 * SIZE[1], SIZE[2]), 300, dtype=np.float32)
    amount = np.rint(np.broadcast_to(share, SIZE) * 300.0 * EACH * 1000.0 * VOXEL_FIXED_POINT)
    _, found, _ = to_the_ends(amount.astype(np.int64), beamlets, 10.0)
    whole = 1.0 if cut else 1.0 - less
    np.testing.assert_allclose(found[2:-2, 2:-2, 3] / found[2:-2, 2:-2, 2], whole, rtol=1e-4)
