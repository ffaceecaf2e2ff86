"""Random access to point records, uncompressed or LAZ, in bounded memory.

LAZ is decoded chunk by chunk through the file's own chunk table. That is exact for chunks of any
size; the decompressor's own seek is not where they vary, as in COPC. A damaged chunk is named by
its points. (LAZ has no checksums: damage that decodes to other values cannot be seen.)
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, BinaryIO, Final, Self

import lazrs
import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import InputError, as_input_fault, grouped
from spl_batch.formats.declared import bounded, refuse_bomb
from spl_batch.formats.las.counts import (
    chunk_table_byte,
    miscounted,
    refuse_uncounted_chunks,
    refuse_uncounted_records,
    refuse_uncounted_rest,
)
from spl_batch.formats.las.header import MAX_LENGTH, LasHeader, open_input
from spl_batch.formats.las.records import RecordLayout, record_layout

LASZIP_KEY: Final = ("laszip encoded", 22204)

_LASZIP: Final = struct.Struct("<HHBBHIIqqH")
CHUNK_SIZE: Final = struct.Struct("<I")
CHUNK_SIZE_AT: Final = 12
"""Where a LASzip record has the points of a chunk."""

_ITEM: Final = struct.Struct("<HHH")
VARIABLE: Final = 2**32 - 1
"""Points of a chunk in that record where the chunk table has them."""

CHUNK_POINTS_MAX: Final = 5_000_000
"""Points of a chunk that can be decoded in bounded memory [count]."""

_LAYERED: Final = 3
_LAYERS: Final = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of an item of point formats 6-10 by type; extra bytes (14) have one a byte."""
_EXTRA_ITEM: Final = 14
_REMEDY: Final = "rewrite it with LASzip or PDAL"


@dataclass(frozen=True, slots=True)
class ChunkTable:
    """Where each LAZ chunk starts; one more entry marks the end of the last."""

    points: NDArray[np.int64]  #: (c + 1,): first point of each chunk.
    bytes: NDArray[np.int64]  #: (c + 1,): first byte of each chunk in the file.


