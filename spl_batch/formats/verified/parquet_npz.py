"""Point tables as Parquet, small arrays as NPZ, files as an archive; a damaged byte is noticed.

Numbers are stored byte by byte (byte-stream split): neighbouring points share their high bytes,
which then cost next to nothing. Parquet has no numbers of one byte; its substitutes are written
twice as fast this way as with a dictionary. A dictionary is for long numbers that take few values;
what is mostly zero is stored as it is. Over all goes LZ4, which writes and reads twice as fast as
zstd, to files as large.

Parquet has checksums for pages but none for its footer, which has where they are and what lies in
them. So one is put before the footer, where the format leaves bytes unread: any reader of Parquet
still reads the file. An archive, as an NPZ is one, carries a hash of itself as its comment.
"""

import hashlib
import io
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple
from zipfile import BadZipFile, ZipFile, ZipInfo

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import DTypeLike, NDArray

from spl_batch.errors import DamagedError
from spl_batch.formats.files.atomic import read_bytes, replacing, write_bytes
from spl_batch.formats.files.remote import by_ranges, is_remote
from spl_batch.lattice.tables import COLUMNS, PointTable

_FEW_VALUES: Final = {"source", "afterpulse_share", "range_sigma"}
"""Columns of long numbers that take few values."""

_MOSTLY_ZERO: Final = {"afterpulse", "afterpulse_rate"}
"""Columns whose numbers are mostly zero."""

_SEAL: Final = struct.Struct("<4sI")
_SEAL_MARK: Final = b"SPLB"
_TAIL: Final = struct.Struct("<I4s")
_PARQUET_MARK: Final = b"PAR1"
_LIKELY_FOOTER: Final = 1 << 16
"""Bytes at the end of a file that are read at once: few footers are longer."""

_HASH_CHARACTERS: Final = 32


