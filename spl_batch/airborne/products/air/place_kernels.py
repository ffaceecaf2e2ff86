"""Kernels of fog and thin haze: points by places, their heights, and pairs of them."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NOISE_AFTERPULSE, NOISE_NOT_ASSESSED, QUANTUM_M
from spl_batch.numerics.compiled import njit

Index = NDArray[np.int64]


@njit()
def in_places(
    x: Index, y: Index, kind: NDArray[np.uint8], frame: tuple[int, int, int, int],
    edge: int, cell: int,
) -> tuple[Index, Index, Index]:  # fmt: skip
    """Points that count and lie in places, and the place and cell of each.

    ``frame``: west and south [quanta], columns and rows.
    """
    west, south, columns, rows = frame
    chosen, place, within = np.empty((3, len(x)), np.int64)
    parts, held = edge // cell, 0
    for i in range(len(x)):
        east, north = x[i] - west, y[i] - south
        column, row = east // edge, north // edge
        if kind[i] == NOISE_AFTERPULSE or kind[i] == NOISE_NOT_ASSESSED:
            continue
        if 0 <= column < columns and 0 <= row < rows:
            chosen[held], place[held] = i, row * columns + column
            within[held] = north % edge // cell * parts + east % edge // cell
            held += 1
    return chosen[:held], place[:held], within[:held]


@njit()
def heights(
    z: NDArray[np.int32], surface: NDArray[np.float64], place: Index, places: int,
    floor_m: float, half_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:  # fmt: skip
    """Half metres above the surface, and above its lowest of a place; where points lie on it."""
    lowest, grounded = np.full(places, np.inf), np.zeros(places, np.bool_)
    half_metre, level = np.empty((2, len(z)))
    for i in range(len(z)):
        height = z[i] * QUANTUM_M - surface[i]
        half_metre[i] = np.floor((height - floor_m) / half_m)
        grounded[place[i]] |= abs(height) < floor_m / 2
        lowest[place[i]] = np.fmin(lowest[place[i]], surface[i])
    for i in range(len(z)):
        level[i] = np.floor((z[i] * QUANTUM_M - lowest[place[i]] - floor_m) / half_m)
    return half_metre, level, grounded


@njit()
def count_layers(
    place: Index, within: Index, half_metre: NDArray[np.float64], kept: NDArray[np.bool_],
    layers: int, wide: Index, room: NDArray[np.int32], out: Index,
) -> None:  # fmt: skip
    """Add returns, their ordered pairs in wide cells, and those kept, by place and half metre.

    ``wide``: wide cell of each cell of a place; ``room``: zeros, by layers and wide cells.
    """
    for i in range(len(place)):
        if 0 <= half_metre[i] < layers:
            number = place[i] * layers + int(half_metre[i])
            cell = wide[within[i]]
            out[0, number] += 1
            out[1, number] += 2 * room[number, cell]
            out[2, number] += kept[i]
            room[number, cell] += 1
