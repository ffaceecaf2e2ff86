"""Expected background of the part of a voxel that is listened to, for testing points there.

Domain: space. Deviation: [W18] Eq. 2 takes the mean of a whole voxel. Where a gate's end or the
edge of a flightline or delivery cuts a voxel, that is too small for its points. So each
flightline's density is found on squares, 2.5 m wide in voxels of 10 m, and flightlines add up:

- One beamlet stands for the noise in a sphere over the beamlets that cross it; a square has that
  times its beamlets, each by the gain of its ground (``VoxelPart.squares``).
- A count is believed as far as the chance of silent beamlets allows, against the squares around.
  Gaps of up to two squares are closed.
- A beamlet stands for the same noise in each layer that it crosses, and for less where its gate
  ends. So a layer takes the noise per beamlet of the layer above or below where that is more.

Between the centres of squares and of layers the density is linear, along the lean of the beams.
``docs/evidence/noise.md`` has the share of noise kept along sharp edges.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.noise.voxel_noise import BEAMLET
from spl_batch.lattice.tables import FIXED_POINT
from spl_batch.numerics.compiled import njit

SQUARES: Final = 4
"""Squares along the edge of a voxel; (4 nx, 4 ny, nz) in all, layer by layer."""

MARGIN_VOXELS: Final = 2
"""Voxels on each side of a point's that its density depends on."""

PRIOR: Final = 6.0
"""Beamlets that the squares around are worth against a square's own [count]. Half and twice move 8
+ 31 and 18 + 5 labels."""

BLUR: Final = 4.0
"""Weight of a square's own count against a neighbour's along an axis, in a blur. Half and twice
move 33 + 31 and 24 + 8 labels."""

RIDGE: Final = 3.0
"""How often a ridge gets back what a blur takes off it: blur and linear interpolation flatten the
ridges of turning scans along the edges of swaths, and those over the edges of bright ground. Half
and twice move 40 + 20 and 64 + 104 labels."""


def listened(
    amount: NDArray[np.int64], counts: NDArray[np.integer[Any]], voxel_m: float
) -> NDArray[np.float32] | None:
    """Noise over each square of one flightline, as if its gate ended in no voxel.

    Parameters
    ----------
    amount : (nx, ny, nz) int64
        Sum of ``VoxelPart.amount`` of its stretches, :data:`MARGIN_VOXELS` wider on each
        side than the voxels that will be asked for.
    counts : (nx, ny, nz, 16) integer
        Sum of ``VoxelPart.squares``.

    Returns
    -------
    (4 nx, 4 ny, nz) float32 or None
        [1/m3]; None where the flightline does not come near.
    """
    if not counts.any():
        return None
    beamlets = unpack(counts) / np.float32(BEAMLET)
    covered = ndimage.minimum_filter(ndimage.maximum_filter(beamlets > 0, (3, 3, 1)), (3, 3, 1))
    density = _believed(beamlets, covered.astype(np.float32))
    each = each_stands_for(amount, counts, voxel_m)
    density *= each.astype(np.float32).repeat(SQUARES, axis=0).repeat(SQUARES, axis=1)
    return density


def around(
    lines: Sequence[NDArray[np.float32]],
    xyz: Sequence[NDArray[np.integer[Any]]],
    edge: int,
    corner: Sequence[int],
) -> NDArray[np.float64]:
    """Noise of all flightlines together at points: (n,) [1/m3].

    Parameters
    ----------
    lines : sequence of (i, j, k) float32
        From :func:`listened`, all of one box. What lies above or below it is as silent as its
        highest or lowest layer.
    xyz : three of (n,) integer
        Absolute coordinates [quanta].
    edge : int
        Edge of a voxel [quanta].
    corner : (int, int, int)
        Absolute index of the first voxel.
    """
    total = np.zeros(len(xyz[0]))
    if not lines:
        return total
    square, offset = [], []
    for axis, first, parts in zip(xyz, corner, (SQUARES, SQUARES, 1), strict=True):
        at, rest = np.divmod(axis.astype(np.int64) * parts, edge)
        square.append(at - first * parts)
        offset.append(rest / edge - 0.5)
    np.clip(square[2], 0, lines[0].shape[2] - 1, out=square[2])
    for density in lines:
        add_between(density, tuple(square), tuple(offset), total)
    return total


