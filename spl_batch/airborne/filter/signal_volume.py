"""Cubes of an absolute lattice that hold points, each with the largest amount of its points."""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

_Place = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]

AMOUNT_BITS = 23
"""Bits of a number for the amount; the others tell the cube."""

_MOST = (1 << AMOUNT_BITS) - 1


@njit()
def pack_cubes(
    place: _Place,
    kind: NDArray[np.uint8],
    wanted: int,
    density: NDArray[np.float32],
    box: tuple[int, int, int, int],
    edge: int,
    scale: float,
    out: NDArray[np.int64],
) -> int:
    """One number for each point of a kind: its cube, and an amount.

    Parameters
    ----------
    place : three (n,) of integers
        Points [quanta].
    kind : (n,) uint8
        What they are.
    density : (n,) float32
        Points without a finite one are left out.
    box : (int, int, int, int)
        West, south, east and north: cubes whose south-western corner lies in it [quanta].
    edge : int
        Of a cube [quanta].
    scale : float
        Amount of a density of 1, of which the whole number counts, at most
        2**:data:`AMOUNT_BITS` - 1.
    out : (n,) int64, written from the front
        ``cube << AMOUNT_BITS | amount``.
    """
    x, y, z = place
    # No quotient of whole numbers so small rounds up to the next whole one.
    west, east = math.ceil(box[0] / edge), math.ceil(box[2] / edge)
    south, north = math.ceil(box[1] / edge), math.ceil(box[3] / edge)
    if not len(z):
        return 0
    low, high = z[0], z[0]
    for height in z:
        low, high = min(low, height), max(high, height)
    bottom = np.int64(math.floor(low / edge))
    layers = np.int64(math.floor(high / edge)) - bottom + 1
    count = 0
    for i in range(len(z)):
        if kind[i] != wanted or not math.isfinite(density[i]):
            continue
        column, row = np.int64(math.floor(x[i] / edge)), np.int64(math.floor(y[i] / edge))
        if west <= column < east and south <= row < north:
            layer = np.int64(math.floor(z[i] / edge)) - bottom
            cube = ((column - west) * (north - south) + row - south) * layers + layer
            amount = np.int64(np.rint(np.float64(density[i]) * scale))
            out[count] = cube << AMOUNT_BITS | min(amount, np.int64(_MOST))
            count += 1
    return count


@njit()
def sum_of_largest(packed: NDArray[np.int64]) -> int:
    """Sum of the largest amount of each cube.

    ``packed``: (n,) int64, numbers of :func:`pack_cubes`, cube by cube in any order.
    """
    total = most = 0
    for i in range(len(packed)):
        most = max(most, packed[i] & _MOST)
        if i + 1 == len(packed) or packed[i + 1] >> AMOUNT_BITS != packed[i] >> AMOUNT_BITS:
            total += most
            most = 0
    return total
