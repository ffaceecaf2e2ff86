"""Files of frames: HDF5 or Zarr with an array ``frames`` of time bins, and perhaps its truth.

``frames`` is (n, rows, cols), whole numbers >= 0: the time bin of the only hit of a pixel in a
frame, 0 for none. A group ``truth`` may lie beside it, for each acquisition of as many frames as
its attribute ``frames_per_acquisition`` states: ``down_m`` (a, rows, cols) and ``normals``
(a, rows, cols, 3). What is declared is checked before a value is read.

Frames are read in pieces of a bounded number of values, whole chunks at a time. A chunk is
decompressed at once, so its declared size is part of what a task needs.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
import zarr
from numpy.typing import NDArray

from spl_batch.errors import InputError, as_input_fault
from spl_batch.formats.declared import bounded, refuse_bomb
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.hdf5 import open_hdf5, refuse_foreign

HDF5: Final = frozenset({".h5", ".hdf5", ".hdf"})
ZARR: Final = ".zarr"

CHUNK_FRAMES: Final = 1000
"""Frames of a chunk as written here [count]."""

TRUTH: Final = ("down_m", "normals")
"""Arrays of the truth."""

SUM_BYTES: Final = 11
"""Memory of adding up a value [byte]."""

PIECE_VALUES: Final = 2_048_000
"""Values that are read at once, where a chunk holds no more: 2000 frames of 32 x 32 [count]."""


@dataclass(frozen=True, slots=True)
class FrameFacts:
    """What a file of frames declares."""

    frames: int
    #: Frames of an acquisition for which truth lies beside; 0 where there is none [count].
    truth_frames: int
    chunk_frames: int  #: Frames of a chunk; 0 where it is not cut into chunks [count].
    piece_bytes: int  #: Memory of a piece while it is read and added up [byte].
    missing_chunks: int  #: Chunks that are not there, and read as frames without a hit [count].


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """Truth of some acquisitions."""

    down_m: NDArray[np.float64]  #: (a, rows, cols): down coordinate along each line of sight [m].
    normals: NDArray[np.float64]  #: (a, rows, cols, 3): unit normals out of the water.


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Root group of a file; its libraries' complaints become one line."""
    if path.suffix.lower() in HDF5:
        with open_hdf5(path) as group:
            yield group
    elif path.suffix.lower() == ZARR:
        if not path.exists():
            raise InputError(str(path), "no such file; check the path")
        with as_input_fault(path, "damaged Zarr"):
            yield zarr.open_group(path, mode="r")
    else:
        raise InputError(str(path), f"frames are HDF5 ({', '.join(sorted(HDF5))}) or Zarr ({ZARR})")


def inspect_frames(path: Path, rows: int, cols: int) -> FrameFacts:
    """Check what an HDF5 file or Zarr group declares against the camera, and name every fault."""
    with _opened(path) as group:
        if "frames" not in group:
            raise InputError(str(path), "has no array 'frames' of (n, rows, cols) time bins")
        array = group["frames"]
        if not hasattr(array, "dtype"):
            raise InputError(str(path), "'frames' is a group, not an array; store (n, rows, cols)")
        faults, truth = _array_faults(array, rows, cols), 0
        if "truth" in group and not faults:
            truth, faults = _truth(group["truth"], array.shape)
        if faults:
            raise InputError(str(path), faults)
        arrays = [array, *(group[f"truth/{name}"] for name in TRUTH if truth)]
        for one in arrays:
            if isinstance(one, h5py.Dataset):
                refuse_foreign(path, one)
        frames = bounded(path, "frames", int(array.shape[0]), least=1, most=2**40)
        parts = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
        size, stored = array.dtype.itemsize, sum(p.stat().st_size for p in parts)
        refuse_bomb(path, f"{frames} frames", frames * rows * cols * size, stored)
        # Of a piece: decoded values, those of the wanted frames, bins and their sums.
        wanted = min(_piece_frames(array), frames) * rows * cols
        held = max(wanted * size, _chunk_bytes(array)) + wanted * (size + 2 + SUM_BYTES)
        held += sum(map(_chunk_bytes, arrays[1:]))
        chunk = int(array.chunks[0]) if array.chunks else 0
        return FrameFacts(frames, truth, chunk, int(held), _missing_chunks(array))


