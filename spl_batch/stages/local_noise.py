"""Expected background of the part of a voxel that is listened to, for testing points there.

Domain: space. A deviation from [W18] Eq. 2, whose density is the mean of a whole voxel. A
voxel that a gate's end, the edge of a flightline or of a delivery cuts is partly silent, and
its mean is too small for the points in it, which all lie on one side. So, for each flightline:

- the amount in a sphere is divided by the share of it over squares that beamlets cross
  (``VoxelPart.squares``): gaps of up to two squares are closed, since few beamlets leave gaps
  without an edge, and squares along an edge count half;
- where squares are missing, the same ratio of the nine voxels around is taken if it is
  larger: a sliver's own share is known too badly;
- of a voxel and those above and below, the largest: where a gate ends
  (:func:`~spl_batch.stages.voxel_noise.within_gate`);
- it counts at points within a square of those that the flightline covers, in the layers
  around: near an overlap's edge the neighbours of a point lie within it;
- where surely more beamlets cross a square within one of a point's than are usual around its
  voxel, the amount goes with them: at the edge of a swath a turning scan runs along the edge,
  and what it listens to there makes a ridge narrower than a voxel.

The flightlines add up. Each step errs towards more noise. ``benchmarks/null_edges.py`` prints
what the test keeps of noise along edges.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.model import VOXEL_FIXED_POINT
from spl_batch.stages.voxel_noise import sphere_radius_m, within_gate

DOMAIN: Final = "space"

SQUARES: Final = 4
"""Squares along the edge of a voxel."""

MARGIN_VOXELS: Final = 2
"""Voxels on each side of a point's that its density depends on."""

BLUR: Final = (1.0, 4.0, 1.0)
"""Weights of a square and its neighbours on either side, where beamlets are counted."""

SURE: Final = 3.0
"""Standard errors of such a count by which a ridge has to stand out."""


class Listened(NamedTuple):
    """What one flightline listens to, ready to be asked at points.

    Parameters
    ----------
    per_m3 : (nx, ny, nz) float64
        Density of the covered part of each voxel [1/m3].
    each : (nx, ny, nz) float64
        What one beamlet stands for there [1/m3].
    surely : (4 nx, 4 ny, nz) float32
        Beamlets that surely cross the fullest square within one of each [count].
    near : (4 nx, 4 ny, nz) bool
        Squares near those that beamlets cross.
    """

    per_m3: NDArray[np.float64]
    each: NDArray[np.float64]
    surely: NDArray[np.float32]
    near: NDArray[np.bool_]

    def at(
        self, voxel: tuple[NDArray[np.int64], ...], square: tuple[NDArray[np.int64], ...]
    ) -> NDArray[np.float64]:
        """Noise of the flightline around points, in the part that it listens to.

        Parameters
        ----------
        voxel : three of (n,) int64
            Index of each point's voxel.
        square : two of (n,) int64
            Index of its square: :data:`SQUARES` along each edge of a voxel.

        Returns
        -------
        (n,) float64
            [1/m3]; 0 where the flightline does not come near.
        """
        place = square[0], square[1], voxel[2]
        ridge = self.each[voxel] * self.surely[place]
        return np.where(self.near[place], np.maximum(self.per_m3[voxel], ridge), 0.0)


def listened(
    amount: NDArray[np.int64], counts: NDArray[np.integer[Any]], voxel_m: float
) -> Listened | None:
    """What one flightline listens to; None where it does not come near.

    Parameters
    ----------
    amount : (nx, ny, nz) int64
        Sum of ``VoxelPart.amount`` of its stretches, :data:`MARGIN_VOXELS` wider on each
        side than the voxels that will be asked for.
    counts : (nx, ny, nz, 16) integer
        Sum of ``VoxelPart.squares``.
    voxel_m : float
        Edge of a voxel [m].
    """
    if not counts.any():
        return None
    beamlets = unpack(counts)
    near = _across(np.logical_or, beamlets > 0)
    closed = _across(np.logical_and, near)
    weight = _weight(closed)
    per_m3 = within_gate(_of_covered(amount, closed, weight, voxel_m))
    each, surely = _of_beamlets(amount, beamlets, weight, voxel_m)
    _vertically(np.logical_or, near)
    return Listened(per_m3, each, surely, near)


