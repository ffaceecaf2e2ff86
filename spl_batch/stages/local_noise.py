"""Expected background of the part of a voxel that is listened to, for testing points there.

Domain: space. A deviation from [W18] Eq. 2, whose density is the mean of a whole voxel. A
voxel that a gate's end, the edge of a flightline or of a delivery cuts is partly silent, and
its mean is too small for the points in it, which all lie on one side. So, for each flightline:

- the amount in a sphere is divided by the share of it over squares that beamlets cross
  (``VoxelPart.covered``): gaps of up to two squares are closed, since few beamlets leave gaps
  without an edge, and squares along an edge count half;
- where squares are missing, the same ratio of the nine voxels around is taken if it is
  larger: a sliver's own share is known too badly;
- of a voxel and those above and below, the largest: where a gate ends
  (:func:`~spl_batch.stages.voxel_noise.within_gate`);
- it counts at points within a square of those that the flightline covers, in the layers
  around: near an overlap's edge the neighbours of a point lie within it.

The flightlines add up. Each step errs towards more noise. ``benchmarks/null_edges.py`` prints
what the test keeps of noise along edges.
"""

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.model import VOXEL_FIXED_POINT
from spl_batch.stages.voxel_noise import sphere_radius_m, within_gate

DOMAIN: Final = "space"

SQUARES: Final = 4
"""Squares along the edge of a voxel."""

MARGIN_VOXELS: Final = 2
"""Voxels on each side of a point's that its density depends on."""


def listened_density(
    amount: NDArray[np.int64],
    covered: NDArray[np.uint16],
    voxel: tuple[NDArray[np.int64], ...],
    square: tuple[NDArray[np.int64], ...],
    voxel_m: float,
) -> NDArray[np.float64]:
    """Noise of one flightline around points, in the part that it listens to.

    Parameters
    ----------
    amount : (nx, ny, nz) int64
        Sum of ``VoxelPart.amount`` of its stretches, :data:`MARGIN_VOXELS` wider on each
        side than the points' voxels.
    covered : (nx, ny, nz) uint16
        Union of ``VoxelPart.covered``.
    voxel : three of (n,) int64
        Index of each point's voxel.
    square : two of (n,) int64
        Index of its square: :data:`SQUARES` along each edge of a voxel.
    voxel_m : float
        Edge of a voxel [m].

    Returns
    -------
    (n,) float64
        [1/m3]; 0 where the flightline does not come near.
    """
    squares = unpack(covered)
    if not squares.any():
        return np.zeros(len(voxel[0]))
    near = _across(np.logical_or, squares)
    closed = _across(np.logical_and, near)
    per_m3 = within_gate(_of_covered(amount, closed, voxel_m))
    _vertically(np.logical_or, near)
    return np.where(near[square[0], square[1], voxel[2]], per_m3[voxel], 0.0)


def unpack(covered: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Squares of voxels: (4 nx, 4 ny, nz) bool from (nx, ny, nz) uint16."""
    nx, ny, nz = covered.shape
    out = np.empty((nx, SQUARES, ny, SQUARES, nz), dtype=np.bool_)
    for x in range(SQUARES):
        for y in range(SQUARES):
            out[:, x, :, y] = (covered >> (x * SQUARES + y)) & 1
    return out.reshape(nx * SQUARES, ny * SQUARES, nz)


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


def _of_covered(
    amount: NDArray[np.int64], squares: NDArray[np.bool_], voxel_m: float
) -> NDArray[np.float64]:
    """Density of the covered part of voxels [1/m3]."""
    nx, ny, nz = amount.shape
    inner = squares.copy()
    for axis in (0, 1):
        ahead, behind = _halves(axis)
        inner[ahead] &= squares[behind]
        inner[behind] &= squares[ahead]
    # 1 inside, 0.5 along an edge
    weight = (squares.astype(np.float32) + inner) * np.float32(0.5)
    blocks = weight.reshape(nx, SQUARES, ny, SQUARES, nz)
    share = np.einsum("xiyjz,ij->xyz", blocks, square_shares())
    some = share > 0.0
    points = np.where(some, amount, 0) / (VOXEL_FIXED_POINT * voxel_m**3)
    own = points / np.where(some, share, 1.0)
    cut = some & ~blocks.all(axis=(1, 3))
    pooled = _around(points)[cut] / _around(share)[cut]
    own[cut] = np.maximum(own[cut], pooled)
    return own


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
