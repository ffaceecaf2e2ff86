"""Raster cells of the working store: a file for each ground cell and raster, in its place."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.store.working_store import Store
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tiles import Bounds, shared


def write_cell(
    store: Store, cell: str, core: Bounds, arrays: Mapping[str, NDArray[np.float32]]
) -> list[Path]:
    """Write the rasters of a ground cell, and give their files.

    ``cell``: its name; ``core``: what it owns [quanta]; ``arrays``: mapping of str to (rows,
    columns) float32 of the whole core, row 0 northernmost.
    """
    paths = []
    for name, values in arrays.items():
        paths.append(_path(store, name, cell))
        write_arrays(paths[-1], {"core": np.array(core), "values": values})
    return paths


def stored_blocks(
    store: Store, name: str, cells: Iterable[str], bounds: Bounds
) -> Iterator[tuple[int, int, NDArray[np.float32]]]:
    """Pieces of a stored raster for ``write_cog``, one ground cell at a time.

    Parameters
    ----------
    name : str
        Which of the rasters.
    cells : iterable of str
        Names of ground cells whose rasters are there.
    bounds : Bounds
        Region of whole raster cells [quanta]; cells beyond it are cut.

    Yields
    ------
    row, col, block
        Place in the region, row 0 northernmost, and values.

    Raises
    ------
    DamagedError
        If the file of a cell is missing or damaged.
    """
    for cell in cells:
        held = read_arrays(_path(store, name, cell))
        part = placed(held["values"], Bounds(*held["core"].tolist()), bounds)
        if part[2].size:
            yield part


def placed(
    values: NDArray[np.float32], core: Bounds, bounds: Bounds
) -> tuple[int, int, NDArray[np.float32]]:
    """Part of a cell's raster that lies in a region of whole raster cells, and its place there.

    ``values``: (rows, columns) of the whole core, row 0 northernmost, as in the region [quanta].
    """
    edge, part = (core.xmax - core.xmin) // values.shape[1], shared(core, bounds)
    top, bottom = (core.ymax - part.ymax) // edge, (core.ymax - part.ymin) // edge
    left, right = (part.xmin - core.xmin) // edge, (part.xmax - core.xmin) // edge
    row, column = (bounds.ymax - part.ymax) // edge, (part.xmin - bounds.xmin) // edge
    return row, column, values[top:bottom, left:right]


def _path(store: Store, name: str, cell: str) -> Path:
    return store.path("rasters", name, f"{cell}.npz")
