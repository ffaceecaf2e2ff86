"""The fixed part of a LAS file, read and checked before any library trusts it.

Counts and offsets of a broken header make readers loop for minutes or allocate without bound. So
this module reads header, VLRs and offsets of EVLRs itself [LAS 1.4 R15, sections 2.4-2.7], and
reports every fault of a file in one error.
"""

import math
import os
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, Final

import laspy
import numpy as np

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError, reason_of
from spl_batch.formats.declared import DAMAGED, bounded, gathered

HEADER_SIZES: Final = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""Bytes of the header by minor version."""

VLR_HEAD: Final = struct.Struct("<H16sHH32s")
EVLR_HEAD: Final = struct.Struct("<H16sHQ32s")

WAVEFORM_FORMATS: Final = (4, 5, 9, 10)
"""Point formats with wave packets."""

ADJUSTED_BIT, INTERNAL_BIT, EXTERNAL_BIT, WKT_BIT = 1, 2, 4, 16
"""Bits of the global encoding: adjusted standard time, waveforms in the file or in one beside it,
a CRS as WKT [LAS 1.4 R15, 2.4]."""

_CORE: Final = struct.Struct("<HIIBHI5I12d")
_CORE_START: Final = 94
_POINT_FORMATS: Final = 11
COMPRESSED_BIT: Final = 0x80
_FAR_M: Final = 1e9
_SCALE_MAX_M: Final = 1000.0
_HIGH_M: Final = (2**31 - 1) / QUANTA_PER_M
_MAX_POINTS: Final = 2**32 - 1
_START_SIGNATURES: Final = (b"\xdd\xcc", b"\xcc\xdd")
"""Bytes before the points of LAS 1.0; some writers count them among the points."""

MAX_LENGTH: Final = 2**16 - 1
_MAX_RECORDS: Final = 4096
REWRITE: Final = "the header is damaged, rewrite the file with the software that made it"


@dataclass(frozen=True, slots=True)
class _Record:
    user_id: bytes
    record_id: int
    description: bytes

    @property
    def key(self) -> tuple[str, int]:
        """User id without padding, and record id."""
        return self.user_id.split(b"\0")[0].decode("latin-1"), self.record_id


@dataclass(frozen=True, slots=True)
class Vlr(_Record):
    """A variable length record, uninterpreted."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Evlr(_Record):
    """Where an extended variable length record lies; its data may be huge."""

    start: int
    size: int


@dataclass(frozen=True, slots=True)
class LasHeader:
    """A header that has passed every check."""

    path: Path
    size_bytes: int
    raw: bytes  #: The header as it lies in the file.
    version: tuple[int, int]
    point_format: int
    compressed: bool
    record_size: int  #: Bytes of one uncompressed point record.
    n_points: int
    points_start: int  #: Byte where the point records (LAZ: the offset to the chunk table) start.
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    mins_m: tuple[float, float, float]
    maxs_m: tuple[float, float, float]
    vlrs: tuple[Vlr, ...]
    evlrs: tuple[Evlr, ...]

    @property
    def global_encoding(self) -> int:
        """Bits of the header's global encoding; none before LAS 1.2, which reserved them."""
        return int.from_bytes(self.raw[6:8], "little") if self.version[1] > 1 else 0

    def vlr(self, user_id: str, record_id: int) -> Vlr | None:
        """First VLR of this kind."""
        return next((v for v in self.vlrs if v.key == (user_id, record_id)), None)


@cache
def standard_dtype(point_format: int) -> np.dtype[Any]:
    """Packed dtype of a point record without extra bytes."""
    standard: np.dtype[Any] = laspy.PointFormat(point_format).dtype()
    return standard


@contextmanager
def open_input(path: Path) -> Iterator[BinaryIO]:
    """Open a file for reading; whatever forbids it becomes one clear line.

    Raises
    ------
    InputError
        If the file is missing, a folder, empty, may not be read, or has a name that is no UTF-8.
    """
    try:
        str(path).encode()  # no receipt, report or link could hold another name
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise InputError(str(path), "is a folder; name the files in it, e.g. *.laz")
        # Opening a pipe would wait for its other end.
        if not stat.S_ISREG(status.st_mode):
            raise InputError(str(path), "is not a regular file; copy it to disk first")
        if status.st_size == 0:
            raise InputError(str(path), "is empty (0 bytes); copy it again")
        file = path.open("rb")
    except UnicodeEncodeError:
        raise InputError(str(path), "its name is not UTF-8: rename it") from None
    except FileNotFoundError:
        raise InputError(str(path), "no such file; check the path") from None
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {reason_of(error)}") from None
    with file:
        yield file


