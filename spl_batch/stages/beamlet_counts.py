"""Beamlets over squares: those beside each other, and what they tell of each.

Domain: space. The squares of :mod:`~spl_batch.stages.local_noise`, (nx, ny, nz), layer by layer.
"""

from collections.abc import Callable
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.stages.voxel_noise import sphere_radius_m

DOMAIN: Final = "space"

SQUARES: Final = 4
"""Squares along the edge of a voxel."""

BLUR: Final = (1.0, 4.0, 1.0)
"""Weights of a square and its neighbours on either side, where beamlets are counted."""

PRIOR: Final = 50.0
"""Beamlets that the squares around are worth against one's own, and the mean of an even voxel
against both: the error that chance leaves is largest, 7 %, where as many tell [count]."""

TOP: Final = 0.25
"""Part of a second difference of squares by which what is linear between their means falls short of
a top, and exceeds a foot, along one axis: on average 1/24 for the mean, 1/12 for the line, and more
as it is smoothed. It is taken for as much as a count is held for by itself: few beamlets make tops
by chance."""

MOST: Final = 0.5
"""Part of a count that is added for a top, or taken off for a foot, at most."""

BESIDE: Final = 3.0
"""Weight of a voxel against those on either side where it is told how even squares are."""

BY_CHANCE: Final = 0.4
"""Variance of a count smoothed by :data:`BLUR` over its mean: 1/4, and two errors of what the
squares of a voxel and the eight around it tell of it."""

SLOPE: Final = 0.3
"""Part that is added for the square of the relative step to the next square: what is known of a
place to a third of a square costs more where it makes the density too small than it gains where
too large."""

STEEPEST: Final = 0.1
"""Part of the density that is added for slopes, at most."""


class Told(NamedTuple):
    """What is told of squares by their own beamlets and those around.

    Parameters
    ----------
    covered : (4 nx, 4 ny, nz) float64
        Beamlets over the covered part of each; where nothing covers it, over what is around.
    smooth : (4 nx, 4 ny, nz) float32
        Beamlets over each, by :data:`BLUR`.
    """

    covered: NDArray[np.float64]
    smooth: NDArray[np.float32]


def told(beamlets: NDArray[np.float32], covered: NDArray[np.float32]) -> Told:
    """Beamlets over squares and over their covered part, as far as chance lets them tell."""
    none, one = np.float32(0.0), np.float32(1.0)
    sums, area = blurred(beamlets, BLUR), blurred(covered, BLUR)
    inside = covered > none
    own, around = np.where(inside, beamlets, none), sums.copy()
    own /= np.where(inside, covered, one)
    around /= np.where(area > none, area, one)
    found = np.where(inside, _sharpened(own, around, inside), around)
    sums /= np.float32((2.0 * BLUR[0] + BLUR[1]) ** 2)
    return Told(found.astype(np.float64), sums)


def worth_of_mean(smooth: NDArray[np.float32]) -> NDArray[np.float64]:
    """Beamlets that the mean of a voxel is worth, by how uneven squares are: (nx, ny, nz) [count].

    What the squares of a voxel and of the eight around it differ by beyond chance is the error of
    the mean, and that is worth the inverse of its relative variance.
    """
    mean = nine(of_voxels(smooth), BESIDE)
    square = nine(of_voxels(smooth * smooth), BESIDE) * (2.0 + BESIDE) ** 2
    some = mean > 0.0
    mean = np.where(some, mean, 1.0)
    uneven = np.where(some, square / mean**2, 1.0) - 1.0 - BY_CHANCE * (2.0 + BESIDE) ** 2 / mean
    found: NDArray[np.float64] = 1.0 / np.maximum(uneven, 1.0 / PRIOR)
    return found


def of_voxels(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Mean of the squares of each voxel: (nx, ny, nz) float64."""
    nx, ny, nz = (n // d for n, d in zip(values.shape, (SQUARES, SQUARES, 1), strict=True))
    mean: NDArray[np.float64] = values.reshape(nx, SQUARES, ny, SQUARES, nz).mean(
        axis=(1, 3), dtype=np.float64
    )
    return mean


def _sharpened(
    own: NDArray[np.float32], around: NDArray[np.float32], inside: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Counts by their own and those around, so that what is linear between them keeps its tops.

    Tops and feet are told by a smooth field, as chance makes both as well.
    """
    one = np.float32(1.0)
    share = np.float32(PRIOR) / (own + np.float32(PRIOR))
    found = own + share * (around - own)
    curved, steep = np.zeros_like(around), np.zeros_like(around)
    level = np.where(around > 0.0, around, one)
    for axis in (0, 1):
        ahead, behind = halves(axis)
        step = around[ahead] - around[behind]
        step *= inside[ahead] & inside[behind]
        curved[ahead] += step
        curved[behind] -= step
        slope = np.zeros_like(around)
        slope[ahead] += np.float32(0.5) * step
        slope[behind] += np.float32(0.5) * step
        slope /= level
        steep += slope * slope
    curved *= np.float32(TOP) * (one - share)
    most = np.float32(MOST) * found
    steep = np.minimum(np.float32(SLOPE) * steep, np.float32(STEEPEST))
    told: NDArray[np.float32] = found + np.clip(curved, -most, most) + steep * found
    return told


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
