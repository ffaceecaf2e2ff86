"""Points that a file holds beyond those that its header counts: none may be passed over.

The header of a writer that was stopped has no count of the points, and a damaged header counts
too few. What lies behind the counted points then shows it.
"""

from typing import BinaryIO, Final

import lazrs
import numpy as np

from spl_batch.errors import InputError, grouped, is_fault
from spl_batch.formats.las.header import EVLR_HEAD, LasHeader

_REST_BYTES: Final = 4
"""Bytes that compressed points may leave over [byte]; LASzip's and lazrs's leave none."""

_READ_BYTES: Final = 1 << 20
_WAVEFORMS_AT: Final = 227
"""Where a header of LAS 1.3 and later has the offset of the waveforms."""


def miscounted(header: LasHeader, there: str) -> InputError:
    """Fault of a file with more points than its header counts; ``there`` names what there is."""
    return InputError(
        str(header.path),
        f"its header counts {grouped(header.n_points)} points, but {there}: the number of points is"
        " wrong, write the file again with the software that made it or correct its header",
    )


def refuse_uncounted_records(header: LasHeader, file: BinaryIO) -> None:
    """Refuse an uncompressed file with whole records behind those that its header counts.

    A rest that is shorter than a record, and zeros of any length, are no records.
    """
    size, start = header.record_size, header.points_start
    counted_end = start + header.n_points * size
    stop = _points_stop(header, counted_end)
    if _holds_data(file, counted_end, stop, size):
        raise miscounted(header, f"there is room for {grouped((stop - start) // size)}")


def refuse_uncounted_chunks(header: LasHeader, file: BinaryIO) -> None:
    """Refuse a LAZ file that counts no points and has compressed ones.

    The first point of a chunk lies in it as it is: a chunk is no shorter than a record.
    """
    start = header.points_start + 8
    stop, offset = _points_stop(header, start), chunk_table_byte(header, file)
    if start <= offset <= header.size_bytes - 8:
        stop = offset
    if _holds_data(file, start, stop, header.record_size):
        raise miscounted(header, f"{grouped(stop - start)} bytes of compressed points lie in it")


def chunk_table_byte(header: LasHeader, file: BinaryIO) -> int:
    """Byte of the LAZ chunk table, as the file has it; a stream has it in its last 8 bytes."""
    file.seek(header.points_start)
    offset = int.from_bytes(file.read(8), "little", signed=True)
    if offset == -1 and header.size_bytes >= header.points_start + 16:
        file.seek(header.size_bytes - 8)
        offset = int.from_bytes(file.read(8), "little", signed=True)
    return offset


def refuse_uncounted_rest(header: LasHeader, laszip: bytes, packed: bytes, count: int) -> None:
    """Refuse a LAZ file of point formats 0-5 whose last chunk has more points than are counted.

    Such a chunk has no count of what it holds. But its last point takes its last bytes: where the
    ``count`` points that the header leaves for it do without them, these are of others. What takes
    no more than :data:`_REST_BYTES`, mostly one point, may pass.
    """
    shorter = packed[:-_REST_BYTES]
    if len(shorter) < header.record_size:
        return
    unpacked = np.empty(count * header.record_size, np.uint8)
    try:
        lazrs.decompress_points_with_chunk_table(shorter, laszip, unpacked, [(count, len(shorter))])
    except BaseException as error:
        if not is_fault(error) or isinstance(error, MemoryError):
            raise
        return  # it ends too early, as it should
    raise miscounted(header, "its last LAZ chunk holds more")


def _points_stop(header: LasHeader, least: int) -> int:
    """Byte at which what follows the points starts; not before ``least``."""
    offsets = [evlr.start - EVLR_HEAD.size for evlr in header.evlrs]
    if header.version[1] >= 3:
        offset = header.raw[_WAVEFORMS_AT : _WAVEFORMS_AT + 8]
        offsets.append(int.from_bytes(offset, "little"))
    return min([header.size_bytes, *(offset for offset in offsets if offset >= least)])


def _holds_data(file: BinaryIO, start: int, stop: int, least: int) -> bool:
    """Whether ``least`` bytes or more lie between two offsets, and not only zeros."""
    if stop - start < least:
        return False
    file.seek(start)
    while start < stop and (part := file.read(min(stop - start, _READ_BYTES))):
        if part.count(0) < len(part):
            return True
        start += len(part)
    return False
