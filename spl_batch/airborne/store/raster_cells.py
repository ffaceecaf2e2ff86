"""The working raster store: Zarr arrays with a chunk for each square of the ground cells' grid.

The arrays cover one huge absolute index space, so that a raster cell has the same index
whatever the survey is, and a ground cell is one chunk, or a few at a survey's edge: a task
writes its own chunks and no other task's. One of nothing but nodata is written as well.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.errors import DamagedError, StoreError
from spl_batch.formats.files.atomic import read_bytes, size, write_bytes
from spl_batch.formats.verified.zarr_chunks import (
    METADATA,
    Metadata,
    describe,
    encode,
    parse,
    read_box,
    read_metadata,
)
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, shared

HALF_CELLS: Final = 2**20
"""Ground cells on each side of coordinate zero that the store has room for [count]."""


def create_raster_store(
    path: Path, names: Sequence[str], *, ground_cell: int, raster_cell: int
) -> None:
    """Make the arrays of the working store; those that are there and sound are kept.

    Parameters
    ----------
    path : Path
        Folder of the store.
    names : sequence of str
        One float32 array each.
    ground_cell, raster_cell : int
        Edges of a chunk and of a raster cell [quanta]; the first a multiple of the second.

    Raises
    ------
    StoreError
        If the store was made for other cell sizes.
    """
    px, remainder = divmod(ground_cell, raster_cell)
    if remainder or px < 1:
        raise StoreError(f"{path}: {ground_cell} is not a whole multiple of {raster_cell} quanta")
    side = 2 * HALF_CELLS * px
    facts: dict[str, Any] = {"ground_cell_quanta": ground_cell, "raster_cell_quanta": raster_cell}
    group = b'{"attributes": {}, "node_type": "group", "zarr_format": 3}'
    if size(path / METADATA) < 0 or read_bytes(path / METADATA) != group:
        write_bytes(path / METADATA, group, durable=False)
    for name in names:
        content = describe(
            shape=(side, side), chunks=(px, px), dtype="f4", fill_value=NODATA, attributes=facts
        )
        try:
            found = read_metadata(path / name)
        except DamagedError:
            # Its chunks are sound or not by themselves.
            write_bytes(path / name / METADATA, content, durable=False)
            continue
        if found != parse(content, path / name):
            raise StoreError(f"{path}: {name} was made for {found['attributes']}, not {facts}")


def write_cell(path: Path, cell: CellId, arrays: Mapping[str, NDArray[np.float32]]) -> list[Path]:
    """Write the rasters of one ground cell: chunks that are replaced as a whole.

    Parameters
    ----------
    path : Path
        Store from :func:`create_raster_store`.
    cell : CellId
        Column and row of its south-western square.
    arrays : mapping of str to (rows, columns) float32
        Rasters of its squares, row 0 northernmost.

    Returns
    -------
    list of Path
        Files of the chunks.

    Raises
    ------
    StoreError
        If there is no such raster or it is not made of whole squares.
    """
    written = []
    for name, values in arrays.items():
        metadata, px, _ = _array(path, name)
        if not values.size or any(side % px for side in values.shape):
            size_of = f"{name} of cell {cell} is {values.shape}"
            raise StoreError(f"{path}: {size_of}, not whole squares of {px} raster cells")
        rows, columns = (side // px for side in values.shape)
        top, left = HALF_CELLS - cell.j - rows, HALF_CELLS + cell.i
        box = (slice(top * px, (top + rows) * px), slice(left * px, (left + columns) * px))
        for chunk, content in encode(metadata, box, values).items():
            write_bytes(path / name / chunk, content, durable=False)
            written.append(path / name / chunk)
    return written


def read_window(path: Path, name: str, bounds: Bounds) -> NDArray[np.float32]:
    """Part of a stored raster, row 0 northernmost; ``bounds`` are whole raster cells [quanta].

    Raises StoreError if there is no such raster or the region is not aligned to its cells, and
    DamagedError, which names it, if a chunk is damaged or not there.
    """
    metadata, px, edge = _array(path, name)
    if any(side % edge for side in bounds):
        raise StoreError(f"{path}: {bounds} is not aligned to raster cells of {edge} quanta")
    zero = HALF_CELLS * px
    rows = slice(zero - bounds.ymax // edge, zero - bounds.ymin // edge)
    cols = slice(zero + bounds.xmin // edge, zero + bounds.xmax // edge)
    return read_box(path / name, metadata, (rows, cols)).astype(np.float32, copy=False)


def stored_blocks(
    path: Path, name: str, bounds: Bounds, cells: Iterable[CellId], *, ground_cell: int
) -> Iterator[tuple[int, int, NDArray[np.float32]]]:
    """Pieces of a stored raster for ``write_cog``, one ground cell at a time.

    Parameters
    ----------
    path : Path
        Store from :func:`create_raster_store`.
    name : str
        Which of its rasters.
    bounds : Bounds
        Region of the mosaic [quanta]; cells beyond it are cut.
    cells : iterable of CellId
        Ground cells to read, best in rows from north to south.
    ground_cell : int
        Edge of a ground cell [quanta].

    Yields
    ------
    row, col, block
        Place in the mosaic, row 0 northernmost, and values.
    """
    _, _, edge = _array(path, name)
    for cell in cells:
        part = shared(cell_bounds(cell, ground_cell), bounds)
        if part.xmax > part.xmin and part.ymax > part.ymin:
            row = (bounds.ymax - part.ymax) // edge
            col = (part.xmin - bounds.xmin) // edge
            yield row, col, read_window(path, name, part)


def _array(path: Path, name: str) -> tuple[Metadata, int, int]:
    """Metadata of an array, cells per chunk side, edge of a raster cell [quanta]."""
    metadata = read_metadata(path / name)
    px = metadata["chunk_grid"]["configuration"]["chunk_shape"][0]
    return metadata, int(px), int(metadata["attributes"]["raster_cell_quanta"])
