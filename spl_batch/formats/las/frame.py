"""The bytes around the points: a LAS 1.4 header, VLRs, EVLRs [LAS 1.4 R15].

What is written depends on its arguments alone: no clock, no thread count.

Point formats 9 and 10 stay uncompressed: the compressor at hand (lazrs 0.8) mangles
their wave packets, though it reads those of others well.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final

import laspy
import lazrs
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.enums import WktVersion
from pyproj.exceptions import CRSError

from spl_batch import __version__
from spl_batch.errors import InputError, as_input_fault
from spl_batch.formats.crs import WKT_KEY
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.gps_clock import TimeStandard
from spl_batch.formats.las.chunks import CHUNK_SIZE, CHUNK_SIZE_AT, LASZIP_KEY
from spl_batch.formats.las.header import (
    ADJUSTED_BIT,
    COMPRESSED_BIT,
    EVLR_HEAD,
    EXTERNAL_BIT,
    HEADER_SIZES,
    INTERNAL_BIT,
    VLR_HEAD,
    WKT_BIT,
    Evlr,
    LasHeader,
    Vlr,
    waveform_file,
)
from spl_batch.formats.las.records import EXTRA_BYTES_KEY, RecordLayout

HEADER_SIZE: Final = HEADER_SIZES[4]
_COPY_BYTES: Final = 1 << 20
_UNCOMPRESSED: Final = (9, 10)
OFFSET: Final = struct.Struct("<q")
"""Where points begin: the offset of the chunk table, behind the chunks."""

_COUNTS: Final = struct.Struct("<QQIQ15Q")
WAVEFORM_KEY: Final = ("LASF_Spec", 65535)
_FIELDS: Final = {
    "file_source_id": slice(4, 6),
    "system_identifier": slice(26, 58),
    "generating_software": slice(58, 90),
    "creation_date": slice(90, 94),
}
_BITS: Final = {
    "gps_time_bit": ADJUSTED_BIT,
    "waveform_bits": INTERNAL_BIT | EXTERNAL_BIT,
    "wkt_bit": WKT_BIT,
}


@dataclass(frozen=True, slots=True)
class Frame:
    """Everything of a file but its points."""

    preamble: bytes  #: The first 94 bytes of a header: identification, creation date and the like.
    #: scales, offsets: of the coordinates.
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    layout: RecordLayout
    #: Without those of LASzip and the extra bytes, which follow from the layout.
    vlrs: Sequence[Vlr]
    #: Extended records, each with the file that it is copied from.
    evlrs: Sequence[tuple[Evlr, Path]] = ()

    def set_coordinates(self, records: NDArray[Any], xyz: NDArray[np.float64], path: Path) -> None:
        """Put coordinates, (n, 3), into records, rounded to the scale.

        Raises
        ------
        InputError
            If one of them, or a NaN, has no integer; ``path`` is where they come from.
        """
        steps = np.rint((xyz - self.offsets) / self.scales)
        if len(steps) and not np.abs(steps).max() < 2**31:  # a NaN is none either
            raise InputError(
                str(path),
                f"has points too far from the offset {self.offsets} for the scale {self.scales}: "
                "give files one offset, or write them in parts",
            )
        for axis, values in zip("XYZ", steps.T, strict=True):
            records[axis] = values


def preamble(old: bytes, encoding: int) -> bytes:
    """First bytes of a LAS 1.4 header; sound ids, date and system of an ``old`` one are kept."""
    software = f"spl-batch {__version__}".encode("ascii").ljust(32, b"\0")
    system = bytes(b if b < 0x80 else ord("?") for b in old[26:58])
    if not system.strip(b"\0 "):
        system = b"MODIFICATION".ljust(32, b"\0")
    day, year = struct.unpack("<HH", old[90:94])
    date = old[90:94] if 1 <= day <= 366 and 1 <= year <= 9999 else bytes(4)
    encoded = encoding.to_bytes(2, "little")
    return b"LASF" + old[4:6] + encoded + old[8:24] + b"\1\4" + system + software + date


def header_changes(given: LasHeader, copy: LasHeader) -> list[str]:
    """Names of the header's fields that a copy has in another way."""
    bits = given.global_encoding ^ copy.global_encoding
    fields = (name for name, part in _FIELDS.items() if given.raw[part] != copy.raw[part])
    return [*(name for name, some in _BITS.items() if bits & some), *fields]