def _missing_chunks(array: Any) -> int:
    if not array.chunks:
        return 0
    if isinstance(array, zarr.Array):
        return int(array.nchunks - array.nchunks_initialized)
    wanted = math.prod(-(-n // c) for n, c in zip(array.shape, array.chunks, strict=True))
    return int(wanted - array.id.get_num_chunks())


def _piece_frames(array: Any) -> int:
    """Frames that are read at once: whole chunks, as many as are in bounds, or one [count]."""
    chunk = int(array.chunks[0]) if array.chunks else 1
    most = PIECE_VALUES // int(array.shape[1] * array.shape[2])
    return max(most // chunk, 1) * chunk


def _chunk_bytes(array: Any) -> int:
    """Size of a decoded chunk, 0 without any [byte]."""
    return math.prod(map(int, array.chunks)) * array.dtype.itemsize if array.chunks else 0


def _array_faults(array: Any, rows: int, cols: int) -> list[str]:
    faults = []
    shape = tuple(int(n) for n in array.shape)
    if len(shape) != 3 or shape[1:] != (rows, cols):
        faults.append(
            f"frames has the shape {shape}, the camera (n, {rows}, {cols}); "
            "correct camera.rows and camera.cols, or the file"
        )
    elif shape[0] == 0:
        faults.append("frames holds no frame; leave the file out")
    if array.dtype.kind not in "ui":
        faults.append(f"frames holds {array.dtype}; store whole numbers such as uint16")
    return faults


def _truth(group: Any, shape: tuple[int, ...]) -> tuple[int, list[str]]:
    """Frames of its acquisitions, and what is wrong with the truth beside frames of a shape."""
    given = group.attrs.get("frames_per_acquisition", 0)
    per = int(given) if isinstance(given, int | np.integer) else 0
    if not 1 <= per <= shape[0]:
        return 0, ["truth lacks the attribute frames_per_acquisition, 1 to the number of frames"]
    faults = []
    for name, vector in zip(TRUTH, ((), (3,)), strict=True):
        expected = (shape[0] // per, *shape[1:], *vector)
        found = tuple(getattr(group[name], "shape", ())) if name in group else None
        if found != expected:
            faults.append(f"truth/{name} has the shape {found}, expected {expected}")
    return per, faults


def iter_frames(
    path: Path, first: int, last: int, bins: int
) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    """Frames ``first <= n < last`` of an inspected file, a piece after the other, and its first."""
    with _opened(path) as group:
        array = group["frames"]
        step = _piece_frames(array)
        while first < last:
            stop = min((first // step + 1) * step, last)
            yield first, _checked(path, np.asarray(array[first:stop]), first, stop, bins)
            first = stop


def _checked(
    path: Path, values: NDArray[Any], first: int, last: int, bins: int
) -> NDArray[np.uint16]:
    if len(values) != last - first:
        raise InputError(str(path), f"ends before frame {last}; it changed since it was planned")
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > bins:
        worst = low if low < 0 else high
        raise InputError(
            str(path),
            f"frames {first} to {last - 1} hold the time bin {worst}, the camera has 1 to {bins} "
            "and 0 for no hit; correct camera.bins or the file",
        )
    return values.astype(np.uint16, copy=False)


def read_truth(path: Path, first: int, last: int) -> FrameTruth:
    """Truth of the acquisitions ``first <= a < last``."""
    with _opened(path) as group:
        found = (np.asarray(group[f"truth/{k}"][first:last], dtype=np.float64) for k in TRUTH)
        return FrameTruth(*found)


def write_frames(
    path: Path,
    frames: NDArray[np.uint16],
    attributes: Mapping[str, float],
    truth: FrameTruth | None = None,
    frames_per_acquisition: int = 0,
) -> None:
    """Write frames, and their truth where it is given; whole or not at all.

    ``path``: ``.h5`` or ``.zarr``. ``frames``: (n, rows, cols), bins; 0 is no hit.
    ``frames_per_acquisition``: frames of an acquisition of the truth.
    """
    chunk = (min(len(frames), CHUNK_FRAMES), *frames.shape[1:])
    with replacing(path) as temporary:
        if path.suffix.lower() == ZARR:
            group = zarr.open_group(temporary, mode="w")
            group.create_array("frames", data=frames, chunks=chunk)
            _describe(group, attributes, truth, frames_per_acquisition)
            return
        with h5py.File(temporary, "w") as file:
            packing = {"compression": "gzip", "compression_opts": 1, "fletcher32": True}
            file.create_dataset("frames", data=frames, chunks=chunk, **packing)
            _describe(file, attributes, truth, frames_per_acquisition)


def _describe(
    group: Any, attributes: Mapping[str, float], truth: FrameTruth | None, per: int
) -> None:
    """Write attributes and truth into a group of either format."""
    group.attrs.update(dict(attributes))
    if truth is not None:
        below = group.create_group("truth")
        below.attrs["frames_per_acquisition"] = per
        create = below.create_array if isinstance(below, zarr.Group) else below.create_dataset
        for name in TRUTH:
            create(name, data=getattr(truth, name).astype(np.float32))