def _chunk_table(header: LasHeader, file: BinaryIO, laszip: bytes) -> ChunkTable:
    """Read and check the chunk table; InputError where it is not whole."""
    path = str(header.path)
    chunk_points = CHUNK_SIZE.unpack_from(laszip, CHUNK_SIZE_AT)[0]
    if header.n_points == 0:
        refuse_uncounted_chunks(header, file)
        start = np.array([0], dtype=np.int64)
        return ChunkTable(start, start + header.points_start + 8)
    start_byte = header.points_start + 8
    size = header.n_points * header.record_size
    refuse_bomb(path, f"{header.n_points} points", size, header.size_bytes - start_byte)
    table_byte = _table_offset(header, file, start_byte)
    variable = chunk_points == VARIABLE
    exact = -(-header.n_points // chunk_points)
    count = bounded(
        path,
        "number of chunks in the LAZ chunk table",
        struct.unpack("<II", file.read(8))[1],
        least=1 if variable else exact,
        most=min(header.n_points, table_byte - start_byte) if variable else table_byte - start_byte,
    )
    if not variable and count > exact:
        least, most = (grouped(n * chunk_points + k) for n, k in ((count - 1, 1), (count, 0)))
        raise miscounted(header, f"its {grouped(count)} LAZ chunks hold {least} to {most}")
    file.seek(header.points_start)
    with as_input_fault(path, "its LAZ chunk table cannot be decoded"):
        entries = lazrs.read_chunk_table(file, lazrs.LazVlr(laszip))
    _check_entries(header, entries, table_byte - start_byte, variable=variable)
    table = np.asarray(entries, dtype=np.int64).reshape(-1, 2)
    points = np.concatenate([[0], np.cumsum(table[:, 0])])
    if not variable:
        points = np.minimum(np.arange(count + 1) * chunk_points, header.n_points)
    offsets = np.concatenate([[start_byte], start_byte + np.cumsum(table[:, 1])])
    largest = np.diff(points).max()
    bounded(path, "points of a LAZ chunk", largest, most=CHUNK_POINTS_MAX, remedy=_REMEDY)
    return ChunkTable(points.astype(np.int64), offsets.astype(np.int64))


def _check_entries(
    header: LasHeader, entries: Sequence[tuple[int, int]], there: int, *, variable: bool
) -> None:
    """Compare the chunk table with the file, in Python's integers: damaged ones exceed 64 bits."""
    path = header.path
    bounded(
        path, "bytes of the smallest LAZ chunk", min(s for _, s in entries), least=1, most=there
    )
    bounded(path, "bytes of all LAZ chunks", sum(s for _, s in entries), most=there)
    if variable:
        counts = [n for n, _ in entries]
        bounded(path, "points of the smallest LAZ chunk", min(counts), most=VARIABLE)
        bounded(path, "points of all LAZ chunks", sum(counts), least=header.n_points, most=VARIABLE)
        if sum(counts) > header.n_points:
            raise miscounted(header, f"its LAZ chunks hold {grouped(sum(counts))}")


def _laszip_data(header: LasHeader) -> bytes:
    path = str(header.path)
    vlr = header.vlr(*LASZIP_KEY)
    if vlr is None:
        raise InputError(path, "is compressed but has no LASzip record: the file is damaged")
    length = bounded(
        path, "bytes of its LASzip record", len(vlr.data), least=_LASZIP.size, most=MAX_LENGTH
    )
    compressor, coder, *_, chunk_points, _, _, n_items = _LASZIP.unpack_from(vlr.data)
    bounded(path, "LASzip compressor", compressor, least=2, most=3, remedy=_REMEDY)
    bounded(path, "LASzip coder", coder, most=0, remedy=_REMEDY)
    bounded(path, "items of its LASzip record", n_items, most=(length - _LASZIP.size) // _ITEM.size)
    size, held = header.record_size, sum(size for _, size, _ in laszip_items(vlr.data))
    bounded(path, "bytes of all LASzip items", held, least=size, most=size)
    if chunk_points:
        return vlr.data
    # LASzip takes 0 for chunks whose sizes are in their table.
    start, stop = CHUNK_SIZE_AT, CHUNK_SIZE_AT + CHUNK_SIZE.size
    return vlr.data[:start] + CHUNK_SIZE.pack(VARIABLE) + vlr.data[stop:]


def laszip_items(laszip: bytes) -> list[tuple[int, int, int]]:
    """Type, size [byte] and version of each item that a LASzip record lists."""
    n_items = _LASZIP.unpack_from(laszip)[-1]
    return [_ITEM.unpack_from(laszip, _LASZIP.size + i * _ITEM.size) for i in range(n_items)]


def count_layers(laszip: bytes) -> int:
    """Layers in each chunk; 0 where points are compressed one after the other."""
    if _LASZIP.unpack_from(laszip)[0] != _LAYERED:
        return 0
    items = laszip_items(laszip)
    return sum(size if kind == _EXTRA_ITEM else _LAYERS.get(kind, 0) for kind, size, _ in items)


def chunk_layers(packed: bytes, record_size: int, n_layers: int) -> list[bytes]:
    """Layers of a layered chunk: what follows its first record, its points and their sizes."""
    head = struct.Struct(f"<{1 + n_layers}I")
    sizes = head.unpack_from(packed, record_size)[1:]
    ends = np.cumsum((record_size + head.size, *sizes)).tolist()
    return [packed[a:b] for a, b in pairwise(ends)]


def _table_offset(header: LasHeader, file: BinaryIO, start_byte: int) -> int:
    """Byte of the chunk table; the file is left there."""
    size = header.size_bytes
    bounded(header.path, "byte at which its points start", header.points_start, most=size - 8)
    offset = chunk_table_byte(header, file)
    if size - 8 < offset < 2**48:
        raise InputError(
            str(header.path),
            f"it is cut off: it has {grouped(size)} bytes, and its LAZ chunk table begins at byte "
            f"{grouped(offset)}; copy it again",
        )
    bounded(header.path, "byte of its LAZ chunk table", offset, least=start_byte, most=size - 8)
    file.seek(offset)
    return offset


class RecordReader:
    """Reads point records of one file by position; a context manager.

    What is damaged raises InputError, on reading with the points' numbers.
    """

    def __init__(self, header: LasHeader) -> None:
        self.header = header
        self.layout: RecordLayout = record_layout(header)
        self._dtype = self.layout.dtype
        self.path = header.path
        self._opened = open_input(header.path)  # it closes the file when nothing refers to it
        self._file = self._opened.__enter__()
        self._table = ChunkTable(np.zeros(1, np.int64), np.zeros(1, np.int64))
        self.laszip = b""
        self._n_layers = 0
        self._layers_head = struct.Struct("")
        self._held: tuple[int, NDArray[Any]] = (-1, np.empty(0, self._dtype))
        try:
            if header.compressed:
                self.laszip = _laszip_data(header)
                self._n_layers = count_layers(self.laszip)
                self._layers_head = struct.Struct(f"<{1 + self._n_layers}I")
                self._table = _chunk_table(header, self._file, self.laszip)
            else:
                refuse_uncounted_records(header, self._file)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Records ``[start, stop)``: (stop - start,) structured, with the dtype of the layout."""
        out = np.empty(stop - start, dtype=self._dtype)
        if not self.header.compressed:
            self._read_plain(start, out)
            return out
        first = int(np.searchsorted(self._table.points, start, side="right")) - 1
        while start < stop:
            begin, end = self._table.points[first : first + 2].tolist()
            take = slice(start - (stop - len(out)), min(end, stop) - (stop - len(out)))
            if begin == start and end <= stop:
                self._decode(first, out[take])
            else:
                if self._held[0] != first:
                    whole = np.empty(end - begin, dtype=self._dtype)
                    self._decode(first, whole)
                    self._held = (first, whole)
                out[take] = self._held[1][start - begin : min(end, stop) - begin]
            start = min(end, stop)
            first += 1
        return out

    def read_ends(self, count: int) -> list[tuple[int, NDArray[Any]]]:
        """Up to ``count`` records from the start, and as many from the end or its last chunk.

        Of a LAZ file no more than that is decoded of the two chunks; a file of no more than these
        is read whole.

        Returns
        -------
        list of (int, (n,) structured)
            Which record is the first, and the records, without a gap.
        """
        n = self.header.n_points
        if n <= 2 * count:
            return [(0, self.read(0, n))]
        if not self.header.compressed:
            return [(start, self.read(start, start + count)) for start in (0, n - count)]
        sizes = np.diff(self._table.points)
        found: list[tuple[int, NDArray[Any]]] = []
        for chunk in np.unique(np.flatnonzero(sizes)[[0, -1]]).tolist():
            start = int(self._table.points[chunk])
            out = np.empty(min(count, int(sizes[chunk])), self._dtype)
            self._decode(chunk, out)
            found.append((start, out))
        return found

    def _read_plain(self, start: int, out: NDArray[Any]) -> None:
        self._file.seek(self.header.points_start + start * self._dtype.itemsize)
        view = out.view(np.uint8)
        with as_input_fault(self.path, f"points from {start} on cannot be read"):
            got = self._file.readinto(view)  # type: ignore[attr-defined]
        if got < len(view):
            raise InputError(
                str(self.path), f"ends before point {start + got // self._dtype.itemsize}"
            )

    def _check_layers(self, packed: bytes, begin: int, end: int) -> None:
        """Compare a chunk's layer sizes with its bytes.

        The decoder would believe sizes of damaged layers and allocate gigabytes. A chunk is its
        first point, the number of points, the size of each layer, the layers.
        """
        if self._n_layers == 0:
            return
        start, head = self._dtype.itemsize, self._layers_head
        named, least = f"points {begin} to {end - 1}", start + head.size
        bounded(self.path, f"bytes read of {named}", len(packed), least=least, most=2**62)
        count, *sizes = head.unpack_from(packed, start)
        there = len(packed) - least
        if end == self.header.n_points and end - begin < count <= CHUNK_POINTS_MAX:
            raise miscounted(self.header, f"its LAZ chunks hold {grouped(begin + count)}")
        bounded(self.path, f"count of {named}", count, least=end - begin, most=end - begin)
        bounded(self.path, f"bytes of the layers of {named}", sum(sizes), least=there, most=there)

    def _decode(self, chunk: int, out: NDArray[Any]) -> None:
        if len(out) == 0:
            return
        begin, end, packed = self._packed(chunk)
        with as_input_fault(self.path, f"points {begin} to {end - 1} cannot be decoded"):
            lazrs.decompress_points_with_chunk_table(
                packed, self.laszip, out.view(np.uint8), [(len(out), len(packed))]
            )
        if self._n_layers == 0 and begin + len(out) == self.header.n_points:
            refuse_uncounted_rest(self.header, self.laszip, packed, len(out))

    def packed_chunks(self) -> Iterator[tuple[int, int, bytes]]:
        """First point, past-the-last point and bytes of each LAZ chunk that holds points."""
        for chunk in np.flatnonzero(np.diff(self._table.points)).tolist():
            yield self._packed(chunk)

    def _packed(self, chunk: int) -> tuple[int, int, bytes]:
        begin, end = self._table.points[chunk : chunk + 2].tolist()
        low, high = self._table.bytes[chunk : chunk + 2].tolist()
        with as_input_fault(self.path, f"points from {begin} on cannot be read"):
            self._file.seek(low)
            packed = self._file.read(high - low)
        self._check_layers(packed, begin, end)
        return begin, end, packed
