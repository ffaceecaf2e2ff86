"""Expected background of the part of a voxel that is listened to, for testing points there.

Domain: space. Deviation: [W18] Eq. 2 takes the mean of a whole voxel. Where a gate's end or the
edge of a flightline or delivery cuts a voxel, that is too small for its points. So each
flightline's density is found on squares, 2.5 m wide in voxels of 10 m, and flightlines add up:

- One beamlet of usual noise stands for the noise in a sphere over the beamlets that cross it; a
  square has that times its beamlets, each by the noise that it stands for (``VoxelPart.squares``).
- A count is believed as far as its Poisson error allows, against the squares around and then the
  mean of the voxel. Gaps of up to two squares are closed.
- A beamlet stands for the same noise in each layer that it crosses, and for less where its gate
  ends. Such a layer takes the noise per beamlet of the layer above or below, and counts up to the
  end, whose height the share of the sphere that is listened to tells.

Between the centres of squares, and of layers without an end, the density is linear, along the lean
of the beams. ``docs/evidence/noise.md`` has the share of noise kept along sharp edges.
"""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.beamlet_counts import (
    SQUARES,
    blurred,
    joined,
    nine,
    of_spheres,
    over_squares,
    ratio,
    unpack,
)
from spl_batch.airborne.noise.voxel_noise import BEAMLET, sphere_radius_m, tallest
from spl_batch.lattice.tables import VOXEL_FIXED_POINT
from spl_batch.numerics.compiled import njit

DOMAIN: Final = "space"

MARGIN_VOXELS: Final = 2
"""Voxels on each side of a point's that its density depends on."""

PRIOR: Final = 20.0
"""Beamlets that the squares around are worth against a square's own, and the voxel's mean against
both: the error of chance is at most 11 % where as many tell [count]."""

BLUR: Final = 4.0
"""Weight of a square's own count against a neighbour's along an axis, in a blur."""

SURE: Final = 4.0
"""Squares whose counts together are as sure as a blurred one."""

RIDGE: Final = 2.0
"""How often a ridge gets back what a blur takes off it: blur and linear interpolation flatten the
ridges of turning scans along the edges of swaths."""

LEAST: Final = 0.15
"""Share of the density that is left at the edge of a flightline, within a square of it."""


CUT: Final = 2.0
"""Standard errors by which a beamlet stands for less than in the next layer at a gate's end."""

SLIVER: Final = 0.027
"""Share of a sphere that sticks out of its voxel on one side: a smaller loss is no end."""

ENOUGH: Final = 0.5
"""Share of the next layer's beamlets that suffices to tell what a beamlet stands for."""

INSIDE: Final = 0.9
"""Largest share of a sphere that is listened to where the end's height counts: an end in the last
metre of a layer looks like a difference between layers."""

HERE: Final = 12.0
"""Weight of a voxel against those on either side in what its beamlets stand for: the number of
silent beamlets, which the seen ones stand for, differs between voxels."""


