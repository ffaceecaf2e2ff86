"""How beams of a flightline lean, by the squares that their beamlets cross in layer after layer.

Domain: space. What beamlets over squares show, edges and ridges, goes on from one layer to the
next along the beams, a metre to three farther. The step from a layer to the next one upwards is
what the slopes along x and y and the lean make of it: ``step = -(slope_x lean_x + slope_y
lean_y)``, solved by least squares over a voxel and the eight around it (Lucas and Kanade 1981, An
iterative image registration technique, IJCAI). Where nothing has slopes the lean makes no
difference, and is held for none.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.kernels.squares import slopes_and_steps
from spl_batch.stages.beamlet_counts import nine
from spl_batch.stages.voxel_noise import UNEVEN

DOMAIN: Final = "space"

MOST: Final = 2.0
"""Squares that beams lean at most from layer to layer: 27 degrees [count].

No more, or the density at a point looks farther than ``local_noise.MARGIN_VOXELS``."""

OWN: Final = 3.0
"""Weight of a voxel against those on either side."""

LAYERS: Final = 2
"""Pairs of layers on either side that tell a layer's lean: beams are straight."""

CHANCE: Final = 0.25
"""Mean square of slopes, in beamlets over a square, as far as which leans are held for none: twice
what chance makes."""


def lean(
    smooth: NDArray[np.float32], number: NDArray[np.float64], mean: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far beams lean from a layer to the next one upwards, by voxel.

    Parameters
    ----------
    smooth : (4 nx, 4 ny, nz) float32
        Beamlets over squares, smoothed by those around [count].
    number : (nx, ny, nz) float64
        Beamlets over all squares of each voxel [count].
    mean : (nx, ny, nz) float64
        Beamlets over a covered square around each voxel [count].

    Returns
    -------
    (2, nx, ny, nz) float64
        Along x and y [squares].
    """
    nx, ny, nz = mean.shape
    pairs = np.zeros((6, nx, ny, nz - 1))
    slopes_and_steps(smooth, pairs[:5])
    pairs[5] = CHANCE * (number[:, :, 1:] + number[:, :, :-1]) / 2.0
    low, high = mean[:, :, :-1], mean[:, :, 1:]
    # between other layers a gate ends, and the step is not the lean's
    alike = (low < UNEVEN * high) & (high < UNEVEN * low)
    sums = np.zeros((6, nx, ny, nz))
    for k, values in enumerate(pairs):
        around = nine(values, OWN) * alike
        for shift in range(-LAYERS, LAYERS):
            first, last = max(0, -shift), min(nz, nz - 1 - shift)
            sums[k, :, :, first:last] += around[:, :, first + shift : last + shift]
    xx, xy, yy, xt, yt, chance = sums
    xx, yy = xx + chance, yy + chance
    area = xx * yy - xy * xy
    some = area > 0.0
    area = np.where(some, area, 1.0)
    found = np.stack([xy * yt - yy * xt, xy * xt - xx * yt]) / area
    return np.clip(np.where(some, found, 0.0), -MOST, MOST)
