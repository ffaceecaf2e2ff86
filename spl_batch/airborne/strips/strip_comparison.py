"""How flightlines differ where they overlap: patches of each ground cell, then all pairs.

Where a run aligns its flightlines they are compared twice: as they were recorded, which tells the
shifts, and once more with these.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.store.label_tables import read_region
from spl_batch.airborne.store.line_moves import PLACE, LineMove, LineMoves, read_moves
from spl_batch.airborne.strips.alignment import Alignment, align_lines
from spl_batch.airborne.strips.alignment_sentences import stay_findings
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
from spl_batch.lattice.tiles import Bounds, parse_cell, quanta

MAP_CELLS: Final = 500
"""Cells of the map of differences along its longer side, at most [count]."""

RECORDED: Final = "recorded"
"""Folder below that of the patches: those of flightlines before they are aligned."""

_PASSES: Final = ("psid", "time_s", "kept", "overlaps")


def strip_patches(args: Mapping[str, Any], context: Context) -> Produced:
    """Find what planar patches of a ground cell say of its flightlines."""
    core = Bounds(*args["core"])
    noise = {
        parse_cell(tile): [(kind, name) for kind, name in listed]
        for tile, listed in args["noise"].items()
    }
    tiles = [parse_cell(name) for name in args["tiles"]]
    parts = strips_between(region(core), args.get("cuts", {}).get("patches", ()))
    moves = read_moves(args, context.store)

    def read(part: Bounds) -> PointTable:
        columns = (*COLUMNS_NEEDED, "flags")
        table, _ = read_region(
            context.store, tiles, part, columns, {"noise_class": noise},
            ordered=False, keep=_signal, moves=moves,
        )  # fmt: skip
        return table.select(COLUMNS_NEEDED)

    points = once(parts, read)
    passes = find_passes(map(points, parts), context.workflow.survey.gap_s)
    overlaps: set[tuple[int, int]] = set()
    found = find_patches(map(points, parts), passes, core, overlaps)
    path = _patches(args["folder"], args["cell"], context)
    of_passes = {"psid": passes.psid, "time_s": passes.time_s, "kept": passes.returns}
    of_passes["overlaps"] = np.array(sorted(overlaps), np.int64).reshape(-1, 2)
    write_arrays(path, {**found, **of_passes})
    facts = {"patches": len(found["rise"]), "left_out": passes.left_out}
    return Produced([path], facts)


def _patches(folder: str, cell: str, context: Context) -> Path:
    """File of the patches of a ground cell."""
    return context.store.path(*filter(None, ("strips", folder, f"{cell}.npz")))


def _signal(table: PointTable) -> NDArray[np.bool_]:
    """Which points are compared."""
    found: NDArray[np.bool_] = (table["noise_class"] == NOISE_SIGNAL) & ~table.has(EXCLUDED)
    return found


def strip_pairs(args: Mapping[str, Any], context: Context) -> Produced:
    """Put the patches of all cells together, pair by pair; a map of their differences."""
    strips = [Strip(*strip) for strip in args["strips"]]
    cells = partial(_cells, args["cells"], strips, context)
    pairs = pair_table((names, patches) for names, _, patches in cells())
    path = context.store.path("strips", "map.npz")
    found = [*cells()]
    write_arrays(path, _map([patches for *_, patches in found]))
    flown = [(names, passes) for names, passes, _ in found]
    known = {(pair.first, pair.second) for pair in pairs}
    facts = {
        "pairs": [list(pair) for pair in pairs],
        "returns": _returns(flown),
        "not_compared": sorted(_overlaps(flown) - known),
    }
    return Produced([path], facts)


def align(args: Mapping[str, Any], context: Context) -> Produced:
    """Find by how much each flightline is shifted, and leave it for all who read its points."""
    how = context.workflow.survey.align
    strips = [Strip(*strip) for strip in args["strips"]]
    cells = partial(_cells, args["cells"], strips, context, RECORDED)
    pairs = pair_table((names, patches) for names, _, patches in cells())
    psid_of = {strip.name: strip.psid for strip in strips}
    flown = [(names, passes) for names, passes, _ in cells()]
    for names, passes in flown:
        psid_of |= dict(zip(names, passes["psid"].tolist(), strict=True))
    found = align_lines([*psid_of], pairs, _returns(flown), rigid=how == "rigid")
    spans = {strip.name: (strip.first_s, strip.last_s) for strip in strips}
    moves = [
        LineMove(
            one.name,
            psid_of[one.name],
            *spans.get(one.name, (-np.inf, np.inf)),
            (quanta(one.east_m), quanta(one.north_m), quanta(one.up_m)),
        )
        for one in found
    ]
    path = context.store.path(*PLACE)
    write_arrays(path, LineMoves(moves).to_arrays())
    facts = {
        "name": f"survey.align: {how}",
        "pairs": [list(pair) for pair in pairs],
        "lines": [list(one) for one in found],
        "findings": [*stay_findings(found)],
    }
    return Produced([path], facts)


def alignments_of(facts: Mapping[str, Any]) -> list[Alignment]:
    """What :func:`align` has found, by its receipt."""
    return [Alignment(*line) for line in facts["lines"]]


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


def _returns(flown: Iterable[tuple[list[str], dict[str, NDArray[Any]]]]) -> dict[str, int]:
    """Signal returns of each flightline, by the names and passes of all cells [count]."""
    kept: Counter[str] = Counter()
    for names, passes in flown:
        for name, count in zip(names, passes["kept"].tolist(), strict=True):
            kept[name] += count
    return dict(kept)


def _overlaps(flown: Iterable[tuple[list[str], dict[str, NDArray[Any]]]]) -> set[tuple[str, str]]:
    """Pairs of flightlines that overlap in a cell, the lesser name first; none with itself."""
    pairs = (
        tuple(sorted((names[one], names[other])))
        for names, passes in flown
        for one, other in passes["overlaps"].tolist()
    )
    return {(first, second) for first, second in pairs if first != second}


def _cells(
    names: Sequence[str], strips: Sequence[Strip], context: Context, folder: str = ""
) -> Iterator[tuple[list[str], dict[str, NDArray[Any]], Patches]]:
    """Names of the passes of each ground cell, what is known of them, and its patches."""
    for name in names:
        arrays = read_arrays(_patches(folder, name, context))
        passes = {key: arrays.pop(key) for key in _PASSES}
        yield named_passes(passes["psid"], passes["time_s"], strips), passes, arrays


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
