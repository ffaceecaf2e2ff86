"""How flightlines differ where they overlap: patches of each ground cell, then all pairs."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.store.label_tables import read_region
from spl_batch.airborne.strips.pair_table import (
    PairDifference,
    Strip,
    named_passes,
    pair_table,
)
from spl_batch.airborne.strips.strip_patches import (
    COLUMNS_NEEDED,
    EDGE_M,
    Patches,
    find_passes,
    find_patches,
    region,
)
from spl_batch.constants import NODATA, NOISE_SIGNAL
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.eastings import once, strips_between
from spl_batch.lattice.tables import EXCLUDED, PointTable
from spl_batch.lattice.tiles import Bounds, parse_cell

MAP_CELLS: Final = 500
"""Cells of the map of differences along its longer side, at most [count]."""

_PASSES: Final = ("psid", "time_s")


def strip_patches(args: Mapping[str, Any], context: Context) -> Produced:
    """Find what planar patches of a ground cell say of its flightlines."""
    core = Bounds(*args["core"])
    noise = {
        parse_cell(tile): [(kind, name) for kind, name in listed]
        for tile, listed in args["noise"].items()
    }
    tiles = [parse_cell(name) for name in args["tiles"]]
    parts = strips_between(region(core), args.get("cuts", {}).get("patches", ()))

    def read(part: Bounds) -> PointTable:
        columns = (*COLUMNS_NEEDED, "flags")
        table, _ = read_region(
            context.store, tiles, part, columns, {"noise_class": noise}, ordered=False, keep=_signal
        )
        return table.select(COLUMNS_NEEDED)

    points = once(parts, read)
    passes = find_passes(map(points, parts), context.workflow.survey.gap_s)
    found = find_patches(map(points, parts), passes, core)
    path = context.store.path("strips", f"{args['cell']}.npz")
    write_arrays(path, {**found, "psid": passes.psid, "time_s": passes.time_s})
    facts = {"patches": len(found["rise"]), "left_out": passes.left_out}
    return Produced([path], facts)


def _signal(table: PointTable) -> NDArray[np.bool_]:
    """Which points are compared."""
    found: NDArray[np.bool_] = (table["noise_class"] == NOISE_SIGNAL) & ~table.has(EXCLUDED)
    return found


def strip_pairs(args: Mapping[str, Any], context: Context) -> Produced:
    """Put the patches of all cells together, pair by pair; a map of their differences."""
    strips = [Strip(*strip) for strip in args["strips"]]
    pairs = pair_table(_cells(args["cells"], strips, context))
    path = context.store.path("strips", "map.npz")
    places = [patches for _, patches in _cells(args["cells"], strips, context)]
    write_arrays(path, _map(places))
    return Produced([path], {"pairs": [list(pair) for pair in pairs]})


def difference_map(context: Context) -> tuple[NDArray[np.float32], tuple[float, ...]] | None:
    """Map of :func:`strip_pairs` and where it lies, west to north; None where there is none.

    Raises
    ------
    DamagedError
        If the file is damaged: who writes a report has it made again.
    """
    arrays = read_arrays(context.store.path("strips", "map.npz"))
    if not arrays["values"].size:
        return None
    return arrays["values"], tuple(map(float, arrays["extent_m"]))


def pairs_of(facts: Mapping[str, Any]) -> list[PairDifference]:
    """Pairs as the receipt of :func:`strip_pairs` has them; none of one that told other things."""
    told = len(PairDifference._fields)
    return [PairDifference(*pair) for pair in facts.get("pairs", ()) if len(pair) == told]


def _cells(
    names: Sequence[str], strips: Sequence[Strip], context: Context
) -> Iterator[tuple[list[str], Patches]]:
    """Names of the passes of each ground cell, and its patches."""
    for name in names:
        arrays = read_arrays(context.store.path("strips", f"{name}.npz"))
        psid, time_s = (arrays.pop(key) for key in _PASSES)
        yield named_passes(psid, time_s, strips), arrays


def _map(cells: Sequence[Patches]) -> dict[str, NDArray[Any]]:
    """Median height between flightlines by place, whichever lies above, north-up [m]."""
    sample = [{k: cell[k][cell["beyond"] == 0] for k in ("x", "y", "rise")} for cell in cells]
    columns = [np.concatenate([cell[k] for cell in sample] or [np.empty(0)]) for k in ("x", "y")]
    rise = np.abs(np.concatenate([cell["rise"] for cell in sample] or [np.empty(0)]))
    if not len(rise):
        return {"values": np.empty((0, 0), np.float32), "extent_m": np.zeros(4)}
    east, north = columns
    edge = 2 * EDGE_M
    while max(np.ptp(east), np.ptp(north)) / edge > MAP_CELLS:
        edge *= 2
    i, j = (np.floor(along / edge).astype(np.int64) for along in (east, north))
    west, south = int(i.min()), int(j.min())
    shape = int(np.ptp(j)) + 1, int(np.ptp(i)) + 1
    cell = (j - south) * shape[1] + i - west
    order = np.lexsort((rise, cell))
    cell, rise = cell[order], rise[order]
    first = np.flatnonzero(np.diff(cell, prepend=-1))
    count = np.diff(first, append=len(cell))
    values = np.full(shape[0] * shape[1], NODATA, np.float32)
    values[cell[first]] = rise[first + count // 2]
    extent = np.array([west, west + shape[1], south, south + shape[0]]) * edge
    return {"values": np.ascontiguousarray(values.reshape(shape)[::-1]), "extent_m": extent}