class Listened(NamedTuple):
    """What one flightline listens to, ready to be asked at points."""

    #: (4 nx, 4 ny, nz): noise over each square, as if the gate ended in no voxel [1/m3].
    density: NDArray[np.float32]
    #: (nx, ny, nz): 1 in voxels that hold the gate's upper end, -1 the lower one, 0 others.
    side: NDArray[np.int8]
    end: NDArray[np.float32]  #: (nx, ny, nz): height of that end over the voxel's centre [voxels].


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
    """
    if not counts.any():
        return None
    beamlets = unpack(counts) / np.float32(BEAMLET)
    covered = joined(np.logical_and, joined(np.logical_or, beamlets > 0))
    gate = without_ends(amount, beamlets, voxel_m)
    density = _believed(beamlets, covered)
    density *= over_squares(gate.each)
    return Listened(density, gate.side, gate.end)


def around(
    lines: Sequence[Listened],
    voxel: tuple[NDArray[np.int64], ...],
    square: tuple[NDArray[np.int64], ...],
    offset: tuple[NDArray[np.float64], ...],
) -> NDArray[np.float64]:
    """Noise of all flightlines together at points: (n,) [1/m3].

    Parameters
    ----------
    voxel : three of (n,) int64
        Index of each point's voxel.
    square : two of (n,) int64
        Index of its square: :data:`~spl_batch.airborne.noise.beamlet_counts.SQUARES` along each
        edge of a voxel.
    offset : three of (n,) float64
        From the centre of the square, in squares, and of the voxel, in voxels [-0.5..0.5].
    """
    total = np.zeros(len(offset[0]))
    for line in lines:
        add_between(line.density, line.side, line.end, voxel, square, offset, LEAST, total)
    return total


def _believed(beamlets: NDArray[np.float32], covered: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Beamlets over squares, as far as chance lets their counts tell; 0 beside covered ones."""
    prior, inside = np.float32(PRIOR), covered.astype(np.float32)
    area: NDArray[np.float32] = np.maximum(blurred(inside, BLUR), np.float32(1.0))
    around: NDArray[np.float32] = inside * blurred(beamlets, BLUR) / area
    ridge = around - blurred(around, BLUR) / area
    own = beamlets / (beamlets + prior)
    number = around + own * (beamlets - around + np.float32(RIDGE) * ridge)
    np.maximum(number, np.float32(0.5) * around, out=number)
    known = np.float32(SURE) * number
    mean = over_squares(ratio(of_spheres(beamlets), of_spheres(covered)))
    mean *= prior
    mean += known * number
    mean *= inside
    mean /= known + prior
    return mean


class Gate(NamedTuple):
    """What beamlets stand for as if the gate ended in no voxel, and its ends."""

    each: NDArray[np.float64]  #: (nx, ny, nz): what one beamlet over a square stands for [1/m3].
    #: (nx, ny, nz): 1 in voxels that hold the gate's upper end, -1 the lower one, 0 others.
    side: NDArray[np.int8]
    end: NDArray[np.float32]  #: (nx, ny, nz): height of that end over the voxel's centre [voxels].


def without_ends(amount: NDArray[np.int64], beamlets: NDArray[np.float32], voxel_m: float) -> Gate:
    """What beamlets stand for as if the gate ended in no voxel, and its ends.

    Parameters
    ----------
    amount : (nx, ny, nz) int64
        Sum of ``VoxelPart.amount``.
    beamlets : (4 nx, 4 ny, nz) float32
        Beamlets over each square [count].
    """
    mean = amount / (VOXEL_FIXED_POINT * voxel_m**3)
    own = of_spheres(beamlets)
    noise, number = nine(mean), nine(own)
    part = ratio(noise, number)
    # A layer that only beams reach which leave the others' tells nothing.
    tells = number >= ENOUGH * tallest(number)
    whole = tallest(np.where(tells, part, 0.0))
    # Beamlets cross all layers: only those that lean in and out differ, by chance.
    error = np.maximum(CUT / np.sqrt(np.maximum(SQUARES**2 * number, CUT**2)), SLIVER)
    cut = part < (1.0 - error) * whole
    here = np.where(tells, ratio(nine(mean, HERE), nine(own, HERE)), 0.0)
    each = np.where(cut | ~tells, tallest(here), here)
    above, below = np.zeros_like(noise), np.zeros_like(noise)
    above[:, :, :-1], below[:, :, 1:] = noise[:, :, 1:], noise[:, :, :-1]
    side = np.where(cut & (part < INSIDE * whole), np.sign(below - above), 0.0)
    listened = 2.0 * np.minimum(ratio(part, whole), 1.0) - 1.0
    end = side * sphere_radius_m(1.0) * 2.0 * np.sin(np.arcsin(listened) / 3.0)
    return Gate(each, side.astype(np.int8), end.astype(np.float32))


