"""Points as the time domain reads them: each input file in time order, then stretch by stretch.

Decoding LAZ costs several times what reading Parquet does. So the index, which decodes a file
to prove that it can be, keeps what it finds, and a stretch is read from there as often as it is
needed, with the columns that are.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.formats.verified.parquet_npz import GroupWriter, groups_between
from spl_batch.lattice.row_order import in_order, lexicographic_order
from spl_batch.lattice.tables import (
    EXCLUDED,
    SOURCE_COLUMNS,
    PointTable,
    ShotClock,
    concat,
    rows_of,
)

TIME_ORDER: Final = (
    "gps_time",
    "channel",
    "return_number",
    "x",
    "y",
    "z",
    "source",
    "index",
)
"""Sort keys of a stretch, first one first."""

KEPT_COLUMNS: Final = tuple(name for name in SOURCE_COLUMNS if name != "source")
"""Columns of an input in time order; the file's name has the source."""

GROUP_POINTS: Final = 16_384
"""Points of a row group [count]: of a chunk of an input a stretch reads two in vain at most, a halo
is read from few of a tile, and small tiles share one."""


def add_points(writer: GroupWriter, table: PointTable) -> None:
    """Keep a chunk of an input file in time order, but for what no computation looks at.

    Row groups are short, and their footers have their times; points without any come last.
    """
    table = _in_time_order(table.take(rows_of(~table.has(EXCLUDED))))
    for start in range(0, len(table), GROUP_POINTS):
        writer.write(table.take(slice(start, start + GROUP_POINTS)).columns)


class Copies(NamedTuple):
    """Returns that a file holds although it, or another one, holds them already: k copies."""

    row: NDArray[np.intp]  #: (k,): which of the returns that count they are copies of.
    source: NDArray[np.uint64]  #: (k,): key of the file of each.
    number: NDArray[np.uint32]  #: (k,): its number in the file.

    def of(self, table: PointTable) -> PointTable:
        """Copies with all that the returns that count have, but for their own file and number."""
        return table.take(self.row).with_columns(source=self.source, index=self.number)


def read_stretch(
    args: Mapping[str, Any], context: Context, names: Sequence[str]
) -> tuple[PointTable, Copies]:
    """Points of a stretch from every file that has some, in time order, and the copies left out.

    A return that is there several times, as where a file is delivered twice, tiles overlap or a
    file holds its points twice, comes once, from the file that is named first and the first place
    in it: copies would vouch for each other.

    ``args``: ``sources``, the names of files or of their parts, soundest first, ``psid``, ``t0_s``,
    ``prf_hz``, ``shots``, ``window_s`` and ``span_s``; ``names``: columns that are wanted, those of
    the order and ``shot`` come too.
    """
    clock = ShotClock(args["t0_s"], args["prf_hz"])
    columns = list(dict.fromkeys((*TIME_ORDER, *names)))
    read = (*columns, "point_source_id")
    pieces = [
        _of_stretch(read_kept(name, context, read, args["window_s"]), args, clock)
        for name in args["sources"]
    ]
    ranked = list(dict.fromkeys(int(name.partition("-")[0]) for name in args["sources"]))
    table, copies = _once(_in_time_order(concat(pieces, [*columns, "shot"])), ranked)
    # Kernels are compiled for arrays that can be written to, and what was read cannot.
    writable = {k: np.require(v, None, ["C", "W"]) for k, v in table.columns.items()}
    return PointTable(writable), copies


def _once(table: PointTable, ranked: Sequence[int]) -> tuple[PointTable, Copies]:
    """Points in time order without those that are there already, and these.

    ``ranked``: keys of the files; of equal returns that of the first one counts.
    """
    again = repeats(table, TIME_ORDER[: TIME_ORDER.index("source")])
    if again.any():
        rank = np.empty(len(table), np.int64)
        for place, key in enumerate(ranked):
            rank[table["source"] == key] = place
        # The order within each file stays.
        table = table.take(np.lexsort([rank, np.cumsum(~again)]))
    return without_copies(table, again)


def repeats(table: PointTable, names: Sequence[str]) -> NDArray[np.bool_]:
    """Which rows have the values of the one before them, no time being one: (n,) bool."""
    again = np.ones(len(table), np.bool_)
    again[:1] = False
    for name in names:
        if not again.any():
            break
        now, before = table[name][1:], table[name][:-1]
        again[1:] &= (now == before) | (np.isnan(now) & np.isnan(before))
    return again


def without_copies(table: PointTable, again: NDArray[np.bool_]) -> tuple[PointTable, Copies]:
    """Rows that count, and copies of them, which follow them: ``again``, (n,) bool."""
    row = (np.cumsum(~again) - 1)[again]
    copies = Copies(row, table["source"][again], table["index"][again])
    return table.take(~again) if len(row) else table, copies


def read_kept(
    kept: str,
    context: Context,
    names: Sequence[str],
    window_s: tuple[float, float] | None = None,
) -> PointTable:
    """Columns of what is kept of a file, or of a part of one.

    All of it, or the row groups that can hold points of a time span.
    """
    path = context.store.path("points", f"{kept}.parquet")
    groups = groups_between(path, {} if window_s is None else {"gps_time": window_s})
    columns, _ = groups.read([name for name in names if name != "source"])
    table, source = PointTable(columns), np.uint64(int(kept.partition("-")[0]))
    return table.with_columns(source=np.full(len(table), source))


def _of_stretch(table: PointTable, args: Mapping[str, Any], clock: ShotClock) -> PointTable:
    """Rows of the stretch, with their shot numbers."""
    first, last = args["span_s"]
    time = table["gps_time"]
    mine = (time >= first) & (time <= last) & (table["point_source_id"] == args["psid"])
    table = table.take(rows_of(mine))
    table = table.with_columns(shot=clock.shot(table["gps_time"]))
    low, high = args["shots"]
    return table.take(rows_of((table["shot"] >= low) & (table["shot"] < high)))


def _in_time_order(table: PointTable) -> PointTable:
    keys = [table[k] for k in TIME_ORDER]
    return table if in_order(keys) else table.take(lexicographic_order(keys))