def copied_encoding(
    header: LasHeader, standard: TimeStandard, evlrs: Sequence[Evlr], *, wkt: bool
) -> int:
    """Global encoding of a copy, by what it holds."""
    internal = WAVEFORM_KEY in {e.key for e in evlrs}
    external = not internal and waveform_file(header.path, header.point_format) is not None
    adjusted = bool(header.global_encoding & ADJUSTED_BIT)
    if standard in {"week", "adjusted"}:
        adjusted = standard == "adjusted"
    found = {ADJUSTED_BIT: adjusted, INTERNAL_BIT: internal, EXTERNAL_BIT: external, WKT_BIT: wkt}
    return header.global_encoding & ~sum(found) | sum(bit for bit, there in found.items() if there)


def wkt_vlr(crs: CRS) -> Vlr:
    """Record that holds a CRS, in the dialect that LAS 1.4 asks for where it can."""
    try:
        text = crs.to_wkt(WktVersion.WKT1_GDAL)
    except CRSError:  # it has no words for heights above an ellipsoid
        text = crs.to_wkt()
    return Vlr(WKT_KEY[0].encode(), WKT_KEY[1], b"OGC WKT", text.encode() + b"\0")


class WatchedFile:
    """A file that remembers its own error, which the compressor reports as its own."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.error: OSError | None = None

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            try:
                return getattr(self.file, name)(*args)
            except OSError as error:
                self.error = error
                raise

        return call


@contextmanager
def output_file(path: Path) -> Iterator[WatchedFile]:
    """Open a file that takes its name when the body succeeds."""
    with replacing(path) as temporary, temporary.open("w+b") as file:
        watched = WatchedFile(file)
        try:
            yield watched
            watched.flush()
        except lazrs.LazrsError:
            if watched.error is not None:
                raise watched.error from None
            raise
        # Whoever gets it can open it, and read a point of it.
        with (
            as_input_fault(f"{path} as it was written"),
            laspy.open(temporary, laz_backend=laspy.LazBackend.Lazrs) as written,
        ):
            laspy.LasData(written.header, written.read_points(1))


@dataclass(eq=False)
class Extent:
    """Counts and bounding box that the header needs, gathered from the records."""

    #: (2, 3) int64: largest raw X, Y, Z, then the smallest.
    ends: NDArray[np.int64] = field(default_factory=partial(np.outer, [-(2**31), 2**31], [1] * 3))
    #: (16,) int64: records by return number [count].
    returns: NDArray[np.int64] = field(default_factory=partial(np.full, 16, np.int64(0)))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.int64]]) -> "Extent":
        """What :meth:`to_arrays` gave."""
        ends = np.stack([arrays["extent/high"], arrays["extent/low"]])
        return cls(ends, arrays["extent/returns"])

    def to_arrays(self) -> dict[str, NDArray[np.int64]]:
        """Arrays by name, to be stored."""
        high, low = self.ends
        return {"extent/high": high, "extent/low": low, "extent/returns": self.returns}

    @property
    def n_points(self) -> int:
        """Records counted."""
        return int(self.returns.sum())

    def add(self, records: NDArray[Any]) -> None:
        """Count records in."""
        ends = np.array([[records[a].max() for a in "XYZ"], [records[a].min() for a in "XYZ"]])
        self.join(Extent(ends, np.bincount(records["bit_fields"] & 15, minlength=16)))

    def join(self, other: "Extent") -> None:
        """Count in what another one has counted."""
        largest = np.maximum(self.ends[0], other.ends[0])
        self.ends = np.stack([largest, np.minimum(self.ends[1], other.ends[1])])
        self.returns = self.returns + other.returns

    def box(self, frame: Frame) -> list[float]:
        """Max x, min x, max y, and so on: the header's order [m]."""
        if self.n_points == 0:
            return [0.0] * 6
        box: list[float] = (self.ends * frame.scales + frame.offsets).T.ravel().tolist()
        return box


def write_laz(path: Path, frame: Frame, chunks: Iterable[NDArray[Any]]) -> int:
    """Write a LAS 1.4 file atomically, compressed but for point formats 9 and 10; count of points.

    Parameters
    ----------
    path : Path
        Final name; its folder is made where missing.
    frame : Frame
        Everything but the points.
    chunks : iterable of (n,) structured
        Records of the frame's layout.
    """
    laz = None if frame.layout.point_format in _UNCOMPRESSED else laz_record(frame.layout)
    with output_file(path) as file:
        extent = Extent()
        with framed(file, frame, laz, extent):
            compressor = None if laz is None else lazrs.LasZipCompressor(file, laz)
            for records in chunks:
                if not len(records):
                    continue
                extent.add(records)
                content = np.ascontiguousarray(records).view(np.uint8)
                if compressor is None:
                    file.write(content)
                else:
                    compressor.compress_many(content)
            if compressor is not None:
                compressor.done()
    return extent.n_points


