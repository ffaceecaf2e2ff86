"""A LAS 1.4 file once more as COPC, with everything that its records hold."""

from pathlib import Path

from spl_batch.errors import InputError
from spl_batch.formats.crs import WKT_KEY
from spl_batch.formats.las.chunks import LASZIP_KEY, RecordReader
from spl_batch.formats.las.copc import write_copc
from spl_batch.formats.las.frame import Frame, preamble, wkt_vlr
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.reader import header_crs
from spl_batch.formats.las.records import EXTRA_BYTES_KEY

POINT_FORMATS = (6, 7, 8)
"""Point formats that COPC knows [COPC 1.0]."""


def copc_fault(point_format: int, scales: tuple[float, float, float]) -> str | None:
    """Why points cannot be written as COPC; None where they can."""
    if point_format not in POINT_FORMATS:
        why = f"point format {point_format} with waveforms is none that COPC knows"
    elif len(set(scales)) > 1:
        why = f"scales {', '.join(f'{s:g}' for s in scales)} differ by axis, COPC has one"
    else:
        return None
    return f"{why}; set outputs.copc: false"


def copy_as_copc(src: Path, dst: Path) -> int:
    """Write the points of a file as an octree.

    All dimensions are kept, extra bytes too, and so are scale, offset and the records of the
    header; extended records are left out, but for the CRS. The order of the points changes.

    ``src``: LAS or LAZ of point format 6, 7 or 8.

    Raises
    ------
    InputError
        If the file is damaged, or has what COPC cannot hold.
    """
    header = read_header(src)
    fault = copc_fault(header.point_format, header.scales)
    if fault is not None:
        raise InputError(str(src), fault)
    with RecordReader(header) as reader:
        records, layout = reader.read(0, header.n_points), reader.layout
    dropped = {LASZIP_KEY, EXTRA_BYTES_KEY}
    vlrs = [v for v in header.vlrs if v.key not in dropped and v.key[0] != "copc"]
    crs = header_crs(header)[0]
    if crs is not None and WKT_KEY not in {v.key for v in vlrs}:
        vlrs.append(wkt_vlr(crs))
    frame = Frame(
        preamble=preamble(header.raw, header.global_encoding),
        scales=header.scales,
        offsets=header.offsets,
        layout=layout,
        vlrs=vlrs,
    )
    return write_copc(dst, frame, records)
