"""Roofs among the nodes of the ground: flat patches with a wall nearly all around."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.raised_patches import on_houses, walled_in

SIZE = 60


def scene(kind: str) -> NDArray[np.float64]:
    """Heights of squares of 2 m with something of 16 m in their middle [m]."""
    row, column = np.indices((SIZE, SIZE))
    z = np.zeros((SIZE, SIZE))
    inside = (abs(row - 30) <= 4) & (abs(column - 30) <= 4)
    if kind == "terrace":
        z[column > 30] = 4.0
    elif kind == "mound":
        z = np.maximum(0.0, 5.0 - 0.8 * np.maximum(abs(row - 30), abs(column - 30)))
    else:
        z[inside] = {"house": 4.0, "kerb": 1.0, "tower": 12.0}[kind]
    return z


@pytest.mark.parametrize(
    ("kind", "squares"), [("house", 81), ("kerb", 0), ("tower", 81), ("terrace", 0), ("mound", 0)]
)
def test_roofs_are_taken_off_and_terrain_stays(kind: str, squares: int) -> None:
    z = scene(kind)
    row, column = np.indices(z.shape)
    xyz = np.column_stack([2.0 * column.ravel() + 1, 2.0 * row.ravel() + 1, z.ravel()])
    ground = np.ones(len(xyz), np.bool_)
    off = on_houses(xyz, ground)
    assert np.count_nonzero(off) == squares
    assert not np.any(off & (xyz[:, 2] < z.max()))
    ground[off] = False
    assert not on_houses(xyz, ground).any(), "nodes that are no ground lie on nothing"


def slow_walls(surface: NDArray[np.float64], reach: int) -> NDArray[np.bool_]:
    """Along each of 16 directions: does the surface fall by 2 m before it rises by 2 m?"""
    found = np.zeros(surface.shape, np.bool_)
    for r, c in np.ndindex(surface.shape):
        walls = 0
        for k in range(16):
            north, east = np.sin(2 * np.pi * k / 16), np.cos(2 * np.pi * k / 16)
            far = max(abs(north), abs(east))
            north, east = north / far, east / far
            heights = [surface[r, c]]
            for n in range(1, int(reach / np.hypot(north, east)) + 1):
                i, j = r + int(np.rint(n * north)), c + int(np.rint(n * east))
                if not (0 <= i < surface.shape[0] and 0 <= j < surface.shape[1]):
                    break
                if surface[i, j] <= min(heights[0], heights[-1]) - 2.0:
                    walls += 1
                    break
                if surface[i, j] >= heights[0] + 2.0:
                    break
                heights.append(surface[i, j])
        found[r, c] = walls >= 12
    return found


def test_walls_are_those_of_the_oracle() -> None:
    surface = scene("house")
    surface += np.random.default_rng(1).uniform(-0.3, 0.3, surface.shape)
    assert np.array_equal(walled_in(surface, 20), slow_walls(surface, 20))
