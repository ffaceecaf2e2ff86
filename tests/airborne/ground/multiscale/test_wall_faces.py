"""Faces of walls between ground and ground."""

import numpy as np
import pytest

from spl_batch.airborne.ground.multiscale.wall_faces import with_faces


def plain(z: np.ndarray, may: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """The same cell by cell."""
    out = ground.copy()
    for _ in range(2):
        before = out.copy()
        for r, c in zip(*np.nonzero(may & ~before), strict=True):
            for a, b in ((0, 1), (1, 0), (1, 1), (1, -1)):
                ends = []
                for way in (1, -1):
                    p = r + way * a, c + way * b
                    inside = min(p) >= 0 and max(p) < len(z)
                    ends.append(z[p] if inside and before[p] else None)
                if None in ends:
                    continue
                low, high = sorted(ends)
                out[r, c] |= low <= z[r, c] <= high - 0.2 and high - low >= 1.0
    return out


@pytest.mark.parametrize("seed", [1, 2])
def test_faces_are_those_of_a_slow_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = 4.0 * rng.random((15, 15))
    held = rng.random(z.shape) < 0.9
    ground = held & (rng.random(z.shape) < 0.5)
    grid = np.full(z.shape, -1)
    grid[held] = np.arange(held.sum())
    xyz = np.column_stack([*np.nonzero(held)[::-1], z[held]]).astype(float)
    may = held & (rng.random(z.shape) < 0.8)
    found = with_faces(xyz, grid, ground[held], may[held])
    expected = plain(z, may, ground)
    assert found.tolist() == expected[held].tolist()
    assert (found & ~ground[held]).any()


@pytest.mark.parametrize(("of_wall", "taken"), [(2.0, True), (3.9, False), (5.0, False)])
def test_a_face_is_taken_and_what_goes_on_level_or_stands_higher_is_not(
    of_wall: float, *, taken: bool
) -> None:
    z = np.repeat([[4.0, 4.0, 4.0, of_wall, 0.0, 0.0, 0.0]], 7, axis=0)
    grid = np.arange(49).reshape(7, 7)
    xyz = np.column_stack([*np.indices((7, 7)).reshape(2, -1)[::-1], z.ravel()]).astype(float)
    ground = xyz[:, 0] != 3
    found = with_faces(xyz, grid, ground, np.ones(49, bool))
    assert found[~ground].tolist() == [taken] * 7


def test_beside_a_roof_there_is_no_ground_on_the_upper_side() -> None:
    z = np.repeat([[4.0, 4.0, 4.0, 2.0, 0.0, 0.0, 0.0]], 7, axis=0)
    xyz = np.column_stack([*np.indices((7, 7)).reshape(2, -1)[::-1], z.ravel()]).astype(float)
    ground = xyz[:, 0] > 3
    found = with_faces(xyz, np.arange(49).reshape(7, 7), ground, np.ones(49, bool))
    assert found.tolist() == ground.tolist()