class GroupWriter:
    """Appends row groups to one Parquet file; see :func:`writing`."""

    def __init__(
        self, path: Path, schema: pa.Schema, sought: Sequence[str] | None, rows: int | None
    ) -> None:
        split = {f.name for f in schema if not pa.types.is_boolean(f.type)}
        self._schema, self._rows = schema, rows
        self._file = pq.ParquetWriter(
            path,
            schema,
            compression="lz4",
            use_dictionary=sorted(_FEW_VALUES & split),
            use_byte_stream_split=sorted(split - _FEW_VALUES - _MOSTLY_ZERO),
            write_page_checksum=True,
            write_statistics=True if sought is None else list(sought),
        )

    def write(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append rows as one row group, or as groups of so many rows."""
        stored = {k: pa.array(columns[k]) for k in self._schema.names}
        arrow = pa.table(stored, schema=self._schema)
        self._file.write_table(arrow, row_group_size=self._rows or max(arrow.num_rows, 1))

    def close(self) -> None:
        """Write the footer."""
        self._file.close()


@contextmanager
def writing(
    path: Path,
    dtypes: Mapping[str, DTypeLike],
    *,
    sought: Sequence[str] | None = None,
    durable: bool = False,
    rows: int | None = None,
) -> Iterator[GroupWriter]:
    """Write a Parquet file by row groups, atomically.

    Parameters
    ----------
    dtypes : mapping of str to dtype
        Columns of the file, in order.
    sought : sequence of str, optional
        Columns by whose bounds row groups are chosen; by default the footer has bounds of all.
    durable : bool
        As :func:`~spl_batch.formats.files.atomic.replacing` has it: for what is delivered.
    rows : int, optional
        Most rows of a row group; by default what is written at once is one.
    """
    schema = pa.schema(
        # What cannot be missing is written and read a quarter faster.
        [pa.field(k, pa.from_numpy_dtype(np.dtype(v)), nullable=False) for k, v in dtypes.items()]
    )
    with replacing(path, durable=durable) as temporary:
        writer = GroupWriter(temporary, schema, sought, rows)
        try:
            yield writer
        finally:
            writer.close()
        _seal(temporary)


def write_table(
    path: Path,
    table: PointTable,
    *,
    group_starts: Sequence[int] = (0,),
    sought: Sequence[str] | None = None,
) -> None:
    """Write a table of the working store atomically.

    Parameters
    ----------
    table : PointTable
        Rows in the order in which they are to lie on disk.
    group_starts : sequence of int
        First row of each row group, increasing, the first one 0.
    sought : sequence of str, optional
        As :func:`writing` has it.
    """
    dtypes = {name: COLUMNS[name].dtype for name in table.columns}
    ends = [*group_starts[1:], len(table)]
    with writing(path, dtypes, sought=sought) as writer:
        for start, end in zip(group_starts, ends, strict=True):
            writer.write(table.take(slice(start, end)).columns)


@contextmanager
def reading(path: Path, footer: pq.FileMetaData | None = None) -> Iterator[pq.ParquetFile]:
    """Open a file written by :func:`writing`; every byte that is used is verified.

    ``footer``: the file's own, where it was read already.

    Raises
    ------
    DamagedError
        If the file is missing or damaged.
    """
    with naming_damage(path), _open(path) as stream:
        footer = _read_footer(stream) if footer is None else footer
        with pq.ParquetFile(stream, metadata=footer, page_checksum_verification=True) as file:
            yield file


@contextmanager
def naming_damage(path: Path) -> Iterator[None]:
    """Turn errors over a file that cannot be read into a :class:`DamagedError`."""
    try:
        yield
    except MemoryError:
        raise
    except (OSError, pa.ArrowException, struct.error) as error:
        raise DamagedError(path, error) from error


def read_groups(
    file: pq.ParquetFile, names: Sequence[str], groups: Sequence[int] | None = None
) -> dict[str, NDArray[Any]]:
    """Columns of some row groups, or of all, of a file from :func:`reading`."""
    wanted = list(range(file.num_row_groups) if groups is None else groups)
    # A worker has one thread; more of pyarrow's would be in the way of other workers.
    arrow = file.read_row_groups(wanted, columns=list(names), use_threads=False)
    # A damaged page header can hide its page; the footer is known to be sound.
    rows = sum(file.metadata.row_group(g).num_rows for g in wanted)
    if arrow.num_rows != rows:
        raise pa.ArrowInvalid(f"{arrow.num_rows} rows where there were {rows}")
    return {name: arrow.column(name).to_numpy() for name in names}


def read_columns(
    path: Path, names: Sequence[str], groups: Sequence[int] | None = None
) -> dict[str, NDArray[Any]]:
    """Columns of a file from :func:`writing`; ``groups``: row groups to read, all by default."""
    with reading(path) as file:
        return read_groups(file, names, groups)


class Groups(NamedTuple):
    """Some row groups of a file."""

    path: Path
    footer: pq.FileMetaData
    wanted: list[int]  #: Their numbers.

    @property
    def rows(self) -> int:
        """How many rows they hold."""
        return sum(self.footer.row_group(g).num_rows for g in self.wanted)

    def read(self, names: Sequence[str]) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
        """Values of columns, of whole row groups, and their rows in the file, (m,) each."""
        counts = [self.footer.row_group(g).num_rows for g in range(self.footer.num_row_groups)]
        ends = np.cumsum(counts)
        row = [np.arange(ends[g] - counts[g], ends[g]) for g in self.wanted]
        with reading(self.path, self.footer) as file:
            return read_groups(file, names, self.wanted), np.concatenate([np.arange(0), *row])


class GroupIndex:
    """Row groups of a file from :func:`writing` by bounds of columns; its footer is read once.

    Raises DamagedError if the file is missing or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with naming_damage(path), _open(path) as stream:
            self._footer = _read_footer(stream)
        self._bounds: dict[str, NDArray[Any]] = {}

    def between(self, spans: Mapping[str, tuple[float, float]]) -> Groups:
        """Row groups that may hold values within some spans.

        Parameters
        ----------
        spans : mapping of str to (float, float)
            Smallest and largest value of interest by column; every column has to meet its own.
        """
        meets = np.ones(self._footer.num_row_groups, np.bool_)
        for name, (low, high) in spans.items():
            if name not in self._bounds:
                self._bounds[name] = np.array(ranges_of(self._footer, name)).reshape(-1, 2)
            first, last = self._bounds[name].T
            meets &= (first <= high) & (last >= low)
        return Groups(self._path, self._footer, np.flatnonzero(meets).tolist())


def groups_between(path: Path, spans: Mapping[str, tuple[float, float]]) -> Groups:
    """Row groups of a file that is looked into once; see :class:`GroupIndex`."""
    return GroupIndex(path).between(spans)


def read_with(
    path: Path, names: Sequence[str], key: str, values: NDArray[np.int64]
) -> Iterator[dict[str, NDArray[Any]]]:
    """Columns of each row group that may hold one of some values, one group after the other.

    ``values``: (v,) int64, values of interest in column ``key``, increasing.
    """
    with reading(path) as file:
        for group, (low, high) in enumerate(ranges_of(file.metadata, key)):
            first, last = np.searchsorted(values, [low, high + 1])
            if last > first:
                yield read_groups(file, names, [group])


def read_table(path: Path, names: Sequence[str]) -> PointTable:
    """Read a table; see :func:`read_columns`."""
    return PointTable(read_columns(path, names))


def read_rows(path: Path, names: Sequence[str], first: int, count: int) -> PointTable:
    """Read so many rows of a table from some row on."""
    with reading(path) as file:
        groups = map(file.metadata.row_group, range(file.num_row_groups))
        ends = np.cumsum([group.num_rows for group in groups])
        low, high = np.searchsorted(ends, [first, first + count - 1], side="right").tolist()
        table = PointTable(read_groups(file, names, range(low, high + 1)))
        start = first - (int(ends[low - 1]) if low else 0)
        return table.take(slice(start, start + count))


def group_ranges(path: Path, name: str) -> list[tuple[int, int]]:
    """Smallest and largest value of a column in each row group, from the footer alone."""
    with reading(path) as file:
        return ranges_of(file.metadata, name)


def ranges_of(footer: pq.FileMetaData, name: str) -> list[tuple[int, int]]:
    """Smallest and largest value of a column in each row group."""
    column = footer.schema.names.index(name)
    statistics = [
        footer.row_group(g).column(column).statistics for g in range(footer.num_row_groups)
    ]
    return [(s.min, s.max) if s is not None and s.has_min_max else (0, -1) for s in statistics]


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write small arrays as an uncompressed NPZ, atomically and with reproducible bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **{k: np.asarray(v) for k, v in arrays.items()})
    _write_sealed(path, buffer.getvalue())


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read what :func:`write_arrays` wrote; raises as :func:`read_files` does."""
    stored = read_files(path)
    try:
        return {name.removesuffix(".npy"): _array(one) for name, one in stored.items()}
    except (ValueError, TypeError, EOFError) as error:
        raise DamagedError(path, error) from error


def write_files(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files as an uncompressed archive, atomically and with reproducible bytes."""
    buffer = io.BytesIO()
    with ZipFile(buffer, "w") as archive:
        for name in sorted(files):
            archive.writestr(ZipInfo(name), files[name])
    _write_sealed(path, buffer.getvalue())


