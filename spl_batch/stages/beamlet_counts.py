"""Beamlets over squares: those beside each other, and what they tell of each.

Domain: space. The squares of :mod:`~spl_batch.stages.local_noise`, (nx, ny, nz), layer by layer.
"""

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.stages.voxel_noise import sphere_radius_m

DOMAIN: Final = "space"

SQUARES: Final = 4
"""Squares along the edge of a voxel."""

BLUR: Final = (1.0, 4.0, 1.0)
"""Weights of a square and its neighbours on either side, where beamlets are counted."""

PRIOR: Final = 50.0
"""Beamlets that the squares around are worth against one's own, and the voxel's mean against both:
the error that chance leaves is largest, 7 %, where those that tell are as many [count]."""

TOP: Final = 0.2
"""Part of a second difference of squares by which a ridge lies over what is linear between them:
on average 1/24 for the mean of a square, 1/12 for the line between squares, along one direction of
two as much for that between layers, where beams lean by a square, and more as it is smoothed."""

SLOPE: Final = 0.5
"""Part that is added for the square of the relative step to the next square: an error of place
costs more where it makes the density too small than it gains where too large."""

STEEPEST: Final = 0.1
"""Part of the density that is added along one axis, at most."""


def told(beamlets: NDArray[np.float32], covered: NDArray[np.float32]) -> NDArray[np.float64]:
    """Beamlets over the covered part of squares, by their own and those around: (4 nx, 4 ny, nz).

    Squares that nothing covers have what is around them.
    """
    area = blurred(covered, BLUR)
    around = blurred(beamlets, BLUR).astype(np.float64)
    around /= np.where(area > 0.0, area, 1.0)
    inside = covered > 0.0
    own = np.where(inside, beamlets, 0.0) / np.where(inside, covered, 1.0)
    found: NDArray[np.float64] = np.where(
        inside, (own * own + PRIOR * around) / (own + PRIOR), around
    )
    return found + _added(around, inside)


def _added(values: NDArray[np.float64], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """What is added for tops and slopes, by a smooth field, as chance makes both as well.

    Feet are not dug: where the density is too small more is kept than is lost where it is as much
    too large.
    """
    out = np.zeros_like(values)
    for axis in (0, 1):
        ahead, behind = halves(axis)
        step = np.where(inside[ahead] & inside[behind], values[ahead] - values[behind], 0.0)
        curved, slope = np.zeros_like(values), np.zeros_like(values)
        curved[ahead] += step
        curved[behind] -= step
        slope[ahead] += 0.5 * step
        slope[behind] += 0.5 * step
        relative = slope / np.where(values > 0.0, values, 1.0)
        steep = np.minimum(SLOPE * relative**2, STEEPEST) * values
        out += np.where(inside, np.maximum(TOP * curved, 0.0) + steep, 0.0)
    return out


def beamlets_around(
    beamlets: NDArray[np.float32], squares: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Mean of beamlets over some of the nine squares around each, 0 without any."""
    even = (1.0, 1.0, 1.0)
    number = blurred(squares.astype(np.float32), even)
    found = blurred(beamlets, even)
    found /= np.maximum(number, np.float32(1.0))
    return found


def blurred(values: NDArray[np.float32], weights: tuple[float, ...]) -> NDArray[np.float32]:
    """Weighted sum over each square and the eight around it in its layer."""
    beside, own = np.float32(weights[0]), np.float32(weights[1])
    for axis in (0, 1):
        out = values * own
        ahead, behind = halves(axis)
        out[ahead] += values[behind] * beside
        out[behind] += values[ahead] * beside
        values = out
    return values


def joined(join: Callable[..., NDArray[np.bool_]], squares: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Each square with the eight around it in its layer, joined."""
    for axis in (0, 1):
        out = squares.copy()
        ahead, behind = halves(axis)
        join(out[ahead], squares[behind], out=out[ahead])
        join(out[behind], squares[ahead], out=out[behind])
        squares = out
    return squares


def halves(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """All but the first, and all but the last, along an axis."""
    whole = slice(None)
    ahead, behind = [whole, whole], [whole, whole]
    ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
    return tuple(ahead), tuple(behind)


def of_spheres(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Mean of the squares of each voxel as far as its sphere lies over them."""
    nx, ny, nz = (n // d for n, d in zip(values.shape, (SQUARES, SQUARES, 1), strict=True))
    blocks = values.reshape(nx, SQUARES, ny, SQUARES, nz)
    mean: NDArray[np.float64] = np.einsum("xiyjz,ij->xyz", blocks, square_shares())
    return mean


def nine(values: NDArray[np.float64], weight: float = 1.0) -> NDArray[np.float64]:
    """Sum over a voxel and the eight around it in its layer; along each axis it has a weight."""
    for axis in (0, 1):
        out = weight * values
        ahead, behind = halves(axis)
        out[ahead] += values[behind]
        out[behind] += values[ahead]
        values = out
    return values


@cache
def square_shares() -> NDArray[np.float64]:
    """Share of a sphere over each square of its voxel: (4, 4) float64, sum 1.

    The sphere sticks out of the voxel; what does belongs to the outer squares.
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
