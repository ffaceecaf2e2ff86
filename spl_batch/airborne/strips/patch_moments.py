"""Counts and sums of points in small squares, by flightline: exact, whatever their order."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def add_moments(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    z: NDArray[np.int64],
    strip: NDArray[np.int16],
    corner: NDArray[np.int64],
    edge: int,
    joined: int,
    moments: NDArray[np.int64],
) -> None:
    """Add points to the sums of the squares that they lie in.

    Sums of ``joined`` x ``joined`` squares have one origin, the middle of all of them, so that
    they may be added up.

    Parameters
    ----------
    x, y, z : (n,) int64
        Places on the lattice [quanta].
    strip : (n,) int16
        Flightline of each point.
    corner : (3,) int64
        South-west corner of the first square and a height below all points [quanta].
    edge : int
        Edge of a square [quanta].
    joined : int
        Squares along an edge that share an origin; it divides the rows and columns.
    moments : (strips, rows, columns, 10) int64
        Is added to: count and sums of x, y, z, xx, xy, yy, xz, yz, zz [quanta, quanta2].
    """
    rows, columns = moments.shape[1], moments.shape[2]
    half = joined * edge // 2
    for k in range(len(x)):
        i, j = (x[k] - corner[0]) // edge, (y[k] - corner[1]) // edge
        if i < 0 or j < 0 or i >= columns or j >= rows:
            continue
        dx = x[k] - corner[0] - (i // joined) * joined * edge - half
        dy = y[k] - corner[1] - (j // joined) * joined * edge - half
        dz = z[k] - corner[2]
        sums = moments[strip[k], j, i]
        sums[0] += 1
        sums[1] += dx
        sums[2] += dy
        sums[3] += dz
        sums[4] += dx * dx
        sums[5] += dx * dy
        sums[6] += dy * dy
        sums[7] += dx * dz
        sums[8] += dy * dz
        sums[9] += dz * dz


def doubled(moments: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sums of squares of twice the edge: (strips, rows / 2, columns / 2, 10)."""
    strips, rows, columns, kinds = moments.shape
    paired = moments.reshape(strips, rows // 2, 2, columns // 2, 2, kinds)
    summed: NDArray[np.int64] = paired.sum(axis=(2, 4))
    return summed
