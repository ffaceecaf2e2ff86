"""Records of a LAS header that standard readers parse, and whether they can.

A damaged one may make a reader fail on the whole file. What is delivered must open everywhere, so
such a record is not copied.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import laspy
from laspy.vlrs.known import BaseKnownVLR

from spl_batch.errors import is_fault, one_line
from spl_batch.formats.las.chunks import LASZIP_KEY
from spl_batch.formats.las.header import Evlr, LasHeader, Vlr
from spl_batch.formats.las.records import EXTRA_BYTES_KEY

_OCTREE_USER: Final = "copc"
_OCTREE_KEYS: Final = ((_OCTREE_USER, 1), (_OCTREE_USER, 1000))
"""Records of a COPC file that a copy in the order of its points does without."""

_PARSED_BYTES: Final = 1 << 20
"""Longest record that is parsed [byte]: known ones are short, longer ones are copied."""


def reads_back(path: Path, record: Vlr | Evlr) -> bool:
    """Whether laspy can parse a record of a file, or does not look into it."""
    return _fault(path, record) is None


def broken_records(header: LasHeader) -> Iterator[str]:
    """User id, record id and fault of each record that a copy of the file does without.

    It cannot be parsed, there are more of it than the one that counts, or it says of an octree
    what is not there: one begins with the record that tells of it [COPC 1.0].
    """
    records: list[Vlr | Evlr] = [*header.vlrs, *header.evlrs]
    octree = header.compressed and [r.key for r in header.vlrs[:1]] == [_OCTREE_KEYS[0]]
    counting = {EXTRA_BYTES_KEY: 1, LASZIP_KEY: int(header.compressed)}
    counting |= dict.fromkeys(_OCTREE_KEYS, int(octree))
    counts = {
        id(record)
        for key, most in counting.items()
        for record in [r for r in _where(header, key) if r.key == key][:most]
    }
    for record in records:
        fault = _fault(header.path, record)
        name = ascii(record.user_id.rstrip(b"\0").decode("latin-1")).strip("'")
        if fault is not None:
            yield f"header record {name} {record.record_id} cannot be parsed ({fault})"
        elif record.key[0] == _OCTREE_USER and id(record) not in counts:
            yield f"header record {name} {record.record_id} tells of an octree that is not there"
        elif record.key in counting and id(record) not in counts:
            yield f"header record {name} {record.record_id} stands there once more than it counts"


def _where(header: LasHeader, key: tuple[str, int]) -> Sequence[Vlr | Evlr]:
    """Records among which one has its place: the octree's nodes lie behind the points."""
    return header.evlrs if key == _OCTREE_KEYS[1] else header.vlrs


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
                if content is None:
                    return None
                kind.from_raw(laspy.VLR(name, record.record_id, description, content))
    except BaseException as error:
        if not is_fault(error):
            raise
        return one_line(error)
    return None


def _content(path: Path, record: Vlr | Evlr) -> bytes | None:
    """Content of a record; None of one that is too long to be parsed."""
    if isinstance(record, Vlr):
        return record.data
    if record.size > _PARSED_BYTES:
        return None
    with path.open("rb") as file:
        file.seek(record.start)
        return file.read(record.size)