def read_files(path: Path) -> dict[str, bytes]:
    """Files of an archive that ends with a hash of itself, by their names in it.

    Raises
    ------
    DamagedError
        If the archive is missing or damaged.
    """
    try:
        content = read_bytes(path)
        if _hash(content[:-_HASH_CHARACTERS]) != content[-_HASH_CHARACTERS:]:
            raise DamagedError(path, "its content does not fit its hash")
        with ZipFile(io.BytesIO(content)) as archive:
            return {one.filename: archive.read(one) for one in archive.filelist}
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise DamagedError(path, error) from error


def _write_sealed(path: Path, archive: bytes) -> None:
    """Write an archive with a hash of itself as its comment, whose length, 0, it ends with."""
    content = archive[:-2] + struct.pack("<H", _HASH_CHARACTERS)
    write_bytes(path, content + _hash(content), durable=False)


def _array(stored: bytes) -> NDArray[Any]:
    """An array of an NPZ; most of the time of numpy's own reader goes to its head."""
    start = 10 + int.from_bytes(stored[8:10], "little")
    shape, by_column, dtype = _described(stored[8:start])
    if dtype.hasobject:
        raise ValueError("it holds objects of Python")
    return np.ndarray(shape, dtype, stored, start, order="F" if by_column else "C").copy()


@lru_cache(maxsize=4096)
def _described(head: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order and dtype by the head of an array: thousands of files share a few."""
    found: tuple[tuple[int, ...], bool, np.dtype[Any]]
    found = np.lib.format.read_array_header_1_0(io.BytesIO(head))
    return found


def _open(path: Path) -> Any:
    return pa.PythonFile(by_ranges(path), "r") if is_remote(path) else pa.OSFile(str(path), "rb")


def _hash(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_HASH_CHARACTERS // 2).hexdigest().encode()


def _seal(path: Path) -> None:
    """Put a checksum of the footer before it."""
    with path.open("r+b") as file:
        file.seek(-_TAIL.size, io.SEEK_END)
        length, _ = _TAIL.unpack(file.read())
        start = file.seek(-_TAIL.size - length, io.SEEK_END)
        footer = file.read()
        file.seek(start)
        file.write(_SEAL.pack(_SEAL_MARK, zlib.crc32(footer)) + footer)


def _read_footer(stream: Any) -> pq.FileMetaData:
    """Footer of a sealed file; raises ``pa.ArrowInvalid`` where the seal is broken."""
    size = stream.size()
    stream.seek(max(size - _LIKELY_FOOTER, 0))
    tail = stream.read()
    length, _ = _TAIL.unpack(tail[-_TAIL.size :])
    whole = _SEAL.size + length + _TAIL.size
    if len(tail) < whole <= size:
        stream.seek(size - whole)
        tail = stream.read()
    sealed = tail[-whole:]
    footer = sealed[_SEAL.size :]
    if _SEAL.unpack(sealed[: _SEAL.size]) != (_SEAL_MARK, zlib.crc32(footer)):
        raise pa.ArrowInvalid("its footer does not fit its checksum")
    return pq.read_metadata(pa.BufferReader(_PARQUET_MARK + footer))
