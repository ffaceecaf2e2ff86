"""Expected background of the part of a voxel that is listened to, for testing points there.

Domain: space. Deviation: [W18] Eq. 2 takes the mean of a whole voxel. Where a gate's end or the
edge of a flightline or delivery cuts a voxel, that is too small for its points. So each
flightline's density is found on squares, 2.5 m wide in voxels of 10 m, and flightlines add up:

- One beamlet of usual noise stands for the noise in a sphere over the beamlets that cross it; a
  square has that times its beamlets, each by the noise that it stands for (``VoxelPart.squares``).
- A count is believed as far as its Poisson error allows, against the squares around and then the
  mean of the voxel. Gaps of up to two squares are closed.
- A layer in which the gate ends counts up to the end
  (:mod:`~spl_batch.airborne.noise.gate_ends`).

Between the centres of squares, and of layers without an end, the density is linear, along the lean
of the beams. ``docs/evidence/noise.md`` has the share of noise kept along sharp edges.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.beamlet_counts import (
    blurred,
    joined,
    of_spheres,
    over_squares,
    ratio,
    unpack,
)
from spl_batch.airborne.noise.gate_ends import without_ends
from spl_batch.airborne.noise.noise_interpolation import add_between
from spl_batch.airborne.noise.voxel_noise import BEAMLET

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
