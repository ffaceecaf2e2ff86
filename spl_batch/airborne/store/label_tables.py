"""Points of tiles with the labels that work units give them: Parquet, row groups by tile.

A label names its point by tile and row in the tile's file, so units that are cut
otherwise than the tiles (ground cells) need no join to find their points.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.store.flown_lines import Shifts, read_shifts
from spl_batch.engine.report.run_record import Receipts
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.task import Need
from spl_batch.formats.verified.parquet_npz import GroupIndex, groups_between, writing
from spl_batch.lattice.row_order import in_order, lexicographic_order
from spl_batch.lattice.tables import COLUMNS, PointTable, rows_of
from spl_batch.lattice.tiles import Bounds, CellId, inside, overlap, parse_cell


class Label(NamedTuple):
    """A column that units give to points; the others lie in the tiles."""

    step: str  #: Whose tasks are the units that give it.
    default: float  #: Of a point that no unit has labelled.


LABELS: Final[Mapping[str, Label]] = {
    "noise_class": Label("denoise", 255),
    "p_value": Label("denoise", float("nan")),
    "noise_density": Label("denoise", float("nan")),
    "wire": Label("denoise", 0),
    "ground": Label("ground", 0),
    "classification": Label("surface", 255),
    "set_flags": Label("surface", 0),
}
"""All of them."""

GROUP_ROWS: Final = 65_536
"""Most rows of a row group [count]: a halo is read from few."""

Unit = Need
"""Task that has labelled some points."""

SHIFTED: Final[Need] = ("align", "all")
"""Task that finds by how much heights are shifted."""


Keep = Callable[[PointTable], NDArray[np.bool_]]
"""Which points are wanted, each by itself."""


class Origin(NamedTuple):
    """Where on disk the n points of a region lie."""

    tiles: NDArray[np.int32]  #: (t, 2): column and row of each tile.
    #: (n,) uint16 or uint32: which of them holds each point.
    owner: NDArray[np.unsignedinteger[Any]]
    row: NDArray[np.uint32]  #: (n,): row of each point in its tile's file.

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Origin":
        """Where some of them lie, given as (n,) bool or by their numbers."""
        return Origin(self.tiles, self.owner[chosen], self.row[chosen])


def write_labels(path: Path, origin: Origin, labels: Mapping[str, NDArray[Any]]) -> None:
    """Write labels atomically, sorted by tile and row; no more than a tile's are held again.

    Parameters
    ----------
    path : Path
        Final name.
    origin : Origin
        Where the n points lie, in any order.
    labels : mapping of str to (n,) ndarray
        Their labels by column name.
    """
    dtypes: dict[str, Any] = {"tile_i": np.int32, "tile_j": np.int32, "row": np.uint32}
    dtypes |= {name: COLUMNS[name].dtype for name in labels}
    tiles = {CellId(*tile) for tile in origin.tiles.tolist()}
    with writing(path, dtypes, sought=("tile_i", "tile_j", "row"), rows=GROUP_ROWS) as writer:
        for tile in sorted(tiles, key=lambda tile: (tile.j, tile.i)):
            found = _of_tile(tile, origin, labels)
            if len(found["row"]):
                writer.write({name: np.asarray(found[name], dtypes[name]) for name in dtypes})


def _of_tile(
    tile: CellId, origin: Origin, labels: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Labels of the points of a tile, by row."""
    number = np.flatnonzero((origin.tiles == tile).all(axis=1))
    mine = np.flatnonzero((origin.owner == number[:, None]).any(axis=0))
    columns = {"row": origin.row[mine], **{k: v[mine] for k, v in labels.items()}}
    rows = columns["row"]
    if len(rows) and not in_order([rows]):
        order = lexicographic_order([rows])
        columns = {name: values[order] for name, values in columns.items()}
    place = np.broadcast_to(np.array(tile, np.int32)[:, None], (2, len(rows)))
    return {"tile_i": place[0], "tile_j": place[1], **columns}


Files = Callable[[Unit], GroupIndex]
"""Files of :func:`write_labels` by unit, each of whose footers is read once."""


def label_files(store: Store) -> Files:
    """Files of labels of a store."""
    return cache(lambda unit: GroupIndex(store.table(*unit)))