def _believed(beamlets: NDArray[np.float32], covered: NDArray[np.float32]) -> NDArray[np.float32]:
    """Beamlets over squares, as far as chance lets their counts show; 0 beside covered ones."""
    area: NDArray[np.float32] = np.maximum(blurred(covered, BLUR), np.float32(1.0))
    around: NDArray[np.float32] = covered * blurred(beamlets, BLUR) / area
    ridge = around - blurred(around, BLUR) / area
    # By the counts around: by its own, larger counts were believed more, and all were too many.
    own = around / (around + np.float32(PRIOR))
    number = around + own * (beamlets - around + np.float32(RIDGE) * ridge)
    return np.maximum(number, np.float32(0.0))


def each_stands_for(
    amount: NDArray[np.int64], counts: NDArray[np.integer[Any]], voxel_m: float
) -> NDArray[np.float64]:
    """Noise that a beamlet over a square stands for, by voxel, as if its gate ended in none [1/m3].

    ``amount``, ``counts``: (nx, ny, nz) and (nx, ny, nz, 16), as :func:`listened` has them.
    """
    mean = blurred(amount / (FIXED_POINT * voxel_m**3))
    own = blurred(counts.mean(axis=3) / BEAMLET)
    part = np.divide(mean, own, out=np.zeros(own.shape), where=own > 0.0)
    # The largest of each layer and those above and below.
    whole: NDArray[np.float64] = ndimage.maximum_filter1d(part, 3, axis=2)
    return whole


def unpack(counts: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
    """Squares of voxels: (4 nx, 4 ny, nz) float32 from (nx, ny, nz, 16)."""
    nx, ny, nz = counts.shape[:3]
    apart = counts.reshape(nx, ny, nz, SQUARES, SQUARES).transpose(0, 3, 1, 4, 2)
    return apart.astype(np.float32).reshape(nx * SQUARES, ny * SQUARES, nz)


def blurred(values: NDArray[Any], own: float = 1.0) -> NDArray[Any]:
    """Sum over each cell and the eight around it; along each axis its own weighs ``own``."""
    for axis in (0, 1):
        values = ndimage.convolve1d(values, [1.0, own, 1.0], axis=axis, mode="constant")
    return values


@njit()
def add_between(
    density: NDArray[np.float32],
    square: tuple[NDArray[np.int64], ...],
    offset: tuple[NDArray[np.float64], ...],
    out: NDArray[np.float64],
) -> None:
    """Add the density at points, linear between squares and between layers that both have some.

    ``square``: index of each point's square and layer; ``offset``: from the centre of both, in
    squares and in layers [-0.5..0.5].
    """
    nx, ny, layers = density.shape
    for p in range(len(out)):
        west, south, up = np.floor(offset[0][p]), np.floor(offset[1][p]), offset[2][p]
        right, ahead = offset[0][p] - west, offset[1][p] - south
        # Unsigned indices: a signed one costs numba a test for wrapping.
        z = np.uint64(square[2][p])
        i = np.uint64(_within(square[0][p] + west, nx))
        j = np.uint64(_within(square[1][p] + south, ny))
        e = np.uint64(_within(square[0][p] + west + 1.0, nx))
        n = np.uint64(_within(square[1][p] + south + 1.0, ny))
        found = _linear(density, i, e, j, n, z, right, ahead)
        k = np.uint64(_within(square[2][p] + (1 if up > 0.0 else -1), layers))
        beside = _linear(density, i, e, j, n, k, right, ahead)
        if found > 0.0 and beside > 0.0:
            found += abs(up) * (beside - found)
        out[p] += found


@njit(inline="always")
def _within(at, size):  # type: ignore[no-untyped-def]
    """Nearest index that exists."""
    return min(max(np.int64(at), 0), size - 1)


@njit(inline="always")
def _linear(values, i, e, j, n, z, right, ahead):  # type: ignore[no-untyped-def]
    """Value between four squares of a layer."""
    a, b, c, d = values[i, j, z], values[e, j, z], values[i, n, z], values[e, n, z]
    near, far = (1.0 - right) * a + right * b, (1.0 - right) * c + right * d
    return (1.0 - ahead) * near + ahead * far