@njit()
def add_between(
    density: NDArray[np.float32],
    side: NDArray[np.int8],
    end: NDArray[np.float32],
    voxel: tuple[NDArray[np.int64], ...],
    square: tuple[NDArray[np.int64], ...],
    offset: tuple[NDArray[np.float64], ...],
    least: float,
    out: NDArray[np.float64],
) -> None:
    """Add the density at points, linear between squares and between layers without a gate's end.

    Up to a gate's end the density falls linearly over half the length of a square, to a half: some
    beamlets may go on.

    Parameters
    ----------
    density : (nx, ny, nz) float32
        Of each square [1/m3]; 0 where nothing is listened to.
    side : (vx, vy, nz) int8
        Voxels in which the gate ends: 1 at the upper end, -1 at the lower one; 0 elsewhere.
    end : (vx, vy, nz) float32
        Height of that end over the voxel's centre [voxels].
    voxel : three of (n,) int64
        Index of each point's voxel.
    square : two of (n,) int64
        Index of its square.
    offset : three of (n,) float64
        From the centre of the square, in squares, and of the voxel, in voxels [-0.5..0.5].
    least : float
        Part of the largest of the four that is left at an edge [0..1].
    out : (n,) float64
        The density is added to these [1/m3].
    """
    nx, ny, layers = density.shape
    per_voxel = nx // side.shape[0]
    for p in range(len(out)):
        # Unsigned indices: a signed one costs numba a test for wrapping.
        vx, vy, z = np.uint64(voxel[0][p]), np.uint64(voxel[1][p]), np.uint64(voxel[2][p])
        west, south, up = np.floor(offset[0][p]), np.floor(offset[1][p]), offset[2][p]
        right, ahead = offset[0][p] - west, offset[1][p] - south
        i = np.uint64(_within(square[0][p] + west, nx))
        j = np.uint64(_within(square[1][p] + south, ny))
        e = np.uint64(_within(square[0][p] + west + 1.0, nx))
        n = np.uint64(_within(square[1][p] + south + 1.0, ny))
        found = _linear(density, i, e, j, n, z, right, ahead, least)
        if side[vx, vy, z] != 0:
            beyond = side[vx, vy, z] * (up - end[vx, vy, z]) * per_voxel
            found *= min(max(0.5 - beyond, 0.5), 1.0)
        else:
            k = np.uint64(_within(voxel[2][p] + (1 if up > 0.0 else -1), layers))
            beside = _linear(density, i, e, j, n, k, right, ahead, least)
            if found > 0.0 and beside > 0.0 and side[vx, vy, k] == 0:
                found += abs(up) * (beside - found)
        out[p] += found


@njit()
def put_places(x, y, z, edge, parts, corner, top, voxel, square, offset):  # type: ignore[no-untyped-def]
    """Voxels and squares of points, and how far they lie off the middles of both.

    Parameters
    ----------
    x, y, z : (n,) integer
        Absolute coordinates [quanta].
    edge, parts : int
        Edge of a voxel [quanta], and squares along it [count].
    corner : (int, int, int)
        Absolute index of the first voxel.
    top : int
        Highest layer: what lies above or below is as silent as the highest or lowest one.
    voxel, square, offset
        (3, n), (2, n), (3, n), out: as in :func:`add_between`.
    """
    # In the middle of its quantum no quotient is near a whole number.
    voxels = 1.0 / edge
    for p in range(len(x)):
        for axis in range(2):
            v = np.int64(x[p] if axis == 0 else y[p])
            at = np.int64(math.floor((v * parts + 0.5) * voxels))
            own = np.int64(math.floor((v + 0.5) * voxels)) - corner[axis]
            voxel[axis, p], square[axis, p] = own, at - corner[axis] * parts
            offset[axis, p] = (v * parts - at * edge) / edge - 0.5
        v = np.int64(z[p])
        at = np.int64(math.floor((v + 0.5) * voxels))
        voxel[2, p] = min(max(at - corner[2], 0), top)
        offset[2, p] = (v - at * edge) / edge - 0.5


@njit(inline="always")
def _within(at, size):  # type: ignore[no-untyped-def]
    """Nearest index that exists."""
    return min(max(np.int64(at), 0), size - 1)


@njit(inline="always")
def _linear(values, i, e, j, n, z, right, ahead, least):  # type: ignore[no-untyped-def]
    """Value between four squares of a layer, and at least a part of the largest one."""
    a, b, c, d = values[i, j, z], values[e, j, z], values[i, n, z], values[e, n, z]
    near, far = (1.0 - right) * a + right * b, (1.0 - right) * c + right * d
    return max((1.0 - ahead) * near + ahead * far, least * max(a, b, c, d))
