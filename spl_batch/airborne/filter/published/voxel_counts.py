"""Counts in the voxels of an absolute lattice, and in the 27 around each.

Only occupied voxels are held: their keys, sorted, with z running fastest, so that three
voxels above each other are one stretch of keys.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Voxels(NamedTuple):
    """Occupied voxels of a lattice, m of them."""

    key: NDArray[np.int64]  #: (m,): increasing; x, y and z index in one number.
    points: NDArray[np.int64]  #: (m,): points in each.
    of_point: NDArray[np.int64]  #: (n,): voxel of each point.
    stride: tuple[int, int]  #: Key steps along x and along y; along z it is one.


def lattice_index(
    values: NDArray[np.int32] | NDArray[np.int64], anchor: int, edge: int
) -> NDArray[np.int64]:
    """Index on a lattice that starts at absolute zero.

    Parameters
    ----------
    values : (n,) int
        Coordinates relative to ``anchor`` [quanta].
    anchor : int
        Their absolute origin [quanta].
    edge : int
        Edge of a cell [quanta], > 0.

    Returns
    -------
    (n,) int64
        Relative to the anchor's own cell, so >= 0 for values >= 0.
    """
    index: NDArray[np.int64] = (values.astype(np.int64) + anchor % edge) // edge
    return index


def voxelise(
    xyz: NDArray[np.int32], anchor: tuple[int, int, int], edges: tuple[int, int, int]
) -> Voxels:
    """Sort points into the voxels of an absolute lattice.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to ``anchor`` [quanta]; >= 0.
    anchor : tuple of int
        Their absolute origin [quanta].
    edges : tuple of int
        Edges of a voxel along x, y, z [quanta], > 0.

    Raises
    ------
    ValueError
        If the region has more voxels than keys.
    """
    index = [lattice_index(xyz[:, a], anchor[a], edges[a]) for a in range(3)]
    # One empty voxel between two columns, so that a stretch of three never runs into the next.
    size = [int(i.max()) + 2 if len(i) else 2 for i in index]
    if size[0] * size[1] * size[2] >= 2**62:
        raise ValueError(f"voxels of {edges} quanta are too small for this region")
    key = (index[0] * size[1] + index[1]) * size[2] + index[2]
    del index  # of a block of millions each array counts
    keys, of_point, count = np.unique(key, return_inverse=True, return_counts=True)
    return Voxels(keys, count, of_point.astype(np.int64), (size[1] * size[2], size[2]))


def squares(xyz: NDArray[np.int32], anchor: tuple[int, int, int], edge: int) -> NDArray[np.int64]:
    """Square of an absolute grid that each point lies in, numbered from zero: (n,) int64."""
    i = lattice_index(xyz[:, 0], anchor[0], edge)
    j = lattice_index(xyz[:, 1], anchor[1], edge)
    _, number = np.unique(i * (int(j.max(initial=0)) + 1) + j, return_inverse=True)
    square: NDArray[np.int64] = number.astype(np.int64)
    return square


def window_counts(voxels: Voxels) -> NDArray[np.int64]:
    """Points in each voxel and the 26 around it: (m,) int64."""
    key = voxels.key
    before = np.concatenate([[0], np.cumsum(voxels.points)])
    total = np.zeros(len(key), dtype=np.int64)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            middle = key + i * voxels.stride[0] + j * voxels.stride[1]
            first = np.searchsorted(key, middle - 1, side="left")
            last = np.searchsorted(key, middle + 1, side="right")
            total += before[last] - before[first]
    return total