def unpack(counts: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
    """Squares of voxels: (4 nx, 4 ny, nz) float32 from (nx, ny, nz, 16)."""
    nx, ny, nz = counts.shape[:3]
    apart = counts.reshape(nx, ny, nz, SQUARES, SQUARES).transpose(0, 3, 1, 4, 2)
    return apart.astype(np.float32).reshape(nx * SQUARES, ny * SQUARES, nz)


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


def _weight(squares: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Part of each square that is covered: 1 inside, 0.5 along an edge."""
    inner = squares.copy()
    for axis in (0, 1):
        ahead, behind = _halves(axis)
        inner[ahead] &= squares[behind]
        inner[behind] &= squares[ahead]
    return (squares.astype(np.float32) + inner) * np.float32(0.5)


def _of_covered(
    amount: NDArray[np.int64],
    squares: NDArray[np.bool_],
    weight: NDArray[np.float32],
    voxel_m: float,
) -> NDArray[np.float64]:
    """Density of the covered part of voxels [1/m3]."""
    share = _of_spheres(weight)
    some = share > 0.0
    points = np.where(some, amount, 0) / (VOXEL_FIXED_POINT * voxel_m**3)
    own = points / np.where(some, share, 1.0)
    nx, ny, nz = amount.shape
    cut = some & ~squares.reshape(nx, SQUARES, ny, SQUARES, nz).all(axis=(1, 3))
    pooled = _around(points)[cut] / _around(share)[cut]
    own[cut] = np.maximum(own[cut], pooled)
    return own


def _of_spheres(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Mean of the squares of each voxel as far as its sphere lies over them."""
    nx, ny, nz = (n // d for n, d in zip(values.shape, (SQUARES, SQUARES, 1), strict=True))
    blocks = values.reshape(nx, SQUARES, ny, SQUARES, nz)
    mean: NDArray[np.float64] = np.einsum("xiyjz,ij->xyz", blocks, square_shares())
    return mean


def _of_beamlets(
    amount: NDArray[np.int64],
    beamlets: NDArray[np.float32],
    weight: NDArray[np.float32],
    voxel_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """What one beamlet stands for [1/m3], and how many surely cross the fullest square near.

    What one beamlet stands for is the mean of nine voxels: it changes slowly.
    """
    number = _around(_of_spheres(beamlets))
    points = _around(amount / (VOXEL_FIXED_POINT * voxel_m**3))
    each = within_gate(np.where(number > 0.0, points / np.where(number > 0.0, number, 1.0), 0.0))
    found, area = _blurred(beamlets, BLUR), _blurred(weight, BLUR)
    # of a Poisson count, weighted
    error = np.sqrt(_blurred(beamlets, tuple(w * w for w in BLUR)))
    surely = np.maximum(found - np.float32(SURE) * error, np.float32(0.0))
    surely /= np.where(area > 0.0, area, np.float32(1.0))
    return each, _largest(surely)


def _largest(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Largest of each square and the eight around it in its layer."""
    for axis in (0, 1):
        out = values.copy()
        ahead, behind = _halves(axis)
        np.maximum(out[ahead], values[behind], out=out[ahead])
        np.maximum(out[behind], values[ahead], out=out[behind])
        values = out
    return values


def _blurred(values: NDArray[np.float32], weights: tuple[float, ...]) -> NDArray[np.float32]:
    """Weighted sum over each square and the eight around it in its layer."""
    beside, own = np.float32(weights[0]), np.float32(weights[1])
    for axis in (0, 1):
        out = values * own
        ahead, behind = _halves(axis)
        out[ahead] += values[behind] * beside
        out[behind] += values[ahead] * beside
        values = out
    return values


def _across(
    join: Callable[..., NDArray[np.bool_]], squares: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Each square with the eight around it in its layer, joined."""
    for axis in (0, 1):
        out = squares.copy()
        ahead, behind = _halves(axis)
        join(out[ahead], squares[behind], out=out[ahead])
        join(out[behind], squares[ahead], out=out[behind])
        squares = out
    return squares


def _vertically(join: Callable[..., NDArray[np.bool_]], squares: NDArray[np.bool_]) -> None:
    """Each square with those above and below, joined in place."""
    before = squares.copy()
    join(squares[:, :, 1:], before[:, :, :-1], out=squares[:, :, 1:])
    join(squares[:, :, :-1], before[:, :, 1:], out=squares[:, :, :-1])


def _halves(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """All but the first, and all but the last, along an axis."""
    whole = slice(None)
    ahead, behind = [whole, whole], [whole, whole]
    ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
    return tuple(ahead), tuple(behind)


def _around(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum over a voxel and the eight around it in its layer."""
    for axis in (0, 1):
        out = values.copy()
        ahead, behind = _halves(axis)
        out[ahead] += values[behind]
        out[behind] += values[ahead]
        values = out
    return values
