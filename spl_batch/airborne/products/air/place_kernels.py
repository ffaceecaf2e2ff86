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
    # In the middle of its quantum no quotient is near a whole number.
    cells, places = 1.0 / cell, 1.0 / parts
    for i in range(len(x)):
        east, north = x[i] - west, y[i] - south
        if kind[i] == NOISE_AFTERPULSE or kind[i] == NOISE_NOT_ASSESSED:
            continue
        if 0 <= east < columns * edge and 0 <= north < rows * edge:
            a, b = np.int64((east + 0.5) * cells), np.int64((north + 0.5) * cells)
            column, row = np.int64((a + 0.5) * places), np.int64((b + 0.5) * places)
            chosen[held], place[held] = i, row * columns + column
            within[held] = (b - row * parts) * parts + a - column * parts
            held += 1
    return chosen[:held], place[:held], within[:held]


@njit()
def below(
    x: Index, y: Index, chosen: Index, corner: tuple[int, int], size: int,
    highest: NDArray[np.float32],
) -> NDArray[np.float64]:  # fmt: skip
    """Value of the cell below each chosen point, of cells that hold them all, north up.

    ``corner``: west and south; ``size``: edge of a cell [quanta].
    """
    out, cells, last = np.empty(len(chosen)), 1.0 / size, len(highest) - 1
    for k in range(len(chosen)):
        i = chosen[k]
        row = last - np.int64((y[i] - corner[1] + 0.5) * cells)
        out[k] = highest[row, np.int64((x[i] - corner[0] + 0.5) * cells)]
    return out


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
    layers: int, wide: Index, cells: NDArray[np.uint16], out: Index,
) -> None:  # fmt: skip
    """Add returns, their ordered pairs in wide cells, and those kept, by place and half metre.

    ``wide``: wide cell of each cell of a place; ``cells`` (layers of all places, wide cells):
    zeros, filled with the returns of each, up to the most that they take; ``out`` (layers of all
    places, 3).
    """
    most = np.iinfo(np.uint16).max
    for i in range(len(place)):
        if 0 <= half_metre[i] < layers:
            number = place[i] * layers + int(half_metre[i])
            cell = wide[within[i]]
            held = np.int64(cells[number, cell])
            out[number, 0] += 1
            out[number, 1] += 2 * held
            out[number, 2] += kept[i]
            cells[number, cell] = np.uint16(held + (held < most))


@njit()
def count_emptier(
    cells: NDArray[np.uint16], asked: NDArray[np.bool_], layers: int, deep: int, step: int,
    fewest: int, out: Index,
) -> None:  # fmt: skip
    """Returns and their ordered pairs in the columns of a block that hold least.

    ``cells``: as of :func:`count_layers`; ``asked`` (places, blocks); ``deep``: layers of a block;
    ``step``: layers from one block to the next; ``fewest``: how many of the columns; of equal ones
    the first; ``out`` (places, blocks, 2): zeros.
    """
    columns = cells.shape[1]
    total = np.empty(columns, np.int64)
    for place in range(asked.shape[0]):
        for block in range(asked.shape[1]):
            if not asked[place, block]:
                continue
            first = place * layers + block * step
            total[:] = 0
            for layer in range(first, first + deep):
                for column in range(columns):
                    total[column] += cells[layer, column]
            for _ in range(fewest):
                least = total.argmin()
                out[place, block, 0] += total[least]
                for layer in range(first, first + deep):
                    held = np.int64(cells[layer, least])
                    out[place, block, 1] += held * (held - 1)
                total[least] = np.iinfo(np.int64).max
