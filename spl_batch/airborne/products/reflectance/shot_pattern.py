r"""Least-squares fit of where the beamlets of a few shots point.

Within a few milliseconds the place where a beamlet meets a reference plane is a smooth
function of the shot and an affine one of the beamlet's place in the array, which turns:

.. math:: p = \sum_{k<4} a_k \tau^k + (b_0 + b_1 \tau) g_x + (c_0 + c_1 \tau) g_y

with :math:`\tau` from -1 to 1 over the block of shots and :math:`g` the place in the array.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import LANES, TOGETHER, load, spread, store

TERMS = LANES
"""Coefficients of each coordinate: as many as there are lanes."""


Rows = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]
"""Returns of blocks, those of one from its ``start`` on: (m + 1,); time within the block, channel,
and where the reference plane is met, from the block's anchor on [m]: (n,), (n,), (n, 2)."""


@njit()
def basis(tau: float, gx: float, gy: float, out: NDArray[np.float64]) -> None:
    """Value of each term into ``out`` (TERMS,); ``tau``: time within the block, -1 to 1."""
    out[0] = 1.0
    out[1] = tau
    out[2] = tau * tau
    out[3] = tau * tau * tau
    out[4] = gx
    out[5] = gx * tau
    out[6] = gy
    out[7] = gy * tau


@njit()
def normal_equations(
    rows: Rows,
    pattern: NDArray[np.float64],
    matrix: NDArray[np.float64],
    right: NDArray[np.float64],
) -> None:
    """Sums that the coefficients of each block follow from, into ``matrix`` and ``right``.

    ``pattern`` (m, c, 2): place of each channel in the array; rows of a channel without one (NaN)
    are left out.
    """
    start, tau, channel, place = rows
    term, right_of, zero = np.empty((TOGETHER, TERMS)), np.empty((TOGETHER, 2)), np.uint64(0)
    for b in range(len(start) - 1):
        # A register for each row of the matrix: what stands in arrays is stored after each return.
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = x = y = spread(0.0)
        for begin in range(start[b], start[b + 1], TOGETHER):
            # What has just been stored number by number cannot be loaded at once yet.
            count = 0
            for row in range(begin, min(begin + TOGETHER, start[b + 1])):
                gx, gy = pattern[b, channel[row], 0], pattern[b, channel[row], 1]
                basis(tau[row], gx, gy, term[count])
                right_of[count, 0], right_of[count, 1] = place[row, 0], place[row, 1]
                count += not np.isnan(gx)
            for k in range(count):
                terms = load(term, (np.uint64(k), zero))
                a0 = a0 + terms
                a1 = a1 + spread(term[k, 1]) * terms
                a2 = a2 + spread(term[k, 2]) * terms
                a3 = a3 + spread(term[k, 3]) * terms
                a4 = a4 + spread(term[k, 4]) * terms
                a5 = a5 + spread(term[k, 5]) * terms
                a6 = a6 + spread(term[k, 6]) * terms
                a7 = a7 + spread(term[k, 7]) * terms
                x = x + spread(right_of[k, 0]) * terms
                y = y + spread(right_of[k, 1]) * terms
        for i, line in enumerate((a0, a1, a2, a3, a4, a5, a6, a7)):
            store(matrix, (np.uint64(b), np.uint64(i), zero), line)
        store(term, (zero, zero), x)
        store(term, (np.uint64(1), zero), y)
        for i in range(TERMS):
            right[b, i, 0], right[b, i, 1] = term[0, i], term[1, i]


@njit()
def misfit(
    rows: Rows,
    pattern: NDArray[np.float64],
    coefficient: NDArray[np.float64],
    rms: NDArray[np.float64],
) -> None:
    """Root mean square distance of the rows of each block from its fit [m]; NaN without rows."""
    start, tau, channel, place = rows
    term = np.empty(TERMS)
    for b in range(len(start) - 1):
        total, count = 0.0, 0
        for row in range(start[b], start[b + 1]):
            gx, gy = pattern[b, channel[row], 0], pattern[b, channel[row], 1]
            if np.isnan(gx):
                continue
            basis(tau[row], gx, gy, term)
            for axis in range(2):
                at = 0.0
                for i in range(TERMS):
                    at += coefficient[b, i, axis] * term[i]
                total += (place[row, axis] - at) ** 2
            count += 1
        rms[b] = np.sqrt(total / count) if count else np.nan


@njit()
def learn_pattern(
    rows: Rows, coefficient: NDArray[np.float64], pattern: NDArray[np.float64]
) -> None:
    """Mean place of each channel in the array, NaN without rows, given how the array turns.

    ``coefficient`` of a block whose array is a point: it takes the ground's own axes.
    """
    start, tau, channel, place = rows
    channels = pattern.shape[1]
    count = np.empty(channels)
    for b in range(len(start) - 1):
        count[:] = 0.0
        pattern[b] = 0.0
        a = coefficient[b]
        for row in range(start[b], start[b + 1]):
            t = tau[row]
            x = place[row, 0] - (a[0, 0] + t * (a[1, 0] + t * (a[2, 0] + t * a[3, 0])))
            y = place[row, 1] - (a[0, 1] + t * (a[1, 1] + t * (a[2, 1] + t * a[3, 1])))
            xx, xy = a[4, 0] + t * a[5, 0], a[6, 0] + t * a[7, 0]
            yx, yy = a[4, 1] + t * a[5, 1], a[6, 1] + t * a[7, 1]
            turn = xx * yy - xy * yx
            if turn != 0.0:
                x, y = (yy * x - xy * y) / turn, (xx * y - yx * x) / turn
            c = channel[row]
            pattern[b, c, 0] += x
            pattern[b, c, 1] += y
            count[c] += 1.0
        for c in range(channels):
            if count[c] > 0.0:
                pattern[b, c, 0] /= count[c]
                pattern[b, c, 1] /= count[c]
            else:
                pattern[b, c] = np.nan


@njit()
def motion(
    start: NDArray[np.int64],
    tau: NDArray[np.float64],
    origin: NDArray[np.float64],
    anchor: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Straight lines that the sensor flies during the blocks, by least squares: (m, 2, 3) [m].

    ``origin``: sensor at each row; the sensor at the middle of each block, from its anchor, and its
    motion; it rests where all rows are of one time.
    """
    mean = np.empty(3)
    for b in range(len(start) - 1):
        rows = range(start[b], start[b + 1])
        mean_t, spread = 0.0, 0.0
        for axis in range(3):
            mean[axis] = out[b, 1, axis] = 0.0
        for row in rows:
            mean_t += tau[row]
            for axis in range(3):
                mean[axis] += origin[row, axis] - anchor[b, axis]
        mean_t /= len(rows)
        for axis in range(3):
            mean[axis] /= len(rows)
        for row in rows:
            t = tau[row] - mean_t
            spread += t * t
            for axis in range(3):
                out[b, 1, axis] += t * (origin[row, axis] - anchor[b, axis] - mean[axis])
        for axis in range(3):
            out[b, 1, axis] = out[b, 1, axis] / spread if spread > 0.0 else 0.0
            out[b, 0, axis] = mean[axis] - mean_t * out[b, 1, axis]