def _labels_of(
    files: Files,
    tile: CellId,
    rows: NDArray[np.int64],
    labels: Mapping[str, Sequence[Unit]],
) -> dict[str, NDArray[Any]]:
    """Labels of some rows of a tile, which increase."""
    filled = {
        name: np.full(len(rows), LABELS[name].default, COLUMNS[name].dtype) for name in labels
    }
    wanted: dict[Unit, list[str]] = {}
    if not len(rows):
        return filled
    for name, units in labels.items():
        for unit in units:
            wanted.setdefault(unit, []).append(name)
    span = {"tile_i": (tile.i, tile.i), "tile_j": (tile.j, tile.j), "row": (rows[0], rows[-1])}
    for unit, names in wanted.items():
        groups = files(unit).between(span)
        if not groups.wanted:
            continue
        part, _ = groups.read(["row", *names])
        mine, at = _met(rows, part["row"])
        for name in names:
            filled[name][mine] = part[name].take(at)
    return filled


def _met(
    rows: NDArray[np.int64], held: NDArray[np.int64]
) -> tuple[slice | NDArray[np.intp], NDArray[np.intp]]:
    """Which of some rows are held, and where among those that are; both increase."""
    if len(held) and held[-1] - held[0] + 1 == len(held):  # no row is left out
        mine = slice(*np.searchsorted(rows, (held[0], held[-1] + 1)).tolist())
        return mine, rows[mine] - int(held[0])
    at = np.searchsorted(held, rows)
    found = np.flatnonzero(held.take(at, mode="clip") == rows) if len(held) else at[:0]
    return found, at[found]


def read_region(
    store: Store,
    tiles: Sequence[CellId],
    bounds: Bounds | None,
    columns: Sequence[str],
    labels: Mapping[str, Sequence[Unit]],
    *,
    ordered: bool = True,
    keep: Keep | None = None,
    shifts: Shifts | None = None,
    files: Files | None = None,
) -> tuple[PointTable, Origin]:
    """Points of a region with labels, in canonical order or as they lie.

    Parameters
    ----------
    tiles : sequence of CellId
        Tiles that overlap the region and hold points.
    bounds : Bounds or None
        The region [quanta]; None takes the tiles as a whole.
    columns : sequence of str
        Point columns to read; of a region ``x`` and ``y`` at least.
    labels : mapping of str to sequence of (str, str)
        Label -> units that may hold it.
    ordered : bool
        Whether to put points in canonical order; else they come tile by tile, in the order in
        which :func:`write_labels` wants them, and each tile's are in canonical order.
    keep : callable, optional
        Tells of each point by itself whether it is wanted; others are never held together.
    shifts : Shifts, optional
        Shifts of flightlines that are added to the heights.
    files : Files, optional
        From :func:`label_files`, where more is read.

    Returns
    -------
    table : PointTable
        The points.
    origin : Origin
        Where they lie.
    """
    names = [*columns, *labels]
    held = sorted(tiles) if ordered else sorted(tiles, key=lambda tile: (tile.j, tile.i))
    # Which shift is a point's follows from its flightline.
    read = columns if shifts is None else list(dict.fromkeys((*columns, "line")))
    span = {} if bounds is None else {"x": (bounds.xmin, bounds.xmax - 1)}
    # A region is the largest thing that a worker holds. It is read into its place: many small
    # parts would leave gaps in a worker's memory in which nothing else fits. What of the room
    # is not needed is never touched.
    parts = [groups_between(store.table("tiles", str(tile)), span) for tile in held]
    room = sum(part.rows for part in parts)
    joined = {name: np.empty(room, COLUMNS[name].dtype) for name in names}
    joined["row"] = np.empty(room, np.uint32)
    joined["owner"] = np.empty(room, np.min_scalar_type(len(held)))
    end = 0
    files = files or label_files(store)
    for k, tile in enumerate(held):
        values, row = parts[k].read(read)
        if shifts is not None:
            values = shifts.shifted(values)
        chosen = slice(None) if bounds is None else _within(values["x"], values["y"], bounds)
        row = row[chosen]
        found = _labels_of(files, tile, row, labels)
        values = {name: values[name][chosen] for name in columns}
        wanted = slice(None) if keep is None else rows_of(keep(PointTable({**values, **found})))
        row = row[wanted]
        start, end = end, end + len(row)
        joined["row"][start:end], joined["owner"][start:end] = row, k
        for part in (values, found):
            for name in list(part):
                joined[name][start:end] = part.pop(name)[wanted]
    joined = {name: values[:end] for name, values in joined.items()}
    if ordered:
        # Tiles are in canonical order, and points of different ones differ in x or, where their
        # tiles stand in one column, in y: a stable sort by x puts all in canonical order.
        order = lexicographic_order([joined["x"]])
        for name in joined:  # a column at a time
            joined[name] = joined[name][order]
    cells = np.array(held, dtype=np.int32).reshape(-1, 2)
    origin = Origin(cells, joined.pop("owner"), joined.pop("row"))
    return PointTable(joined), origin


