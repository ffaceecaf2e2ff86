"""Labels that a work unit gives to points of several tiles: Parquet, a row group a tile.

A label names its point by tile and row in the tile's file, so units that are cut
otherwise than the tiles (ground cells, blocks) need no join to find their points.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.io.store import Store
from spl_batch.io.tables import group_ranges, read_columns, read_table, writing
from spl_batch.model import COLUMNS, PointTable, concat
from spl_batch.tiling import Bounds, CellId, inside

DEFAULTS: dict[str, float] = {
    "noise_class": 255,
    "p_value": float("nan"),
    "noise_density": float("nan"),
    "wire": 0,
    "ground": 0,
    "classification": 255,
}
"""Label of a point that no unit has labelled."""


def write_labels(
    path: Path,
    tiles: NDArray[np.int32],
    rows: NDArray[np.uint32],
    labels: Mapping[str, NDArray[Any]],
) -> None:
    """Write labels atomically, sorted by tile and row.

    Parameters
    ----------
    path : Path
        Final name.
    tiles : (n, 2) int32
        Column and row of each point's tile.
    rows : (n,) uint32
        Row in the tile's file.
    labels : mapping of str to (n,) ndarray
        Values by column name.
    """
    order = np.lexsort((rows, tiles[:, 0], tiles[:, 1]))
    tiles, rows = tiles[order], rows[order]
    columns = {"tile_i": tiles[:, 0], "tile_j": tiles[:, 1], "row": rows}
    columns |= {k: np.asarray(v, COLUMNS[k].dtype)[order] for k, v in labels.items()}
    cuts = np.flatnonzero(np.any(np.diff(tiles, axis=0) != 0, axis=1)) + 1
    with writing(path, {k: v.dtype for k, v in columns.items()}) as writer:
        for start, end in zip([0, *cuts], [*cuts, len(rows)], strict=True):
            writer.write({k: v[start:end] for k, v in columns.items()})


def read_labels(path: Path, tile: CellId, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Labels of one tile's points.

    Parameters
    ----------
    path : Path
        File written by :func:`write_labels`.
    tile : CellId
        The tile.
    names : sequence of str
        Labels to read.

    Returns
    -------
    dict of str to (m,) ndarray
        The labels, and ``row``: which rows of the tile they belong to.
    """
    i, j = group_ranges(path, "tile_i"), group_ranges(path, "tile_j")
    groups = [g for g in range(len(i)) if i[g] == (tile.i, tile.i) and j[g] == (tile.j, tile.j)]
    return read_columns(path, ["row", *names], groups)


def read_labelled_tile(
    store: Store,
    tile: CellId,
    columns: Sequence[str],
    labels: Mapping[str, Sequence[tuple[str, str]]],
) -> PointTable:
    """One tile's points with the labels that some units gave them.

    Parameters
    ----------
    store : Store
        The working store.
    tile : CellId
        The tile.
    columns : sequence of str
        Point columns to read.
    labels : mapping of str to sequence of (str, str)
        Label -> kind and name of the units that may hold it for this tile.
    """
    table = read_table(store.tile(str(tile)), columns)
    filled = {
        name: np.full(len(table), DEFAULTS[name], dtype=COLUMNS[name].dtype) for name in labels
    }
    wanted: dict[tuple[str, str], list[str]] = {}
    for name, units in labels.items():
        for unit in units:
            wanted.setdefault(unit, []).append(name)
    for (kind, name_of_unit), names in wanted.items():
        part = read_labels(store.labels(kind, name_of_unit), tile, names)
        for name in names:
            filled[name][part["row"]] = part[name]
    return table.with_columns(**filled)


def read_region(
    store: Store,
    tiles: Sequence[CellId],
    bounds: Bounds,
    columns: Sequence[str],
    labels: Mapping[str, Mapping[CellId, Sequence[tuple[str, str]]]],
) -> tuple[PointTable, NDArray[np.int32], NDArray[np.uint32]]:
    """Points of a region in canonical order, with labels.

    Parameters
    ----------
    store : Store
        The working store.
    tiles : sequence of CellId
        Tiles that overlap the region and hold points.
    bounds : Bounds
        The region.
    columns : sequence of str
        Point columns to read, x and y among them.
    labels : mapping
        Label -> tile -> units that may hold it.

    Returns
    -------
    table : PointTable
        The points.
    tile : (n, 2) int32
        Tile of each point.
    row : (n,) uint32
        Row of each point in its tile's file.
    """
    names = [*columns, *labels]
    tables, owners, rows = [], [], []
    for tile in tiles:
        of_tile = {name: units.get(tile, ()) for name, units in labels.items()}
        table = read_labelled_tile(store, tile, columns, of_tile)
        chosen = np.flatnonzero(inside(table["x"], table["y"], bounds))
        tables.append(table if len(chosen) == len(table) else table.take(chosen))
        owners.append(np.tile(np.array(tile, dtype=np.int32), (len(chosen), 1)))
        rows.append(chosen.astype(np.uint32))
    table = concat(tables, names)
    if not len(table):
        return table, np.empty((0, 2), np.int32), np.empty(0, np.uint32)
    order = _merged(table)
    return table.take(order), np.concatenate(owners)[order], np.concatenate(rows)[order]


def _merged(table: PointTable) -> NDArray[np.intp]:
    """Canonical order of tiles one below the other: (n,) intp.

    Each tile is in that order already, and points that share x and y share the tile: merging
    by x and y alone leaves the rest as it is.
    """
    x, y = table["x"].astype(np.int64), table["y"].astype(np.int64)
    x -= x.min()
    x *= int(y.max() - y.min()) + 1
    return np.argsort(x + (y - y.min()), kind="stable")
