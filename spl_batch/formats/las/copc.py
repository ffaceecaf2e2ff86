"""Cloud-optimised point clouds: LAZ whose chunks are the nodes of an octree [COPC 1.0].

A node keeps one point of each of its 128^3 cells and hands the others to its children; a node with
few points keeps them all. The order of the records alone decides which point stays, and cells are
whole numbers of raw coordinate steps: the same records give the same bytes.
"""

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import InputError
from spl_batch.formats.crs import WKT_KEY
from spl_batch.formats.las.chunks import LASZIP_KEY, VARIABLE, RecordReader
from spl_batch.formats.las.frame import (
    OFFSET,
    Extent,
    Frame,
    framed,
    laz_record,
    output_file,
    packed_chunk,
    preamble,
    wkt_vlr,
    write_chunks,
)
from spl_batch.formats.las.header import EVLR_HEAD, HEADER_SIZES, VLR_HEAD, Vlr, read_header
from spl_batch.formats.las.known_records import header_crs
from spl_batch.formats.las.records import EXTRA_BYTES_KEY

_USER: Final = b"copc"
_INFO_ID: Final = 1
_HIERARCHY_ID: Final = 1000
_INFO: Final = struct.Struct("<5dQQdd11Q")
_ENTRY: Final = struct.Struct("<4iQii")
_CELLS_LOG2: Final = 7
_LEAF_POINTS: Final = 4096
_INFO_START: Final = HEADER_SIZES[4] + VLR_HEAD.size


POINT_FORMATS = (6, 7, 8)
"""Point formats that COPC knows [COPC 1.0]."""


class Node(NamedTuple):
    """A node of the octree and the records that it holds."""

    level: int
    x: int
    y: int
    z: int
    records: NDArray[np.intp]


class Cube(NamedTuple):
    """The octree's extent, in raw coordinate steps; its edge is ``2 ** log2_size``."""

    low: tuple[int, int, int]
    log2_size: int


def write_copc(path: Path, frame: Frame, records: NDArray[Any]) -> int:
    """Write records as COPC, atomically; their count.

    Parameters
    ----------
    path : Path
        Final name.
    frame : Frame
        Everything but the points; point format 6 to 8, the same scale on every axis.
    records : (n,) structured
        Of the frame's layout.
    """
    cube, nodes = octree(records)
    laz, extent = laz_record(frame.layout, VARIABLE), Extent()

    def chunks() -> Iterator[tuple[int, bytes]]:
        for node in nodes:
            part = records[node.records]
            extent.add(part)
            yield len(part), packed_chunk(part, laz)

    info = Vlr(_USER, _INFO_ID, b"COPC info", bytes(_INFO.size))
    frame = replace(frame, vlrs=[info, *frame.vlrs], evlrs=())
    with output_file(path) as file:
        with framed(file, frame, laz, extent) as more:
            offset = file.tell() + OFFSET.size
            hierarchy = b""
            for node, (count, size) in zip(nodes, write_chunks(file, laz, chunks()), strict=True):
                key = (node.level, node.x, node.y, node.z)
                hierarchy += _ENTRY.pack(*key, offset, size, count)
                offset += size
            more.append(Vlr(_USER, _HIERARCHY_ID, b"COPC hierarchy", hierarchy))
            root = file.seek(0, 2) + EVLR_HEAD.size, len(hierarchy)
        file.seek(_INFO_START)
        file.write(_info(frame, records, cube, root))
    return len(records)


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


def octree(records: NDArray[Any]) -> tuple[Cube, list[Node]]:
    """Octree over raw coordinates.

    Parameters
    ----------
    records : (n,) structured
        With X, Y, Z int32.

    Returns
    -------
    cube : Cube
        Extent of the root.
    nodes : list of Node
        Level by level; every record is in exactly one.
    """
    xyz = np.stack([records[k].astype(np.int64) for k in "XYZ"], axis=1)
    if not len(xyz):
        return Cube((0, 0, 0), _CELLS_LOG2), []
    low = xyz.min(axis=0)
    xyz -= low
    log2_size = max(int(xyz.max()).bit_length(), _CELLS_LOG2)
    nodes: list[Node] = []
    rest = np.arange(len(xyz))
    level = 0
    while len(rest):
        kept = np.zeros(len(rest), dtype=np.bool_)
        for node in _nodes_of_level(xyz, rest, level, log2_size):
            kept[node.records] = True
            nodes.append(node._replace(records=rest[node.records]))
        rest = rest[~kept]
        level += 1
    return Cube((int(low[0]), int(low[1]), int(low[2])), log2_size), nodes


def _nodes_of_level(
    xyz: NDArray[np.int64], rest: NDArray[np.intp], level: int, log2_size: int
) -> Iterator[Node]:
    """Nodes of one level; their records are positions in ``rest``."""
    octant = xyz[rest] >> max(log2_size - level, 0)
    cell_shift = log2_size - level - _CELLS_LOG2
    order = np.lexsort((octant[:, 2], octant[:, 1], octant[:, 0]))
    new_node = np.flatnonzero(np.any(np.diff(octant[order], axis=0) != 0, axis=1)) + 1
    for members in np.split(order, new_node):
        keys = octant[members[0]].tolist()
        # Cells no larger than a coordinate step cannot thin any more.
        if len(members) > _LEAF_POINTS and cell_shift > 0:
            x, y, z = (xyz[rest[members]] >> cell_shift).T & (2**_CELLS_LOG2 - 1)
            cells = ((x << _CELLS_LOG2 | y) << _CELLS_LOG2) | z
            _, first = np.unique(cells, return_index=True)
            members = members[np.sort(first)]  # noqa: PLW2901 - the node's share of them
        yield Node(level, keys[0], keys[1], keys[2], members)


def _info(frame: Frame, records: NDArray[Any], cube: Cube, root: tuple[int, int]) -> bytes:
    scale = frame.scales[0]
    half = 2**cube.log2_size * scale / 2
    centre = [
        low * scale + offset + half for low, offset in zip(cube.low, frame.offsets, strict=True)
    ]
    spacing = 2 * half / 2**_CELLS_LOG2
    time = records["gps_time"][np.isfinite(records["gps_time"])]
    span = (float(time.min()), float(time.max())) if len(time) else (0.0, 0.0)
    return _INFO.pack(*centre, half, spacing, *root, *span, *[0] * 11)
