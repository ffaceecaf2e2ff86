"""Points of several clouds that lie in an area, as one cloud with all their dimensions.

Where clouds differ, the cut has the largest point format, the extra bytes of all, the finest scale
and the offset of the first; what a cloud lacks is 0. Raw coordinates stay where scale and offset
do. A point comes in the order of the clouds, and in that within its cloud.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import InputError
from spl_batch.formats.las.chunks import RecordReader
from spl_batch.formats.las.convert import Conversion
from spl_batch.formats.las.frame import Frame, preamble, wkt_vlr, write_laz
from spl_batch.formats.las.header import ADJUSTED_BIT, LasHeader, Vlr, read_header
from spl_batch.formats.las.known_records import header_crs
from spl_batch.formats.las.reader import own_coordinate
from spl_batch.formats.las.records import ExtraDimension, RecordLayout, record_layout

Within = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]
"""Which points, by their eastings and northings in the cloud's unit, lie in the area: (n,) bool."""

_BOUNDS_BITS: Final = 0b110
"""Options of an extra dimension: its least and largest value are given [LAS 1.4 R15, table 24]."""


class Piece(NamedTuple):
    """A cloud of point format 6, 7 or 8, and its records that may lie in the area."""

    path: Path
    ranges: Sequence[tuple[int, int]]  #: Half-open, in order.


def write_cut(
    dst: Path,
    pieces: Sequence[Piece],
    within: Within,
    *,
    records_of_file: Sequence[Vlr] = (),
) -> int:
    """Write the points of some clouds that lie in an area; their number.

    Parameters
    ----------
    dst : Path
        LAZ file, replaced only by a finished one.
    pieces : sequence of Piece
        One at least.
    records_of_file : sequence of Vlr
        Records of its header beside the CRS, which is that of the first cloud.

    Raises
    ------
    InputError
        If a cloud is damaged, or does not go together with the first.
    """
    headers = [read_header(piece.path) for piece in pieces]
    first, crs = headers[0], header_crs(headers[0])[0]
    layout = _joined(headers)
    scales = np.array([header.scales for header in headers]).min(axis=0).tolist()
    frame = Frame(
        preamble=preamble(first.raw[:4] + bytes(2) + first.raw[6:], first.global_encoding),
        scales=(scales[0], scales[1], scales[2]),
        offsets=first.offsets,
        layout=layout,
        vlrs=[*([] if crs is None else [wkt_vlr(crs)]), *records_of_file],
    )

    def chunks() -> Iterator[NDArray[Any]]:
        for piece, header in zip(pieces, headers, strict=True):
            with RecordReader(header) as reader:
                for start, stop in piece.ranges:
                    given = reader.read(start, stop)
                    x, y = (own_coordinate(given, header, axis, start) for axis in range(2))
                    yield _converted(given[within(x, y)], reader.layout, header, frame)

    return write_laz(dst, frame, chunks())


def _joined(headers: Sequence[LasHeader]) -> RecordLayout:
    """Layout of records with the dimensions of all clouds."""
    found: dict[str, tuple[LasHeader, ExtraDimension]] = {}
    for header in headers:
        if (header.global_encoding ^ headers[0].global_encoding) & ADJUSTED_BIT:
            raise InputError(
                str(header.path),
                f"counts gps_time in another way than {headers[0].path}: a tile has one clock; "
                "give all files the same, or process them apart",
            )
        for one in record_layout(header).extra:
            owner, known = found.setdefault(one.name, (header, one))
            if _meaning(known) != _meaning(one):
                raise InputError(
                    str(header.path),
                    f"extra dimension {one.name!a} is of another type or scale than in "
                    f"{owner.path}: a tile has one; rename it in one of both",
                )
            if known.descriptor != one.descriptor:  # their least and largest values differ
                options = bytes([known.descriptor[3] & ~_BOUNDS_BITS])
                described = known.descriptor[:3] + options + known.descriptor[4:]
                found[one.name] = owner, replace(known, descriptor=described)
    extra = (replace(one, field=f"extra_{k}") for k, (_, one) in enumerate(found.values()))
    return RecordLayout(max(header.point_format for header in headers), tuple(extra))


def _meaning(one: ExtraDimension) -> tuple[object, ...]:
    return str(one.dtype), one.scale, one.offset


def _converted(
    given: NDArray[Any], layout: RecordLayout, header: LasHeader, frame: Frame
) -> NDArray[Any]:
    """Records of a cloud as those of the cut."""
    fields = {one.name: one.field for one in frame.layout.extra}
    kept = tuple((one.field, fields[one.name]) for one in layout.extra)
    out = Conversion(layout, frame.layout, kept).records(given)
    if (header.scales, header.offsets) != (frame.scales, frame.offsets):
        raw = np.column_stack([given[axis] for axis in "XYZ"])
        frame.set_coordinates(out, raw * header.scales + header.offsets, header.path)
    return out
