"""Records of a LAS header that a copy does without: no reader parses them, or they are misplaced.

What is delivered must open everywhere; a damaged record may make a reader fail on a whole file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import laspy
from laspy.vlrs.known import BaseKnownVLR

from spl_batch.errors import is_fault, one_line
from spl_batch.formats.las.header import (
    EXTERNAL_BIT,
    WAVEFORM_FORMATS,
    Evlr,
    LasHeader,
    Vlr,
    waveform_file,
)

_PARSED_BYTES: Final = 1 << 20
"""Longest record that is parsed [byte]: known ones are short, longer ones are copied."""


def broken_records(header: LasHeader) -> Iterator[str]:
    """What of a file's header a copy does without, a text for each.

    Records that cannot be parsed, and the name of a file of waveforms that is not there.
    """
    records: list[Vlr | Evlr] = [*header.vlrs, *header.evlrs]
    for record in records:
        fault = record_fault(header.path, record)
        if fault is not None:
            name = ascii(record.user_id.rstrip(b"\0").decode("latin-1")).strip("'")
            yield f"header record {name} {record.record_id} cannot be parsed ({fault})"
    external = header.point_format in WAVEFORM_FORMATS and header.global_encoding & EXTERNAL_BIT
    if external and waveform_file(header.path, header.point_format) is None:
        name = header.path.with_suffix(".wdp").name
        yield f"its header names waveforms in {name}, which is not beside it"


def record_fault(path: Path, record: Vlr | Evlr) -> str | None:
    """Why laspy cannot parse a record of a file; None where it can, or does not look into it."""
    try:
        name, description = (
            text.split(b"\0")[0].decode() for text in (record.user_id, record.description)
        )
        for kind in BaseKnownVLR.__subclasses__():
            ids = kind.official_record_ids()
            if kind.official_user_id() == name and record.record_id in ids:
                content = _content(path, record)
                if content is not None:
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
