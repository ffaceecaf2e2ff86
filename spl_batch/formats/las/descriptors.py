"""What a header says of extra bytes, of its system and its day, as standard readers take it.

laspy refuses a file whose extra bytes have a name twice, or one that the record has already, a
text that is no UTF-8, or a scale that is no number: what is delivered is put in order, and told.
"""

import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Final

import laspy
import numpy as np

from spl_batch.constants import ADJUSTED_STANDARD_OFFSET_S
from spl_batch.formats.gps_clock import leap_seconds
from spl_batch.formats.las.header import (
    ADJUSTED_BIT,
    EXTERNAL_BIT,
    INTERNAL_BIT,
    WAVEFORM_FORMATS,
    WKT_BIT,
    LasHeader,
    waveform_file,
)
from spl_batch.formats.las.records import (
    ADDED,
    FIRST_CLASS,
    OFFSET_BIT,
    SCALE_BIT,
    ExtraDimension,
    added,
    descriptors,
    is_misread,
    record_layout,
    standard_dtype,
)

_REPLACED: Final = frozenset(added(name).descriptor for name in ADDED if name != FIRST_CLASS)
"""Descriptors of what an earlier run added and no copy keeps."""

_NAME: Final = slice(4, 36)
_SCALE, _OFFSET = 112, 136
_TEXT: Final = slice(160, 192)
_GPS_EPOCH: Final = datetime(1980, 1, 6)  # noqa: DTZ001 - a day of UTC
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


def in_order(
    extra: Sequence[ExtraDimension], point_format: int, added: Sequence[ExtraDimension]
) -> Iterator[tuple[ExtraDimension, ExtraDimension, list[str]]]:
    """Extra dimensions that a copy keeps, and as standard readers take them, with their faults.

    Parameters
    ----------
    extra : sequence of ExtraDimension
        Of the input; labels of an earlier run, but for its first classes, are left out.
    point_format : int
        Of the copy.
    added : sequence of ExtraDimension
        Dimensions that the copy gets.
    """
    standard = laspy.PointFormat(point_format).standard_dimension_names
    taken = {*standard, *(standard_dtype(point_format).names or ()), *(d.name for d in added)}
    for dimension in extra:
        if dimension.descriptor not in _REPLACED:
            mended, faults = _mended(dimension, taken)
            taken.add(mended.name)
            yield dimension, mended, faults


def put_in_order(
    header: LasHeader, point_format: int, added: Sequence[ExtraDimension]
) -> Iterator[str]:
    """What of a file's header a copy has in another way; arguments of :func:`in_order`."""
    external = header.point_format in WAVEFORM_FORMATS and header.global_encoding & EXTERNAL_BIT
    if external and waveform_file(header.path, header.point_format) is None:
        name = header.path.with_suffix(".wdp").name
        yield f"its header names waveforms in {name}, which is not beside it: the bit is cleared"
    for descriptor in descriptors(header):
        if is_misread(descriptor):
            name = _text(descriptor[_NAME])
            yield f"extra dimension {name!a}: a block without a type, which is several of bytes"
    for _, mended, faults in in_order(record_layout(header).extra, point_format, added):
        if faults:
            yield f"extra dimension {mended.name!a}: {', '.join(faults)}"


def header_changes(given: LasHeader, copy: LasHeader) -> list[str]:
    """Names of the header's fields that a copy has in another way."""
    bits = given.global_encoding ^ copy.global_encoding
    fields = (name for name, part in _FIELDS.items() if given.raw[part] != copy.raw[part])
    return [*(name for name, some in _BITS.items() if bits & some), *fields]


def sound_system(given: bytes) -> bytes:
    """System identifier in ASCII; of a file that names none what was done to it."""
    known = bytes(b if b < 0x80 else ord("?") for b in given)
    return known if known.strip(b"\0 ") else b"MODIFICATION".ljust(32, b"\0")


def sound_date(given: bytes, last_s: float | None) -> bytes:
    """Day of the year and year of a header; where there is no such day that of the last point.

    ``last_s``: its adjusted standard time [s]; without one zeros, which stand for no day.
    """
    day, year = struct.unpack("<HH", given)
    if 1 <= day <= 366 and 1 <= year <= 9999:
        return given
    if last_s is None:
        return bytes(4)
    seconds = last_s + ADJUSTED_STANDARD_OFFSET_S - leap_seconds(last_s)
    found = (_GPS_EPOCH + timedelta(seconds=seconds)).timetuple()
    return struct.pack("<HH", found.tm_yday, found.tm_year)


def _mended(dimension: ExtraDimension, taken: Collection[str]) -> tuple[ExtraDimension, list[str]]:
    raw, faults = bytearray(dimension.descriptor), []
    name, text = _free(_text(raw[_NAME]), taken), _text(raw[_TEXT])
    if not _holds(raw[_NAME], name):
        known = dimension.name and _holds(raw[_NAME], dimension.name)
        faults.append(f"{dimension.name!a} is taken" if known else "its name was no text")
        raw[_NAME] = name.encode().ljust(32, b"\0")
    if not _holds(raw[_TEXT], text):
        faults.append("its description is no text")
        raw[_TEXT] = text.encode().ljust(32, b"\0")
    scale, offset = dimension.scale, dimension.offset
    elements = (raw[2] - 1) // 10 + 1 if raw[2] else 0
    for bit, start in ((SCALE_BIT, _SCALE), (OFFSET_BIT, _OFFSET)):
        values = np.frombuffer(raw, "<f8", elements, start)
        sound = np.isfinite(values) & ((values != 0) | (bit != SCALE_BIT))
        if raw[3] & bit and not sound.all():
            faults.append("its scale or offset cannot be used")
            raw[3] &= 0xFF ^ (SCALE_BIT | OFFSET_BIT)
            scale = offset = None
    new = replace(dimension, name=name, scale=scale, offset=offset, descriptor=bytes(raw))
    return new, faults


def _text(field: bytes | bytearray) -> str:
    """Text of a field up to its first zero, without what is no UTF-8."""
    return field.split(b"\0")[0].decode("utf-8", errors="ignore")


def _holds(field: bytearray, text: str) -> bool:
    return field.split(b"\0")[0] == text.encode()


def _free(name: str, taken: Collection[str]) -> str:
    """The name, or, where it is taken, it and the first number that is free."""
    name = name or "unnamed"
    found, k = name, 2
    while found in taken:
        ending = f"_{k}"
        found = name.encode()[: 32 - len(ending)].decode("utf-8", errors="ignore") + ending
        k += 1
    return found
