"""Ends of a flightline's gate: the layers of voxels in which they lie.

Domain: space. A beamlet stands for the same noise in each layer that it crosses, and for less where
its gate ends. Such a layer takes the noise per beamlet of the layer above or below; the share of
the sphere that is listened to tells the height of the end.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.beamlet_counts import SQUARES, nine, of_spheres, ratio
from spl_batch.airborne.noise.voxel_noise import sphere_radius_m, tallest
from spl_batch.lattice.tables import VOXEL_FIXED_POINT

DOMAIN: Final = "space"

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
