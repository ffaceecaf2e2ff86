"""Faces of walls between ground and ground: those of benches, terraces and banks.

A cell on the edge of a terrace holds returns of its face as well, and its lowest node lies between
the heights of both sides. What an opening has cut off there goes on from neither of them: it lies
below the upper ground by a step and above the lower one by another. But where there is ground in
the next cells on two opposite sides, one higher and one lower by a wall, what lies between the two
in place and in height is the face of that wall. Below a roof there is no ground on the upper side.
Our own rule: no source has one.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

FALL_M: Final = 1.0
"""What falls by less from one side to the other is no wall [m]."""

BELOW_M: Final = 0.2
"""A face lies so far below the upper ground: a deck goes on at its height [m]."""

ROUNDS: Final = 2
"""So often what was found counts as ground beside the next: faces of some width [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def with_faces(xyz: Float, grid: Index, ground: Mask, asked: Mask) -> Mask:
    """Ground nodes, and those of a grid on walls between them: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    grid : (rows, columns) int64
        A node for each cell, or -1.
    ground : (n,) bool
        Nodes of the ground.
    asked : (n,) bool
        Nodes that may be: means of layers, as single ones beside a wall are as often shrubs.
    """
    out = ground.copy()
    held = grid >= 0
    may = held & asked[grid]
    for _ in range(ROUNDS):
        own = held & out[grid]
        faces = np.zeros(grid.shape, dtype=np.bool_)
        _between(xyz[:, 2], grid, own, may, faces)
        if not faces.any():
            break
        out[grid[faces]] = True
    return out


@njit()
def _between(z: Float, grid: Index, ground: Mask, may: Mask, out: Mask) -> None:
    """Fill with cells whose node lies between ground on two opposite sides, a wall apart."""
    rows, columns = grid.shape
    for r in range(rows):
        for c in range(columns):
            if not may[r, c] or ground[r, c]:
                continue
            height = z[grid[r, c]]
            for north, east in ((0, 1), (1, 0), (1, 1), (1, -1)):
                one = _of_ground(z, grid, ground, r + north, c + east)
                other = _of_ground(z, grid, ground, r - north, c - east)
                low, high = min(one, other), max(one, other)
                out[r, c] |= low <= height <= high - BELOW_M and high - low >= FALL_M


@njit()
def _of_ground(z: Float, grid: Index, ground: Mask, row: int, column: int) -> float:
    """Height of the ground of a cell; NaN without any."""
    if row < 0 or column < 0 or row >= grid.shape[0] or column >= grid.shape[1]:
        return np.nan
    return float(z[grid[row, column]]) if ground[row, column] else np.nan
