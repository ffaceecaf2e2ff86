"""Where within a layer of voxels the gate of a flightline ends, and in which part it counts there.

Domain: space. A sphere that the end of a gate cuts holds less than those of the layers beside it;
how much less tells how high the end is: of a sphere of radius R a share ``(2 + 3 t - t^3) / 4``
lies below the height ``t R`` over its centre. Between the centres of voxels the height is linear,
since ends lean as beams do. It is that of a mean: arcs of a scan ahead and astern end metres
apart. So near it the flightline counts in part, as it does near its edge: by the listened part of
what is as high as a square is wide. Below an end no less counts than :data:`BELOW_AN_END` of what
ends there: one that is sharp would be blurred.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.model import VOXEL_FIXED_POINT
from spl_batch.stages.beamlet_counts import SQUARES, nine, of_spheres
from spl_batch.stages.voxel_noise import sphere_radius_m, tallest

DOMAIN: Final = "space"

CUT: Final = 2.0
"""Standard errors by which less than in the layer beside is a gate's end."""

ENOUGH: Final = 0.5
"""Part of the beamlets of the layer beside from which one tells what a beamlet stands for."""

HERE: Final = 4.0
"""Weight of a voxel against those on either side where what its beamlets stand for is told: the
silent ones that they stand for are more in one voxel than in the next."""

SLIVER: Final = 0.027
"""Share of a sphere that sticks out of its voxel on one side: beamlets that reach no more of the
sphere beyond end within the layer."""

BELOW_AN_END: Final = 0.75
"""Part in which a flightline counts at least below an end: one that is sharp is linear over a
square, and yet the noise is whole up to it."""

STEEP: Final = 4.0
"""Rise of the part in which a flightline counts, to the least one, over that of what is listened
to."""


class Ends(NamedTuple):
    """Ends of a flightline's gate.

    Parameters
    ----------
    side : (nx, ny, nz) int8
        1 where beamlets end upwards within a layer, -1 downwards; 0 where none does.
    height : (nx, ny, nz) float64
        Of their end over the centre of the voxel [voxels].
    rest : (nx, ny, nz) float64
        Part of the beamlets that goes on beyond the layer [0..1].
    """

    side: NDArray[np.int8]
    height: NDArray[np.float64]
    rest: NDArray[np.float64]

    def part(
        self, voxel: tuple[NDArray[np.int64], ...], offset: tuple[NDArray[np.float64], ...]
    ) -> NDArray[np.float64]:
        """In which part the flightline counts around points: (n,) float64 [0..1].

        Parameters
        ----------
        voxel : three of (n,) int64
            Index of each point's voxel, of one in which the gate ends.
        offset : three of (n,) float64
            From its centre [voxels, -0.5..0.5].
        """
        x, y, z = voxel
        side, own, rest = self.side[voxel], self.height[voxel], self.rest[voxel]
        i, j = (
            np.clip(index + np.where(part < 0.0, -1, 1), 0, size - 1)
            for index, part, size in zip((x, y), offset, self.side.shape, strict=False)
        )
        right, ahead = np.abs(offset[0]), np.abs(offset[1])
        height = (1.0 - right) * (1.0 - ahead) * own
        for at, weight in (
            ((i, y, z), right * (1.0 - ahead)),
            ((x, j, z), (1.0 - right) * ahead),
            ((i, j, z), right * ahead),
        ):
            height += weight * np.where(self.side[at] == side, self.height[at], own)
        beyond = side * (offset[2] - height) * SQUARES
        listened = at_least(np.clip(0.5 - beyond, 0.0, 1.0), BELOW_AN_END, 0.5)
        part: NDArray[np.float64] = rest + (1.0 - rest) * listened
        return part


def to_the_ends(
    amount: NDArray[np.int64], beamlets: NDArray[np.float32], voxel_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], Ends]:
    """What one beamlet over a square stands for, voxels if the gate ended in none [1/m3], its ends.

    What one beamlet stands for is that in a voxel and, with less weight, in the eight around.
    """
    points = amount / (VOXEL_FIXED_POINT * voxel_m**3)
    own = of_spheres(beamlets)
    number = nine(own)
    part = ratio(nine(points), number)
    # a layer that few beamlets reach, those that leave the others', tells nothing
    tells = number >= ENOUGH * tallest(number)
    # beamlets cross all layers: what differs by chance are those that lean in and out
    error = CUT / np.sqrt(np.maximum(SQUARES**2 * number, CUT**2))
    # and what cuts off less than sticks out of a voxel ends none of it
    error = np.maximum(error, SLIVER)
    cut = part < (1.0 - error) * tallest(np.where(tells, part, 0.0))
    sums = nine(points, HERE), nine(own, HERE)
    here = np.where(tells, ratio(*sums), 0.0)
    each = np.where(cut | ~tells, tallest(here), here)
    last = ends(*sums, each, cut)
    return each, np.where(cut, np.maximum(each * own, points), points), last


def ends(
    amount: NDArray[np.float64],
    number: NDArray[np.float64],
    each: NDArray[np.float64],
    cut: NDArray[np.bool_],
) -> Ends:
    """Ends of a gate by what is left of the spheres that they cut.

    Parameters
    ----------
    amount : (nx, ny, nz) float64
        Noise in each sphere.
    number : (nx, ny, nz) float64
        Beamlets that reach it.
    each : (nx, ny, nz) float64
        Noise that one of them stands for where it listens to all of a sphere.
    cut : (nx, ny, nz) bool
        Layers in which the gate ends.
    """
    above, below = _beside(amount)
    side = np.where(above < below, 1, -1).astype(np.int8)
    side[~cut | (above == below)] = 0
    beyond, on = (np.where(side > 0, up, down) for up, down in (_beside(amount), _beside(number)))
    goes_on = beyond > SLIVER * each * on
    rest = np.where(goes_on, np.minimum(ratio(on, number), 1.0), 0.0)
    side[rest == 1.0] = 0
    listened = ratio(ratio(amount, each * number) - rest, 1.0 - rest)
    inside = np.clip(2.0 * listened - 1.0, -1.0, 1.0)
    height = sphere_radius_m(1.0) * 2.0 * np.sin(np.arcsin(inside) / 3.0)
    return Ends(side, np.where(side < 0, -height, height).astype(np.float64), rest)


def at_least(
    part: NDArray[np.float64], least: NDArray[np.floating[Any]] | float, beyond: float
) -> NDArray[np.float64]:
    """In which part a flightline counts where so much of what lies around is listened to: (n,).

    Parameters
    ----------
    part : (n,) float64
        What is listened to, linear over a square or as much height [0..1].
    least : (n,) floating, or float
        Part in which it counts at least, from soon after ``beyond`` on.
    beyond : float
        Up to there it counts in the very part.
    """
    found: NDArray[np.float64] = np.maximum(
        part, np.minimum(least, beyond + STEEP * (part - beyond))
    )
    return found


def _beside(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Those of the layer above and of the layer below, 0 without one."""
    above, below = np.zeros_like(values), np.zeros_like(values)
    above[:, :, :-1], below[:, :, 1:] = values[:, :, 1:], values[:, :, :-1]
    return above, below


def ratio(total: NDArray[np.float64], number: NDArray[np.float64]) -> NDArray[np.float64]:
    """One over the other, 0 where that is 0."""
    some = number > 0.0
    found: NDArray[np.float64] = np.where(some, total / np.where(some, number, 1.0), 0.0)
    return found
