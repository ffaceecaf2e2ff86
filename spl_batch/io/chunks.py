"""Zarr arrays whose every byte is verified when it is read.

Chunks end with a CRC-32C, which Zarr checks; the metadata carries a hash of itself among
the attributes. Zarr itself works in memory: files are read and written here, so that a chunk
appears whole or not at all, and so that one that is gone does not pass for an empty one.
"""

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import zarr
from numpy.typing import DTypeLike, NDArray
from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec
from zarr.core.buffer import Buffer
from zarr.core.buffer.cpu import Buffer as MemoryBuffer
from zarr.storage import MemoryStore

from spl_batch.errors import DamagedError
from spl_batch.io.atomic import read_bytes

METADATA: Final = "zarr.json"
"""File that describes an array or a group."""

_DIGEST: Final = "digest"
_FAULTS: Final = (ValueError, TypeError, KeyError, IndexError, RuntimeError)
"""What Zarr and its codecs raise over bytes that make no sense."""

Metadata = dict[str, Any]
Content = dict[str, bytes]
"""Files by their names below an array."""

_Files = dict[str, Buffer]


def describe(
    *,
    shape: Sequence[int],
    chunks: Sequence[int],
    dtype: DTypeLike,
    fill_value: float,
    attributes: Mapping[str, Any],
) -> bytes:
    """Metadata of a new array: what its :data:`METADATA` holds.

    Parameters
    ----------
    shape, chunks : sequence of int
        Of the array and of a chunk.
    dtype : dtype
        Of a value.
    fill_value : float
        Value of chunks that are not there.
    attributes : mapping
        Plain JSON values.
    """
    files: _Files = {}
    _create(files, shape, chunks, dtype, fill_value, attributes)
    return _content(files)[METADATA]


def pack(values: NDArray[Any], *, chunks: Sequence[int], attributes: Mapping[str, Any]) -> Content:
    """A whole array as files, each of its chunks among them.

    Parameters
    ----------
    values : ndarray
        The array.
    chunks : sequence of int
        Shape of a chunk.
    attributes : mapping
        Plain JSON values.
    """
    files: _Files = {}
    _create(files, values.shape, chunks, values.dtype, 0, attributes)[...] = values
    return _content(files)


def parse(content: bytes, path: Path) -> Metadata:
    """Metadata from the bytes of the file ``path``.

    Raises
    ------
    DamagedError
        If they are not what :func:`describe` made.
    """
    try:
        metadata: Metadata = json.loads(content)
        if metadata["attributes"].pop(_DIGEST) != _digest(metadata):
            raise DamagedError(path, "it does not fit its hash")
    except (*_FAULTS, AttributeError) as error:
        raise DamagedError(path, error) from error
    return metadata


def read_metadata(array: Path) -> Metadata:
    """Metadata of the array in a folder.

    Raises
    ------
    DamagedError
        If it is missing or damaged.
    """
    try:
        content = read_bytes(array / METADATA)
    except OSError as error:
        raise DamagedError(array / METADATA, error) from error
    return parse(content, array / METADATA)


def encode(metadata: Metadata, box: Sequence[slice], values: NDArray[Any]) -> Content:
    """Chunks that hold a box of values, by their names; none for nothing but the fill value.

    Parameters
    ----------
    metadata : dict
        Of the array.
    box : sequence of slice
        Where the values lie; whole chunks.
    values : ndarray
        Of the box's shape.
    """
    files = _in_memory(metadata, {})
    zarr.open_array(MemoryStore(files), mode="r+")[tuple(box)] = values
    return {name: data.to_bytes() for name, data in files.items() if name != METADATA}


def read_box(
    array: Path, metadata: Metadata, box: Sequence[slice], *, sparse: bool
) -> NDArray[Any]:
    """Values of a box, verified.

    Parameters
    ----------
    array : Path
        Folder of the array.
    metadata : dict
        From :func:`read_metadata`.
    box : sequence of slice
        Within the array.
    sparse : bool
        Whether chunks that are not there hold the fill value; else they are missing.

    Raises
    ------
    DamagedError
        If a chunk is missing or damaged; names the chunk where it can be told.
    """
    names = _chunk_names(metadata, box)
    found: Content = {}
    for name in names:
        try:
            found[name] = read_bytes(array / name)
        except FileNotFoundError as error:
            if not sparse:
                raise DamagedError(array / name, "is not there") from error
        except OSError as error:
            raise DamagedError(array / name, error) from error
    files = MemoryStore(_in_memory(metadata, found))
    try:
        return np.asarray(zarr.open_array(files, mode="r")[tuple(box)])
    except _FAULTS as error:
        at = array / names[0] if len(names) == 1 else array
        raise DamagedError(at, error) from error


def _chunk_names(metadata: Metadata, box: Sequence[slice]) -> list[str]:
    edges = metadata["chunk_grid"]["configuration"]["chunk_shape"]
    spans = [range(s.start // c, -(-s.stop // c)) for s, c in zip(box, edges, strict=True)]
    return ["/".join(["c", *map(str, at)]) for at in itertools.product(*spans)]


def _create(
    files: _Files,
    shape: Sequence[int],
    chunks: Sequence[int],
    dtype: DTypeLike,
    fill_value: float,
    attributes: Mapping[str, Any],
) -> Any:
    return zarr.create_array(
        MemoryStore(files),
        shape=tuple(shape),
        chunks=tuple(max(c, 1) for c in chunks),
        dtype=np.dtype(dtype),
        fill_value=fill_value,
        serializer=BytesCodec(),
        compressors=[ZstdCodec(level=3), Crc32cCodec()],
        attributes=dict(attributes),
        config={"write_empty_chunks": True},
    )


def _in_memory(metadata: Metadata, chunks: Content) -> _Files:
    content = {METADATA: json.dumps(metadata).encode(), **chunks}
    return {name: MemoryBuffer.from_bytes(data) for name, data in content.items()}


def _content(files: _Files) -> Content:
    """Bytes of a new array's files, with the hash in its metadata."""
    content = {name: data.to_bytes() for name, data in files.items()}
    metadata = json.loads(content[METADATA])
    metadata["attributes"][_DIGEST] = _digest(metadata)
    return {**content, METADATA: json.dumps(metadata, indent=1, sort_keys=True).encode()}


def _digest(metadata: Metadata) -> str:
    text = json.dumps(metadata, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