def waveform_file(path: Path, point_format: int) -> Path | None:
    """File of waveforms beside one whose points have some; None where there is none."""
    endings = (".wdp", ".WDP", ".wdz", ".WDZ") if point_format in WAVEFORM_FORMATS else ()
    return next(filter(Path.is_file, map(path.with_suffix, endings)), None)


def read_header(path: Path) -> LasHeader:
    """Read and check header and VLRs of a LAS, LAZ or COPC file.

    Raises
    ------
    InputError
        With every fault found.
    """
    with open_input(path) as file:
        size = os.fstat(file.fileno()).st_size
        raw = _read_raw(path, file)
        header_size, points_start, n_vlrs, pf, record_size, legacy = _CORE.unpack_from(
            raw, _CORE_START
        )[:6]
        floats = _CORE.unpack_from(raw, _CORE_START)[11:]
        if raw[25] == 0:
            points_start += _signature_bytes(file, points_start)
        point_format, compressed = pf & 0x3F, bool(pf & COMPRESSED_BIT)
        # Headers before 1.4 end here; some writers of 1.4 fill the legacy count only.
        n_points = int.from_bytes(raw[247:255], "little") or legacy
        room = min(max(points_start - header_size, 0) // VLR_HEAD.size, _MAX_RECORDS)
        there = max(size - points_start, 0) // max(record_size, 1)
        remedy = "it is cut off or its header is damaged, copy it again"
        if compressed or there > _MAX_POINTS:
            there, remedy = _MAX_POINTS, "split it"
        known = range(_POINT_FORMATS)
        least = standard_dtype(point_format).itemsize if point_format in known else 0
        checks = (
            ("point format", point_format, 0, known[-1], "convert it"),
            ("point record length", record_size, least, MAX_LENGTH, DAMAGED),
            ("header size", header_size, HEADER_SIZES[raw[25]], MAX_LENGTH, DAMAGED),
            ("offset to point data", points_start, header_size, size, DAMAGED),
            ("number of VLRs", n_vlrs, 0, room, REWRITE),
            ("number of points", n_points, 0, there, remedy),
        )
        faults = _coordinate_faults(floats, n_points)
        for what, value, low, high, helps in checks:
            with gathered(faults):
                bounded(path, what, value, least=low, most=high, remedy=helps)
        vlrs: tuple[Vlr, ...] = ()
        evlrs: tuple[Evlr, ...] = ()
        if not faults:
            with gathered(faults):
                vlrs = tuple(_read_vlrs(path, file, header_size, points_start, n_vlrs))
            with gathered(faults):
                evlrs = tuple(_read_evlrs(path, file, raw, size))
    if faults:
        raise InputError(str(path), faults)
    return LasHeader(
        path=path,
        size_bytes=size,
        raw=raw,
        version=(raw[24], raw[25]),
        point_format=point_format,
        compressed=compressed,
        record_size=record_size,
        n_points=n_points,
        points_start=points_start,
        scales=floats[0:3],
        offsets=floats[3:6],
        mins_m=floats[7::2],
        maxs_m=floats[6::2],
        vlrs=vlrs,
        evlrs=evlrs,
    )


def _read_raw(path: Path, file: BinaryIO) -> bytes:
    head = file.read(max(HEADER_SIZES.values()))
    if head[:4] != b"LASF":
        raise InputError(
            str(path),
            f"is not a LAS or LAZ file: its first bytes are {head[:4].hex(' ')} and not the "
            "letters LASF; name .las and .laz files only",
        )
    if len(head) < min(HEADER_SIZES.values()):
        raise InputError(
            str(path), f"is cut off inside its header: {len(head)} bytes; copy it again"
        )
    major, minor = head[24], head[25]
    if major != 1 or minor not in HEADER_SIZES:
        raise InputError(
            str(path), f"is LAS version {major}.{minor}; 1.0 to 1.4 can be read: convert it"
        )
    if len(head) < HEADER_SIZES[minor]:
        raise InputError(
            str(path), f"is cut off inside its header: {len(head)} bytes; copy it again"
        )
    return head[: HEADER_SIZES[minor]]


def _signature_bytes(file: BinaryIO, points_start: int) -> int:
    """Bytes of the start signature of LAS 1.0 behind the offset to the points, 0 or 2."""
    file.seek(max(points_start - 2, 0))
    around = file.read(4)
    return 2 * (around[2:] in _START_SIGNATURES and around[:2] not in _START_SIGNATURES)


def _coordinate_faults(floats: tuple[float, ...], n_points: int) -> list[str]:
    """Scales, offsets and ends of the bounding box that cannot be."""
    faults = []
    for axis, name in enumerate("xyz"):
        scale, offset = floats[axis], floats[3 + axis]
        high, low = floats[6 + 2 * axis : 8 + 2 * axis]
        box, far = f"bounding box {name} {low} to {high}", _HIGH_M if name == "z" else _FAR_M
        steps = (low - offset) / scale if scale > 0 else 0.0
        if not 0 < scale <= _SCALE_MAX_M:
            allowed = f"must be > 0 and <= {_SCALE_MAX_M}"
            faults.append(f"{name} scale {scale}; {allowed}: the header is damaged")
        if not abs(offset) <= _FAR_M:
            allowed = f"allowed -{_FAR_M:.0f} to {_FAR_M:.0f}"
            faults.append(f"{name} offset {offset}; {allowed}: the header is damaged")
        if n_points and not (math.isfinite(low) and math.isfinite(high) and low <= high):
            order = "must be finite and in order"
            faults.append(f"{box}; {order}: repair the header (lasinfo -repair_bb)")
        elif n_points and max(abs(low), abs(high)) > far:
            faults.append(f"{box}; allowed -{far:.0f} to {far:.0f}: the header is damaged")
        elif n_points and abs(abs(steps + 0.5) - (2**31 - 0.5)) < 0.5:  # -(2**31) or 2**31 - 1
            faults.append(
                f"{box} starts at the end of 32-bit numbers of scale {scale} and offset {offset}:"
                " coordinates did not fit when they were written; write the file again with an"
                " offset near its points"
            )
    return faults


def _read_vlrs(path: Path, file: BinaryIO, start: int, stop: int, count: int) -> Iterator[Vlr]:
    file.seek(start)
    for number in range(1, count + 1):
        name = f"VLR {number} of {count}"
        start = bounded(
            path, f"end of the head of {name}", start + VLR_HEAD.size, most=stop, remedy=REWRITE
        )
        _, user_id, record_id, length, description = VLR_HEAD.unpack(file.read(VLR_HEAD.size))
        start += bounded(path, f"length of {name}", length, most=stop - start, remedy=REWRITE)
        yield Vlr(user_id, record_id, description, file.read(length))


def _read_evlrs(path: Path, file: BinaryIO, raw: bytes, size: int) -> Iterator[Evlr]:
    minor = raw[25]
    if minor < 3:
        return
    if minor == 3:
        # 1.3 knows one extended record, the waveforms, and gives its offset only.
        start, count = int.from_bytes(raw[227:235], "little"), 1
        if start == 0 or not raw[6] & 2:
            return
    else:
        start, count = struct.unpack_from("<QI", raw, 235)
    bounded(path, "number of extended VLRs", count, most=_MAX_RECORDS, remedy=REWRITE)
    for number in range(1, count + 1):
        name = f"extended VLR {number} of {count}"
        bounded(path, f"start of {name}", start, most=size - EVLR_HEAD.size)
        file.seek(start)
        _, user_id, record_id, length, description = EVLR_HEAD.unpack(file.read(EVLR_HEAD.size))
        start += EVLR_HEAD.size
        bounded(path, f"length of {name}", length, most=size - start)
        yield Evlr(user_id, record_id, description, start, length)
        start += length
