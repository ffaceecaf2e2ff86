"""Tasks that compare flightlines where they overlap: patches of each ground cell, then all pairs.

A shift in height changes the height between two flightlines and nothing else of a patch, so what
an alignment leaves follows from the same patches.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.context import Context
from spl_batch.airborne.lines.alignment import ALONE, MOST_M, TOO_FAR, AlignedLine, align_lines
from spl_batch.airborne.lines.pair_table import StripPair, pair_table
from spl_batch.airborne.lines.patches import (
    COLUMNS_NEEDED,
    EDGE_M,
    MIN_RETURNS_PER_PATCH,
    Patches,
    find_patches,
    region,
)
from spl_batch.airborne.store.flown_lines import LINES, SHIFTS, Pass, Shifts, read_shifts
from spl_batch.airborne.store.label_tables import Cell
from spl_batch.constants import NODATA, NOISE_SIGNAL, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.number_format import as_ascii, height
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import grouped
from spl_batch.formats.rasters.parts import RasterPart
from spl_batch.formats.units import Units
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta

MAP_CELLS = 500
"""Cells of the map of differences along its longer side, at most [count]."""


def strip_patches(args: Mapping[str, Any], context: Context) -> Produced:
    """Find planar patches of a ground cell that flightlines share."""
    cell = Cell.of(args, context)
    table, _ = cell.read(region(cell.core), (*COLUMNS_NEEDED, "noise_class"), _signal)
    found, overlaps = find_patches(table, cell.core)
    returns = np.bincount(table["line"])
    seen = np.flatnonzero(returns >= MIN_RETURNS_PER_PATCH)
    of_lines = {"lines": seen, "line_returns": returns[seen], "overlaps": overlaps}
    path = context.store.path("overlaps", f"{args['cell']}.npz")
    write_arrays(path, {**found, **of_lines})
    return Produced([path], {"patches": len(found["rise"])})


def _signal(table: PointTable) -> NDArray[np.bool_]:
    """Which points are compared: withheld ones and a vendor's noise are not assessed."""
    found: NDArray[np.bool_] = table["noise_class"] == NOISE_SIGNAL
    return found


def align(args: Mapping[str, Any], context: Context) -> Produced:
    """Find by how much each flightline is shifted, and leave it for all who read its points."""
    found = _read_cells(args, context)
    weights = {name: found.returns[number] for number, name in found.names.items()}
    shifts = align_lines([*weights], pair_table(found.patches, found.names), weights)
    up_q = np.array([quanta(one.up_m) for one in shifts], np.int32)
    path = context.store.path(*SHIFTS)
    write_arrays(path, Shifts(found.passes, up_q).to_arrays())
    facts = {"shifts": [asdict(one) for one in shifts], "findings": [*stay_findings(shifts)]}
    return Produced([path], {"name": "survey.align", **facts})


def strip_pairs(args: Mapping[str, Any], context: Context) -> Produced:
    """Put the patches of all cells together, pair by pair; a map of their differences."""
    found = _read_cells(args, context)
    patches, names = found.patches, found.names
    shifts = read_shifts(args, context.store)
    if shifts is not None:
        up_q = shifts.of(patches["second"]) - shifts.of(patches["first"])
        patches["rise"] += up_q * QUANTUM_M
    pairs = pair_table(patches, names)
    path = context.store.path("overlaps", "map.npz")
    write_arrays(path, _map(patches))
    overlaps = {tuple(sorted(names[k] for k in two)) for two in found.overlaps.tolist()}
    lacking = sorted(overlaps - {(one.first, one.second) for one in pairs})
    facts = {
        "name": "",  # what is found concerns the survey
        "pairs": [asdict(pair) for pair in pairs],
        "not_compared": lacking,
        "findings": [*offset_warnings(pairs, "vertical" if args["aligned"] else "none")],
    }
    return Produced([path], facts)


class _Cells(NamedTuple):
    """What :func:`strip_patches` has left of all ground cells."""

    passes: list[Pass]  #: Flightlines, by name.
    returns: NDArray[np.float64]  #: (LINES,): signal returns of each, by its number [count].
    overlaps: NDArray[np.int64]  #: (m, 2): numbers of those that overlap in a cell.
    patches: Patches

    @property
    def names(self) -> dict[int, str]:
        """Names of flightlines, by number."""
        return {one.number: one.name for one in self.passes}


def _read_cells(args: Mapping[str, Any], context: Context) -> _Cells:
    cells = [read_arrays(context.store.path("overlaps", f"{name}.npz")) for name in args["cells"]]
    whole = {key: np.concatenate([cell[key] for cell in cells]) for key in cells[0]}
    lines, returns, overlaps = (whole.pop(key) for key in ("lines", "line_returns", "overlaps"))
    # Points without times have no flightline but that of their id.
    flown = {k: Pass(k, f"{k:05d}", k, -np.inf, np.inf) for k in lines.tolist()}
    flown |= {one.number: one for one in (Pass(*fields) for fields in args["lines"])}
    passes = sorted(flown.values(), key=lambda one: one.name)
    total = np.bincount(lines, returns, minlength=LINES).astype(np.float64)
    return _Cells(passes, total, overlaps, whole)


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


def _map(patches: Patches) -> dict[str, NDArray[Any]]:
    """Median height between flightlines by place, whichever lies above, north-up [m]."""
    east, north, rise = patches["x"], patches["y"], patches["rise"]
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
    off = [pair for pair in pairs if _away(pair) > 0]
    if not off:
        return
    pair = max(off, key=_away)  # of equals the first by name
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


def _away(pair: StripPair) -> float:
    """How far a pair is off, in parts of its ranging noise; 0 where it is not."""
    vertical = abs(pair.up_m) * pair.is_off_vertically
    horizontal = pair.horizontal_m * pair.is_off_horizontally
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
    if pair.is_off_horizontally:
        ways = ((pair.east_m or 0.0, "east", "west"), (pair.north_m or 0.0, "north", "south"))
        for way_m, there, opposite in ways:
            yield abs(way_m), f"farther {there if way_m > 0 else opposite}"


def stay_findings(lines: Sequence[AlignedLine]) -> Iterator[Finding]:
    """Flightlines that stay where they should perhaps not."""
    alone = [one.name for one in lines if one.stays == ALONE]
    if alone:
        yield Finding("S02", {"kind": "alone", "count": len(alone), "names": alone})
    for one in lines:
        if one.stays == TOO_FAR:
            yield Finding("S02", {"kind": "far", "up_m": one.found_m, "most_m": MOST_M}, one.name)


def done_sentence(lines: Sequence[AlignedLine], units: Units) -> str:
    """What a run has added to the heights of flightlines, one at least; ``units``: of delivery."""
    shifted = [one for one in lines if not one.stays]
    noun = "flightlines was" if len(shifted) == 1 else "flightlines were"
    most = as_ascii(height(max(abs(one.up_m) for one in shifted), units.of_heights))
    return (
        f"{grouped(len(shifted))} of {grouped(len(lines))} {noun} shifted by up to {most} "
        "in height (survey.align: vertical)"
    )
