"""The arithmetic coder of LASzip for layers of classes and of extra bytes.

Source: LASzip, ``arithmeticencoder.cpp`` and ``arithmeticmodel.cpp``, after A. Said's FastAC; which
model foretells a symbol as in ``laswriteitemcompressed_v3.cpp``. What is written is what LASzip
writes, byte by byte. Several scanner channels in a chunk are left to the compressor at hand.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

_SYMBOLS = 256
_LENGTH_BITS = 15
_COUNT_MAX = 1 << 15
_CYCLE_FIRST = (_SYMBOLS + 6) >> 1
_CYCLE_MAX = (_SYMBOLS + 6) << 3
_LENGTH_MIN = 1 << 24
_WORD = (1 << 32) - 1


def class_layer(classes: NDArray[np.uint8], single: NDArray[np.bool_]) -> bytes:
    """Layer of the classes of a chunk whose points have one scanner channel.

    Parameters
    ----------
    classes : (n,) uint8
        Class of each point, n >= 1.
    single : (n,) bool
        Whether it is the first and the last return of its pulse.
    """
    if np.all(classes == classes[0]):
        return b""
    model = (classes[:-1] & np.uint8(31)) * np.uint8(2) + single[1:]
    return _layer(classes[1:], model)


def byte_layer(values: NDArray[np.uint8]) -> bytes:
    """Layer of one byte of each point of a chunk whose points have one scanner channel: (n,)."""
    step = np.diff(values)
    return _layer(step, np.zeros_like(step)) if step.any() else b""


def _layer(symbol: NDArray[np.uint8], model: NDArray[np.uint8]) -> bytes:
    out = np.empty(2 * len(symbol) + 16, np.uint8)
    return out[: encode(symbol, model, out)].tobytes()


@njit(nogil=True, cache=True)
def _update(count: NDArray[np.int32], share: NDArray[np.int32], total: np.int64) -> np.int64:
    """Shares of the symbols by how often each has come; halves counts that grow too large."""
    if total > _COUNT_MAX:
        total = np.int64(0)
        for k in range(_SYMBOLS):
            count[k] = (count[k] + 1) >> 1
            total += count[k]
    scale = np.int64(0x80000000) // total
    below = np.int64(0)
    for k in range(_SYMBOLS):
        share[k] = (scale * below) >> (31 - _LENGTH_BITS)
        below += count[k]
    return total


@njit(nogil=True, cache=True)
def encode(symbol: NDArray[np.uint8], model: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Code symbols, each by its own model of those before it.

    Parameters
    ----------
    symbol, model : (n,) uint8
        Symbols, and the number of the model of each.
    out : (2 n + 16,) uint8
        Filled.

    Returns
    -------
    int
        Bytes used.
    """
    models = np.int64(model.max()) + 1 if len(model) else 0
    count = np.empty((models, _SYMBOLS), np.int32)
    share = np.empty((models, _SYMBOLS), np.int32)
    total, cycle = np.zeros(models, np.int64), np.zeros(models, np.int64)
    left = np.zeros(models, np.int64)
    base, length, size = np.int64(0), np.int64(_WORD), 0
    for i in range(len(symbol)):
        m, s = model[i], np.int64(symbol[i])
        if total[m] == 0:
            count[m] = 1
            total[m] = _update(count[m], share[m], np.int64(_SYMBOLS))
            cycle[m] = left[m] = _CYCLE_FIRST
        unit = length >> _LENGTH_BITS
        low = np.int64(share[m, s]) * unit
        base += low
        length = np.int64(share[m, s + 1]) * unit - low if s < _SYMBOLS - 1 else length - low
        base, length, size = _put_out(base, length, out, size)
        count[m, s] += 1
        left[m] -= 1
        if left[m] == 0:
            total[m] = _update(count[m], share[m], total[m] + cycle[m])
            cycle[m] = min((5 * cycle[m]) >> 2, _CYCLE_MAX)
            left[m] = cycle[m]
    return _finish(base, length, out, size)


@njit(nogil=True, cache=True, inline="always")
def _put_out(
    base: np.int64, length: np.int64, out: NDArray[np.uint8], size: int
) -> tuple[np.int64, np.int64, int]:
    """Put out the bytes that are settled; base and length of what is left, and the new size."""
    if base > _WORD:
        base &= _WORD
        _carry(out, size)
    while length < _LENGTH_MIN:
        out[size] = base >> 24
        size += 1
        base = (base << 8) & _WORD
        length <<= 8
    return base, length, size


@njit(nogil=True, cache=True)
def _carry(out: NDArray[np.uint8], size: int) -> None:
    """Add one to what has been put out."""
    place = size - 1
    while out[place] == 255:
        out[place] = 0
        place -= 1
    out[place] += 1


@njit(nogil=True, cache=True)
def _finish(base: np.int64, length: np.int64, out: NDArray[np.uint8], size: int) -> int:
    """Put out what tells the last interval, and the bytes that a decoder reads beyond."""
    long = length > 2 * _LENGTH_MIN
    base += _LENGTH_MIN if long else _LENGTH_MIN >> 1
    left = np.int64(_LENGTH_MIN >> 1 if long else _LENGTH_MIN >> 9)
    base, left, size = _put_out(base, left, out, size)
    for _ in range(3 if long else 2):
        out[size] = 0
        size += 1
    return size
