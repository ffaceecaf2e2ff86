"""Counts of beamlets over squares: sums over neighbours, over voxels and over spheres.

Domain: space. The squares are those of :mod:`~spl_batch.airborne.noise.local_noise`, (4 nx, 4 ny,
nz), layer by layer.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.voxel_noise import sphere_radius_m

DOMAIN: Final = "space"

SQUARES: Final = 4
"""Squares along the edge of a voxel."""


def unpack(counts: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
    """Squares of voxels: (4 nx, 4 ny, nz) float32 from (nx, ny, nz, 16)."""
    nx, ny, nz = counts.shape[:3]
    apart = counts.reshape(nx, ny, nz, SQUARES, SQUARES).transpose(0, 3, 1, 4, 2)
    return apart.astype(np.float32).reshape(nx * SQUARES, ny * SQUARES, nz)


def over_squares(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Value of its voxel for each square: (4 nx, 4 ny, nz) float32 from (nx, ny, nz)."""
    return values.astype(np.float32).repeat(SQUARES, axis=0).repeat(SQUARES, axis=1)


def blurred(values: NDArray[np.float32], own: float) -> NDArray[np.float32]:
    """Sum over each square and the eight around it; along each axis its own weighs ``own``."""
    for axis in (0, 1):
        out = values * np.float32(own)
        ahead, behind = _halves(axis)
        out[ahead] += values[behind]
        out[behind] += values[ahead]
        values = out
    return values


def joined(join: Callable[..., NDArray[np.bool_]], squares: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Each square with the eight around it in its layer, joined."""
    for axis in (0, 1):
        out = squares.copy()
        ahead, behind = _halves(axis)
        join(out[ahead], squares[behind], out=out[ahead])
        join(out[behind], squares[ahead], out=out[behind])
        squares = out
    return squares


def of_spheres(values: NDArray[np.floating[Any]] | NDArray[np.bool_]) -> NDArray[np.float64]:
    """Mean of the squares of each voxel as far as its sphere lies over them."""
    nx, ny, nz = (n // d for n, d in zip(values.shape, (SQUARES, SQUARES, 1), strict=True))
    blocks = values.reshape(nx, SQUARES, ny, SQUARES, nz)
    mean: NDArray[np.float64] = np.einsum("xiyjz,ij->xyz", blocks, square_shares())
    return mean


def nine(values: NDArray[np.float64], own: float = 1.0) -> NDArray[np.float64]:
    """Sum over a voxel and the eight around it; along each axis its own value weighs ``own``."""
    for axis in (0, 1):
        out = values * own
        ahead, behind = _halves(axis)
        out[ahead] += values[behind]
        out[behind] += values[ahead]
        values = out
    return values


def ratio(total: NDArray[np.float64], number: NDArray[np.float64]) -> NDArray[np.float64]:
    """One over the other, 0 where that is 0."""
    some = number > 0.0
    found: NDArray[np.float64] = np.where(some, total / np.where(some, number, 1.0), 0.0)
    return found


@cache
def square_shares() -> NDArray[np.float64]:
    """Share of a sphere over each square of its voxel: (4, 4) float64, sum 1.

    What sticks out of the voxel belongs to the outer squares.
    """
    fine = 200
    radius = sphere_radius_m(1.0)
    at = (np.arange(2 * fine) + 0.5) / fine * radius - radius
    height = np.sqrt(np.maximum(radius**2 - at[:, None] ** 2 - at**2, 0.0))
    index = np.clip(np.floor((at + 0.5) * SQUARES).astype(int), 0, SQUARES - 1)
    shares = np.zeros((SQUARES, SQUARES))
    np.add.at(shares, (index[:, None], index[None]), height)
    normal: NDArray[np.float64] = shares / shares.sum()
    return normal


def _halves(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """All but the first, and all but the last, along an axis."""
    whole = slice(None)
    ahead, behind = [whole, whole], [whole, whole]
    ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
    return tuple(ahead), tuple(behind)
