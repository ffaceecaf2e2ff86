"""Chords: lengths of beamlets inside the spheres of a voxel lattice [W17 Eq. 5.2, 6.1; W18 Eq. 1].

Every beamlet is reckoned from the voxel that holds its own return: its chords are the same to the
last bit, whatever else is deposited.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import LANES

MOST: Final = int(np.iinfo(np.uint16).max)
"""Where the count of a square stops."""


@njit()
def chord_length(
    px: float, py: float, pz: float,
    ux: float, uy: float, uz: float,
    near: float, far: float, radius: float,
) -> float:  # fmt: skip
    """Length inside a sphere around zero of a line through p, from ``near`` to ``far`` along it."""
    middle = -(px * ux + py * uy + pz * uz)
    square = radius * radius - (px * px + py * py + pz * pz - middle * middle)
    if square <= 0.0:
        return 0.0
    half = math.sqrt(square)
    return max(0.0, min(middle + half, far) - max(middle - half, near))


@njit()
def cover(
    voxel: NDArray[np.int64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: float,
    far: float,
    edge: float,
    radius: float,
    share: int,
    squares: NDArray[np.uint16],
) -> None:
    """Count a beamlet in the squares that it crosses half-way up each layer that it listens in.

    A square is a quarter of a voxel's edge wide, a layer as high as its spheres: all that adds to
    their amount counts. Square (x, y) of a voxel is at ``x * 4 + y``.
    """
    along = direction[2]
    ends = (point[2] + near * along, point[2] + far * along)
    half = 0.5 * edge
    first = math.ceil((min(ends) - radius) / edge)
    for layer in range(first, math.floor((max(ends) + radius) / edge) + 1):
        # Far from the vertical a beam would leave the box on its way to a layer that it only nears.
        t = min(max((layer * edge - point[2]) / along, near - 1.5 * radius), far + 1.5 * radius)
        x = math.floor((point[0] + t * direction[0] + half) * (4.0 / edge))
        y = math.floor((point[1] + t * direction[1] + half) * (4.0 / edge))
        of_voxel = squares[voxel[0] + x // 4, voxel[1] + y // 4, voxel[2] + layer]
        at = x % 4 * 4 + y % 4
        held = np.int64(of_voxel[at]) + np.int64(share)
        of_voxel[at] = np.uint16(min(held, np.int64(MOST)))


def steepness(edge: float, radius: float) -> float:
    """Vertical part of a direction from which on :func:`deposit_steep` measures every sphere.

    ``sqrt(2) edge`` times it is the least distance at which a line sees the centres of two spheres
    across from each other. A little more than ``2 radius`` leaves room for rounding.
    """
    return 1.000001 * math.sqrt(2.0) * radius / edge


@njit()
def deposit_steep(
    rows: NDArray[np.int64],
    voxel: NDArray[np.int64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    weight: NDArray[np.float64],
    edge: float,
    radius: float,
    amount: NDArray[np.int64],
    share: NDArray[np.int64],
    squares: NDArray[np.uint16],
) -> None:
    """What :func:`deposit_beamlets` adds, to the last bit, for steep beams and with squares.

    A steep line can touch the four spheres around it in a layer, and of two across from each other
    only the one that it runs deeper in. These two are measured without a branch, so the loop
    compiles to vector instructions; it runs to a multiple of :data:`LANES`. ``rows``: beamlets
    whose direction is nearest to the vertical axis, by at least :func:`steepness`. The box reaches
    a voxel beyond all that a beam touches.
    """
    _, ny, nz = amount.shape
    amounts, counts = amount.reshape(-1), squares.reshape(-1)
    room = nz + LANES
    square, sphere = np.empty(room, np.uint64), np.empty((2, room), np.uint64)
    adds = np.empty((2, room), np.int64)
    half, per_edge, per_square = 0.5 * edge, 1.0 / edge, 4.0 / edge
    for each in rows:
        row = np.uint64(each)
        ux, uy, along = direction[row, 0], direction[row, 1], direction[row, 2]
        px, py, pz = point[row, 0], point[row, 1], point[row, 2]
        i0, j0, k0 = voxel[row, 0], voxel[row, 1], voxel[row, 2]
        # Own names: values in an array are read again after each store into another one.
        start, stop, per_m, shared = near[row], far[row], weight[row], share[row]
        low, high = pz + start * along, pz + stop * along
        if low > high:
            low, high = high, low
        first = math.ceil((low - radius) / edge)
        layers = math.floor((high + radius) / edge) + 1 - first
        for layer in range((layers + LANES - 1) // LANES * LANES):
            t = ((first + layer) * edge - pz) / along
            x, y = px + t * ux, py + t * uy
            k = k0 + first + layer
            i, j = np.floor((x + half) * per_square), np.floor((y + half) * per_square)
            a, b = np.int64(i), np.int64(j)
            at = ((i0 + (a >> 2)) * ny + j0 + (b >> 2)) * nz + k
            square[layer] = at * 16 + (a & 3) * 4 + (b & 3)
            i, j = np.floor(x * per_edge), np.floor(y * per_edge)
            at = ((i0 + np.int64(i)) * ny + j0 + np.int64(j)) * nz + k
            # Spheres (0, 0) and (1, 1) of the four, then (0, 1) and (1, 0).
            for side in range(2):
                dx, dy = x - i * edge, y - (j + side) * edge
                middle = -(dx * ux + dy * uy)
                rest = radius * radius - (dx * dx + dy * dy - middle * middle)
                dx, dy = x - (i + 1) * edge, y - (j + (1 - side)) * edge
                opposite = -(dx * ux + dy * uy)
                left = radius * radius - (dx * dx + dy * dy - opposite * opposite)
                turn = left > rest
                middle = opposite if turn else middle
                reach = math.sqrt(max(left if turn else rest, 0.0))
                begin, end = middle - reach, middle + reach
                begin = max(begin, start - t)
                end = min(end, stop - t)
                adds[side, layer] = np.int64(np.rint(per_m * max(end - begin, 0.0)))
                sphere[side, layer] = at + (ny * nz + (1 - side) * nz if turn else side * nz)
        for layer in range(layers):
            amounts[sphere[0, layer]] += adds[0, layer]
            amounts[sphere[1, layer]] += adds[1, layer]
        for layer in range(layers):
            held = np.int64(counts[square[layer]])
            counts[square[layer]] = np.uint16(min(held + shared, MOST))


def deposit_beamlets(
    voxel: NDArray[np.int64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    weight: NDArray[np.float64],
    edge: float,
    radius: float,
    ordinal: NDArray[np.int64],
    amount: NDArray[np.int64],
    shots: NDArray[np.int64],
    beamlets: NDArray[np.int64],
    share: NDArray[np.int64],
    squares: NDArray[np.uint16],
) -> None:
    """Add every beamlet's chords to every sphere that it crosses.

    Only spheres near the line are looked at, in each layer along the axis that it follows most.

    ``voxel``: (n, 3), that of the return, relative to the corner of ``amount``; ``point``: the
    return, relative to its centre; ``near``, ``far``: ends of the gate along the beam, from the
    return [m]. Added to: ``amount`` (nx, ny, nz); where not empty, ``shots`` and ``beamlets``,
    which touch each sphere, of shots numbered by ``ordinal``, and, by ``share``, ``squares`` (nx,
    ny, nz, 16), up to :data:`MOST`; see :func:`cover`.
    """
    least = steepness(edge, radius) if squares.size and not beamlets.size else np.inf
    upright = np.abs(direction[:, 2])
    steep = upright >= least
    for axis in (0, 1):
        steep &= upright >= np.abs(direction[:, axis])
    rows = voxel, point, direction, near, far, weight, edge, radius, amount, share, squares
    deposit_steep(np.flatnonzero(steep), *rows)
    last_shot = np.full(beamlets.shape, -1, np.int64)
    _deposit_others(np.flatnonzero(~steep), *rows, ordinal, shots, beamlets, last_shot)


@njit()
def _deposit_others(  # type: ignore[no-untyped-def]
    rows, voxel, point, direction, near, far, weight, edge, radius, amount, share, squares,
    ordinal, shots, beamlets, last_shot,
):  # fmt: skip
    """:func:`deposit_beamlets` of some rows; ``last_shot``: that of each sphere, -1 at first."""
    index = np.empty(3, dtype=np.int64)
    for row in rows:
        at, ray, start, stop = point[row], direction[row], near[row], far[row]
        if squares.size:
            cover(voxel[row], at, ray, start, stop, edge, radius, share[row], squares)
        axis = 2
        for other in (1, 0):
            if abs(ray[other]) > abs(ray[axis]):
                axis = other
        p, q, along = (axis + 1) % 3, (axis + 2) % 3, ray[axis]
        ends = (at[axis] + start * along, at[axis] + stop * along)
        for layer in range(
            math.ceil((min(ends) - radius) / edge), math.floor((max(ends) + radius) / edge) + 1
        ):
            t = (layer * edge - at[axis]) / along
            x, y = at[p] + t * ray[p], at[q] + t * ray[q]
            index[axis] = voxel[row, axis] + layer
            # The line reaches no sphere beyond the eight around the nearest one: along its main
            # axis it leaves none of them more than sqrt(3) radii to the side.
            for side in range(9):
                i, j = round(x / edge) + side // 3 - 1, round(y / edge) + side % 3 - 1
                index[p], index[q] = voxel[row, p] + i, voxel[row, q] + j
                chord = chord_length(
                    x - i * edge, y - j * edge, 0.0, ray[p], ray[q], along,
                    start - t, stop - t, radius,
                )  # fmt: skip
                sphere = (index[0], index[1], index[2])
                amount[sphere] += int(np.rint(weight[row] * chord))
                if chord > 0.0 and beamlets.size:
                    beamlets[sphere] += 1
                    shots[sphere] += last_shot[sphere] != ordinal[row]
                    last_shot[sphere] = ordinal[row]