def write_packed(
    path: Path, frame: Frame, laz: Any, extent: Extent, chunks: Iterable[tuple[int, bytes]]
) -> int:
    """Write a LAS 1.4 file whose points are compressed already; see :func:`write_laz`.

    ``chunks``: iterable of (int, bytes), points of each chunk, and its bytes.
    """
    with output_file(path) as file, framed(file, frame, laz, extent):
        write_chunks(file, laz, chunks)
    return extent.n_points


def write_chunks(
    file: WatchedFile, laz: Any, chunks: Iterable[tuple[int, bytes]]
) -> list[tuple[int, int]]:
    """Write compressed chunks and their table; points and bytes of each chunk."""
    start = file.tell()
    file.write(bytes(OFFSET.size))
    table = []
    for points, packed in chunks:
        file.write(packed)
        table.append((points, len(packed)))
    offset = file.tell()
    lazrs.write_chunk_table(file, table or [(0, 0)], laz)  # as the compressor does it
    file.seek(start)
    file.write(OFFSET.pack(offset))
    return table


def packed_chunk(records: NDArray[Any], laz: Any) -> bytes:
    """Bytes of a chunk of records."""
    content: bytes = lazrs.compress_points(laz, records.view(np.uint8), parallel=False)
    return content[OFFSET.size : OFFSET.unpack_from(content)[0]]  # the table lies behind it


@contextmanager
def framed(file: WatchedFile, frame: Frame, laz: Any | None, extent: Extent) -> Iterator[list[Vlr]]:
    """Everything before the points; when they are written, what follows, and the header.

    What the body puts into the list follows as extended records.
    """
    layout, vlrs = frame.layout, [*frame.vlrs]
    if described := b"".join(d.descriptor for d in layout.extra):
        user_id, record_id = EXTRA_BYTES_KEY
        vlrs.append(Vlr(user_id.encode(), record_id, b"Extra Bytes Record", described))
    if laz is not None:
        data = bytes(laz.record_data())
        vlrs.append(Vlr(LASZIP_KEY[0].encode(), LASZIP_KEY[1], b"lazrs", data))
    file.write(bytes(HEADER_SIZE))
    for vlr in vlrs:
        head = (0, vlr.user_id, vlr.record_id, len(vlr.data), vlr.description)
        file.write(VLR_HEAD.pack(*head) + vlr.data)
    points_start, more = file.tell(), list[Vlr]()
    yield more
    evlrs_start, waveforms = file.seek(0, 2), 0
    for evlr, source in frame.evlrs:
        if evlr.key == WAVEFORM_KEY:
            waveforms = file.tell()
        _copy_record(file, evlr, source)
    for vlr in more:
        head = (0, vlr.user_id, vlr.record_id, len(vlr.data), vlr.description)
        file.write(EVLR_HEAD.pack(*head) + vlr.data)
    n_evlrs = len(frame.evlrs) + len(more)
    fixed = struct.pack(
        "<HIIBHI5I",
        HEADER_SIZE,
        points_start,
        len(vlrs),
        layout.point_format | (0 if laz is None else COMPRESSED_BIT),
        layout.dtype.itemsize,
        *[0] * 6,  # the old counts stay zero in point formats 6-10
    )
    floats = struct.pack("<12d", *frame.scales, *frame.offsets, *extent.box(frame))
    offsets = waveforms, evlrs_start if n_evlrs else 0, n_evlrs
    counts = _COUNTS.pack(*offsets, extent.n_points, *extent.returns[1:].tolist())
    file.seek(0)
    file.write(frame.preamble + fixed + floats + counts)


def _copy_record(file: WatchedFile, evlr: Evlr, source: Path) -> None:
    """Write an extended record as another file has it."""
    file.write(EVLR_HEAD.pack(0, evlr.user_id, evlr.record_id, evlr.size, evlr.description))
    left = evlr.size
    with source.open("rb") as old:
        old.seek(evlr.start)
        while left and (part := old.read(min(left, _COPY_BYTES))):
            file.write(part)
            left -= len(part)


def laz_record(layout: RecordLayout, chunk_points: int | None = None) -> Any:
    """LASzip record, ``lazrs.LazVlr``; chunks are those of the compressor by default."""
    extra_bytes = sum(d.dtype.itemsize for d in layout.extra)
    laz = lazrs.LazVlr.new_for_compression(layout.point_format, extra_bytes)
    if chunk_points is None:
        return laz
    data = bytearray(laz.record_data())
    CHUNK_SIZE.pack_into(data, CHUNK_SIZE_AT, chunk_points)
    return lazrs.LazVlr(bytes(data))