def _within(x: NDArray[np.int64], y: NDArray[np.int64], bounds: Bounds) -> NDArray[np.intp] | slice:
    """Rows of a tile, whose x increases, within bounds; a slice where they adjoin."""
    first, end = np.searchsorted(x, (bounds.xmin, bounds.xmax)).tolist()
    rows = rows_of((y[first:end] >= bounds.ymin) & (y[first:end] < bounds.ymax))
    if isinstance(rows, slice):
        return slice(first + rows.start, first + rows.stop)
    found: NDArray[np.intp] = rows + first
    return found


def labelled(args: Mapping[str, Any], found: Collection[Need]) -> dict[str, Any]:
    """Arguments of a task with the units that labelled points, and whether heights are shifted.

    Points of a task that has failed have no labels; the rest goes on.
    """
    steps = sorted({label.step for label in LABELS.values()})
    labels = {step: sorted(name for made_by, name in found if made_by == step) for step in steps}
    return {**args, "labels": labels, "aligned": SHIFTED in found}


def on_ground(args: Mapping[str, Any], found: Collection[Need]) -> dict[str, Any] | None:
    """Those of a cell likewise; None, which leaves it out, without its ground."""
    return labelled(args, found) if ("ground", args["cell"]) in found else None


def units_of(args: Mapping[str, Any], names: Iterable[str]) -> dict[str, list[Unit]]:
    """Units that may give a task's points some labels, by label; of :func:`labelled` arguments."""
    steps = {name: LABELS[name].step for name in names}
    return {name: [(step, unit) for unit in args["labels"][step]] for name, step in steps.items()}


def units_within(region: Bounds, names: Iterable[str], done: Receipts) -> dict[str, list[Unit]]:
    """Finished units that may give points of a region some labels, by label."""
    steps = {name: LABELS[name].step for name in names}
    return {
        name: [
            (step, unit)
            for unit, receipt in done.get(step, {}).items()
            if overlap(Bounds(*receipt.facts["core"]), region)
        ]
        for name, step in steps.items()
    }


class Cell(NamedTuple):
    """A square of the absolute grid that a task owns, and its points."""

    args: Mapping[str, Any]
    context: Context
    core: Bounds
    shifts: Shifts | None  #: Shifts of its flightlines.
    held: tuple[PointTable, Origin] | None = None  #: Points at hand, and where they lie.

    @classmethod
    def of(cls, args: Mapping[str, Any], context: Context) -> "Cell":
        """The cell of a task."""
        return cls(args, context, Bounds(*args["core"]), read_shifts(args, context.store))

    def holding(self, region: Bounds, columns: Sequence[str]) -> "Cell":
        """The cell with some columns of a region at hand: nothing else is read from files."""
        return self._replace(held=self.read(region, tuple(dict.fromkeys(columns))))

    def read(
        self,
        region: Bounds,
        columns: Sequence[str],
        keep: Keep | None = None,
        *,
        ordered: bool = False,
    ) -> tuple[PointTable, Origin]:
        """Points of a region [quanta], and where they lie; tile by tile unless ``ordered``."""
        if self.held is not None:
            return _chosen(*self.held, region, columns, keep)
        labels = units_of(self.args, [k for k in columns if k in LABELS])
        return read_region(
            self.context.store, list(map(parse_cell, self.args["tiles"])), region,
            [k for k in columns if k not in labels], labels, ordered=ordered, keep=keep,
            shifts=self.shifts,
        )  # fmt: skip


def _chosen(
    table: PointTable, origin: Origin, region: Bounds, columns: Sequence[str], keep: Keep | None
) -> tuple[PointTable, Origin]:
    """What is asked for of points at hand; a view where it is all of them."""
    some = table.select(columns)
    wanted = inside(table["x"], table["y"], region)
    if keep is not None:
        wanted &= keep(some)
    return (some, origin) if wanted.all() else (some.take(wanted), origin.of(wanted))
