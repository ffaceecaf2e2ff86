"""Tasks that compare flightlines where they overlap: patches of each ground cell, then all pairs.

A shift in height changes the height between two flightlines and nothing else of a patch, so what
an alignment leaves follows from the same patches.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.context import Context
from spl_batch.airborne.lines.alignment import ALONE, MOST_M, TOO_FAR, AlignedLine, align_lines
from spl_batch.airborne.lines.pair_table import StripPair, pair_table
from spl_batch.airborne.lines.patches import (
    COLUMNS_NEEDED,
    EDGE_M,
    MOST_LINES,
    Patches,
    find_patches,
    region,
    seen_lines,
)
from spl_batch.airborne.store.cells import Cell
from spl_batch.airborne.store.flown_lines import SHIFTS, Pass, Shifts, read_shifts
from spl_batch.constants import NODATA, NOISE_SIGNAL, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.number_format import as_ascii, height
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import grouped
from spl_batch.formats.rasters.parts import RasterPart
from spl_batch.formats.units import Units
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tables import EXCLUDED, PointTable
from spl_batch.lattice.tiles import quanta

MAP_CELLS = 500
"""Cells of the map of differences along its longer side, at most [count]."""


NEXT_TO: Final = 0.1
"""Part of the larger of two horizontal differences below which the smaller is not told."""


class _Cell(NamedTuple):
    """A ground cell."""

    names: list[str]  #: Flightlines that are compared.
    returns: list[int]  #: Signal returns of each [count].
    overlaps: list[list[int]]  #: Pairs that overlap, by their places in ``names``.
    patches: Patches


def strip_patches(args: Mapping[str, Any], context: Context) -> Produced:
    """Find planar patches of a ground cell that flightlines share."""
    cell = Cell.of(args, context)
    table, _ = cell.read(region(cell.core), (*COLUMNS_NEEDED, "noise_class", "flags"), _signal)
    names = {one.number: one.name for one in (Pass(*fields) for fields in args["lines"])}
    seen = seen_lines(table["line"])
    found, overlaps = find_patches(table, seen, cell.core)
    of_lines = {
        # points without times have no flightline but that of their id
        "names": np.array([names.get(k, f"{k:05d}") for k in seen.numbers.tolist()], np.str_),
        "line_returns": seen.returns,
        "overlaps": np.array(sorted(overlaps), np.int64).reshape(-1, 2),
    }
    path = context.store.path("overlaps", f"{args['cell']}.npz")
    write_arrays(path, {**found, **of_lines})
    return Produced([path], {"patches": len(found["rise"]), "left_out": seen.left_out})


def _signal(table: PointTable) -> NDArray[np.bool_]:
    """Which points are compared."""
    found: NDArray[np.bool_] = (table["noise_class"] == NOISE_SIGNAL) & ~table.has(EXCLUDED)
    return found


def align(args: Mapping[str, Any], context: Context) -> Produced:
    """Find by how much each flightline is shifted, and leave it for all who read its points."""
    flown = {one.name: one for one in (Pass(*fields) for fields in args["lines"])}
    cells = [_read_cell(name, context) for name in args["cells"]]
    for name in {name for cell in cells for name in cell.names} - flown.keys():
        flown[name] = Pass(int(name), name, int(name), -np.inf, np.inf)  # without times
    pairs = pair_table((cell.names, cell.patches) for cell in cells)
    shifts = align_lines([*flown], pairs, _returns(cells))
    up_q = np.array([quanta(one.up_m) for one in shifts], np.int32)
    path = context.store.path(*SHIFTS)
    write_arrays(path, Shifts([flown[one.name] for one in shifts], up_q).to_arrays())
    facts = {
        "name": "survey.align",
        "shifts": [asdict(one) for one in shifts],
        "findings": [*stay_findings(shifts)],
    }
    return Produced([path], facts)


def strip_pairs(args: Mapping[str, Any], context: Context) -> Produced:
    """Put the patches of all cells together, pair by pair; a map of their differences."""
    cells = [_read_cell(name, context) for name in args["cells"]]
    lines = read_shifts(args, context.store)
    if lines is not None:
        cells = [_shifted(cell, lines) for cell in cells]
    pairs = pair_table((cell.names, cell.patches) for cell in cells)
    path = context.store.path("overlaps", "map.npz")
    write_arrays(path, _map([cell.patches for cell in cells]))
    known = {(one.first, one.second) for one in pairs}
    lacking = sorted(_overlaps(cells) - known)
    return Produced([path], {"pairs": [asdict(pair) for pair in pairs], "not_compared": lacking})


def _read_cell(name: str, context: Context) -> _Cell:
    """What :func:`strip_patches` has left of a ground cell."""
    arrays = read_arrays(context.store.path("overlaps", f"{name}.npz"))
    names, returns, overlaps = (
        arrays.pop(key).tolist() for key in ("names", "line_returns", "overlaps")
    )
    return _Cell(names, returns, overlaps, arrays)


def _shifted(cell: _Cell, lines: Shifts) -> _Cell:
    """A ground cell whose flightlines have got their shifts."""
    up = np.array([lines.of_name(name) for name in cell.names]) * QUANTUM_M
    patches = cell.patches
    rise = patches["rise"] + up[patches["second"]] - up[patches["first"]]
    return cell._replace(patches={**patches, "rise": rise})


def shifts_of(receipts: Iterable[Receipt]) -> tuple[AlignedLine, ...]:
    """Shifts that :func:`align` has found."""
    return tuple(AlignedLine(**line) for r in receipts for line in r.facts["shifts"])


def pairs_of(receipts: Iterable[Receipt]) -> tuple[StripPair, ...]:
    """Pairs of flightlines as they are delivered, by :func:`strip_pairs`."""
    return tuple(StripPair(**pair) for r in receipts for pair in r.facts["pairs"])


def difference_map(context: Context) -> RasterPart | None:
    """Map of :func:`strip_pairs` [m]; None where no two flightlines share planar patches.

    Raises DamagedError if the file is damaged: who writes a report has it made again.
    """
    arrays = read_arrays(context.store.path("overlaps", "map.npz"))
    if not arrays["values"].size:
        return None
    return RasterPart(arrays["values"], *arrays["place_m"].tolist())


def _returns(cells: Iterable[_Cell]) -> Counter[str]:
    """Signal returns of each flightline [count]."""
    found: Counter[str] = Counter()
    for cell in cells:
        found.update(dict(zip(cell.names, cell.returns, strict=True)))
    return found


def _overlaps(cells: Iterable[_Cell]) -> set[tuple[str, str]]:
    """Pairs of flightlines that overlap in a cell, the lesser name first."""
    pairs = [(cell.names[one], cell.names[other]) for cell in cells for one, other in cell.overlaps]
    return {(min(pair), max(pair)) for pair in pairs}


def _map(cells: Sequence[Patches]) -> dict[str, NDArray[Any]]:
    """Median height between flightlines by place, whichever lies above, north-up [m]."""
    east, north, rise = (
        np.concatenate([cell[k] for cell in cells] or [np.empty(0)]) for k in ("x", "y", "rise")
    )
    if not len(rise):
        return {"values": np.empty((0, 0), np.float32), "place_m": np.zeros(3)}
    edge = 2 * EDGE_M
    while max(np.ptp(east), np.ptp(north)) / edge > MAP_CELLS:
        edge *= 2
    i, j = (np.floor(along / edge).astype(np.int64) for along in (east, north))
    west, south = int(i.min()), int(j.min())
    shape = int(np.ptp(j)) + 1, int(np.ptp(i)) + 1
    cell = (j - south) * shape[1] + i - west
    values, filled = np.full(shape[0] * shape[1], NODATA, np.float32), np.unique(cell)
    values[filled] = ndimage.median(np.abs(rise), cell, filled)
    place = np.array([west, south + shape[0], 1]) * edge
    return {"values": np.ascontiguousarray(values.reshape(shape)[::-1]), "place_m": place}


def offset_warnings(pairs: Sequence[StripPair], align: str = "none") -> Iterator[Finding]:
    """Pairs whose flightlines differ by more than a single range does.

    ``align``: how flightlines were shifted before they were compared. It names the worst pair, as
    one flightline that lies off is off from all others; the report has all pairs.
    """
    off = [(away, pair) for pair in pairs if (away := _away(pair)) > 0]
    if not off:
        return
    _, pair = min(off, key=lambda found: (-found[0], found[1].first, found[1].second))
    values = {
        "pairs": len(off),
        "of": len(pairs),
        "first": pair.first,
        "second": pair.second,
        "patches": pair.patches,
        "offset_m": list(_parts(pair)),
        "up_m": pair.up_m,
        "noise_m": pair.noise_m,
        "remedy": _remedy(pair, align),
    }
    yield Finding("S01", values, place=(*pair.centre_m, *pair.centre_m))


def left_out_warnings(left_out: Mapping[str, int]) -> Iterator[Finding]:
    """Where a ground cell holds more flightlines than are compared.

    ``left_out``: flightlines that are not compared, of each ground cell [count].
    """
    cells = {cell: count for cell, count in left_out.items() if count}
    if cells:
        worst = max(sorted(cells), key=lambda cell: cells[cell])
        values = {
            "kind": "passes", "cells": len(cells), "most": MOST_LINES,
            "worst": cells[worst] + MOST_LINES, "cell": worst,
        }  # fmt: skip
        yield Finding("S02", values)


def _away(pair: StripPair) -> float:
    """How far a pair is off, in parts of its ranging noise; 0 where it is not."""
    vertical = abs(pair.up_m) if pair.is_off_vertically else 0.0
    horizontal = 0.0
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        horizontal = float(np.hypot(pair.east_m, pair.north_m))
    return max(vertical, horizontal) / max(pair.noise_m, 1e-3)


def _remedy(pair: StripPair, align: str) -> str:
    """What helps against a difference."""
    if align == "none" and pair.is_off_vertically and not pair.is_off_horizontally:
        return "set survey.align: vertical"
    above = "survey.align: vertical shifts heights alone; " if align == "none" else ""
    return (
        f"{above}adjust the flightlines with other software and run again; look for a wrong "
        "mounting angle, a drift or another datum"
    )


def _parts(pair: StripPair) -> Iterator[tuple[float, str]]:
    """Differences that count [m], and which way each is."""
    if pair.is_off_vertically:
        yield abs(pair.up_m), "higher" if pair.up_m > 0 else "lower"
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        ways = ((pair.east_m, "east", "west"), (pair.north_m, "north", "south"))
        least = NEXT_TO * max(abs(pair.east_m), abs(pair.north_m))
        for way_m, ahead, back in ways:
            if abs(way_m) >= least:
                yield abs(way_m), f"farther {ahead if way_m > 0 else back}"


def stay_findings(lines: Sequence[AlignedLine]) -> Iterator[Finding]:
    """Flightlines that stay where they should perhaps not."""
    alone = [one.name for one in lines if one.stays == ALONE]
    if alone:
        yield Finding("S02", {"kind": "alone", "count": len(alone), "names": alone})
    for one in lines:
        if one.stays == TOO_FAR:
            yield Finding("S02", {"kind": "far", "up_m": one.found_m, "most_m": MOST_M}, one.name)


def done_sentence(lines: Sequence[AlignedLine], units: Units) -> str:
    """What a run has added to the heights of flightlines; ``units``: of delivery."""
    shifted = [one for one in lines if not one.stays]
    if not shifted:
        return (
            "no flightline is shifted (survey.align: vertical): each shift that was found is "
            "within its own error"
        )
    noun = "flightlines was" if len(shifted) == 1 else "flightlines were"
    most = as_ascii(height(max(abs(one.up_m) for one in shifted), units.of_heights))
    return (
        f"{grouped(len(shifted))} of {grouped(len(lines))} {noun} shifted by up to {most} "
        "in height (survey.align: vertical)"
    )
