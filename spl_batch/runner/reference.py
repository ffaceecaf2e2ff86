"""Reference points a square at a time: a file may hold more than memory does."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.accuracy import Reference
from spl_batch.constants import QUANTUM_M
from spl_batch.io.atomic import scratch_folder
from spl_batch.io.las import inspect, iter_points
from spl_batch.model import PointTable
from spl_batch.tiling import Bounds, CellId, cell_bounds, inside, quanta

SQUARE_POINTS: Final = 2_000_000
"""Points that a square holds on average, and of a file that is read whole [count]."""

MARGIN_M: Final = 4.0
"""What stands within 2 m of a point, above ground that is again within 2 m of it [m]."""

MARGIN_CELLS: Final = 2
"""Raster cells whose tops tell whether their neighbour is a roof's edge [count]."""

_RECORD: Final = np.dtype([("x", "<i8"), ("y", "<i8"), ("z", "<i4"), ("class", "u1")])


def read_reference(path: Path, folder: Path, cell_m: float) -> Iterator[Reference]:
    """Points of a reference file in parts that fit into memory.

    A large file is read once and put down by squares of the raster's lattice, each with a
    margin, whose points do not count but tell what stands nearby: what is said of a point
    does not depend on the cutting.

    Parameters
    ----------
    path : Path
        LAS or LAZ.
    folder : Path
        Where squares are put down meanwhile.
    cell_m : float
        Edge of a raster cell [m].

    Raises
    ------
    InputError
        If the file cannot be read to its end.
    """
    facts = inspect(path)
    if facts.n_points <= SQUARE_POINTS:
        records = [_records(t) for t in iter_points(path, channel_dimension=None, source=0)]
        yield _reference(np.concatenate(records) if records else np.empty(0, _RECORD), None)
        return
    width, height = (b - a for a, b in zip(facts.mins_m[:2], facts.maxs_m[:2], strict=True))
    cell = quanta(cell_m)
    margin = max(quanta(MARGIN_M), MARGIN_CELLS * cell)
    wanted = quanta((width * height * SQUARE_POINTS / facts.n_points) ** 0.5)
    edge = max(wanted // cell, 1 + 2 * margin // cell) * cell
    with scratch_folder(folder / "reference") as squares:
        for table in iter_points(path, channel_dimension=None, source=0):
            _put_down(_records(table), squares, edge, margin)
        for square in sorted(squares.iterdir()):
            i, j = map(int, square.name.split("_"))
            core = cell_bounds(CellId(i, j), edge)
            yield _reference(np.fromfile(square, _RECORD), core)


def _records(table: PointTable) -> NDArray[np.void]:
    records = np.empty(len(table), _RECORD)
    for axis in "xyz":
        records[axis] = table[axis]
    records["class"] = table["input_class"]
    return records


def _put_down(records: NDArray[np.void], folder: Path, edge: int, margin: int) -> None:
    """Append points to each square that they lie in or within a margin of."""
    low = [(records[axis] - margin) // edge for axis in "xy"]
    high = [(records[axis] + margin) // edge for axis in "xy"]
    for a in (0, 1):
        for b in (0, 1):
            # the far square, where there is one beside the near one
            mine = np.flatnonzero(((high[0] > low[0]) | (a == 0)) & ((high[1] > low[1]) | (b == 0)))
            i, j = low[0][mine] + a, low[1][mine] + b
            if not len(mine):
                continue
            order = _by_square(i, j)
            mine, i, j = mine[order], i[order], j[order]
            cuts = np.flatnonzero((np.diff(i) != 0) | (np.diff(j) != 0)) + 1
            for rows, at in zip(np.split(mine, cuts), [0, *cuts.tolist()], strict=True):
                with Path(folder, f"{i[at]}_{j[at]}").open("ab") as stream:
                    records[rows].tofile(stream)


def _by_square(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.intp]:
    """Order of points by the column and row of their square, as they came within each."""
    column, row = i - i.min(), j - j.min()
    square = column * (int(row.max()) + 1) + row
    # numpy counts numbers of up to 16 bits where it compares longer ones
    return np.argsort(square.astype(np.min_scalar_type(int(square.max()))), kind="stable")


def _reference(records: NDArray[np.void], core: Bounds | None) -> Reference:
    xyz = np.column_stack([records[axis] * QUANTUM_M for axis in "xyz"])
    counted = None if core is None else inside(records["x"], records["y"], core)
    return Reference(xyz, records["class"].copy(), counted)
