"""Records of a LAS header that standard readers parse, and whether they can.

A damaged one may make a reader fail on the whole file. What is delivered must open everywhere, so
such a record is not copied.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import laspy
from laspy.vlrs.known import BaseKnownVLR

from spl_batch.errors import is_fault, one_line
from spl_batch.formats.las.chunks import LASZIP_KEY
from spl_batch.formats.las.header import Evlr, LasHeader, Vlr
from spl_batch.formats.las.records import EXTRA_BYTES_KEY

_PARSED_BYTES: Final = 1 << 20
"""Longest record that is parsed [byte]: known ones are short, longer ones are copied."""


def reads_back(path: Path, record: Vlr | Evlr) -> bool:
    """Whether laspy can parse a record of a file, or does not look into it."""
    return _fault(path, record) is None


def broken_records(header: LasHeader) -> Iterator[str]:
    """User id, record id and fault of each record that a copy of the file does without.

    It cannot be parsed, or there are more of it than the one that counts.
    """
    records: list[Vlr | Evlr] = [*header.vlrs, *header.evlrs]
    counting = {EXTRA_BYTES_KEY: 1, LASZIP_KEY: int(header.compressed)}
    counts = {
        id(record)
        for key, most in counting.items()
        for record in [r for r in header.vlrs if r.key == key][:most]
    }
    for record in records:
        fault = _fault(header.path, record)
        name = ascii(record.user_id.rstrip(b"\0").decode("latin-1")).strip("'")
        if fault is not None:
            yield f"header record {name} {record.record_id} cannot be parsed ({fault})"
        elif record.key in counting and id(record) not in counts:
            yield f"header record {name} {record.record_id} stands there once more than it counts"


def _fault(path: Path, record: Vlr | Evlr) -> str | None:
    """Why a record cannot be parsed; None where it can."""
    try:
        name, description = (
            text.split(b"\0")[0].decode() for text in (record.user_id, record.description)
        )
        for kind in BaseKnownVLR.__subclasses__():
            ids = kind.official_record_ids()
            if kind.official_user_id() == name and record.record_id in ids:
                content = _content(path, record)
                kind.from_raw(laspy.VLR(name, record.record_id, description, content))
    except BaseException as error:
        if not is_fault(error):
            raise
        return one_line(error)
    return None


def _content(path: Path, record: Vlr | Evlr) -> bytes:
    if isinstance(record, Vlr):
        return record.data
    with path.open("rb") as file:
        file.seek(record.start)
        return file.read(min(record.size, _PARSED_BYTES))
