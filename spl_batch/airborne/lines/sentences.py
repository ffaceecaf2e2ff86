"""Sentences on flightlines that do not fit together, and on shifts that are added."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from spl_batch.airborne.lines.alignment import ALONE, MOST_M, TOO_FAR, LineShift
from spl_batch.airborne.lines.pair_table import PairDifference
from spl_batch.airborne.lines.patches import MOST_LINES
from spl_batch.engine.findings import Finding
from spl_batch.errors import grouped

NEXT_TO: Final = 0.1
"""Part of the larger of two horizontal differences below which the smaller is not told."""


def offset_warnings(pairs: Sequence[PairDifference], align: str = "none") -> Iterator[Finding]:
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
        "offset": " and ".join(_parts(pair)),
        "up_m": pair.up_m,
        "noise_m": pair.noise_m,
        "remedy": _remedy(pair, align),
    }
    yield Finding("S01", values, place=(pair.x_m, pair.y_m, pair.x_m, pair.y_m))


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


def _away(pair: PairDifference) -> float:
    """How far a pair is off, in parts of its ranging noise; 0 where it is not."""
    vertical = abs(pair.up_m) if pair.is_off_vertically else 0.0
    horizontal = 0.0
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        horizontal = float(np.hypot(pair.east_m, pair.north_m))
    return max(vertical, horizontal) / max(pair.noise_m, 1e-3)


def _remedy(pair: PairDifference, align: str) -> str:
    """What helps against a difference."""
    if align == "none" and pair.is_off_vertically and not pair.is_off_horizontally:
        return "set survey.align: vertical"
    above = "survey.align: vertical shifts heights alone; " if align == "none" else ""
    return (
        f"{above}adjust the flightlines with other software and run again; look for a wrong "
        "mounting angle, a drift or another datum"
    )


def _parts(pair: PairDifference) -> Iterator[str]:
    if pair.is_off_vertically:
        yield f"{100 * abs(pair.up_m):.1f} cm {'higher' if pair.up_m > 0 else 'lower'}"
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        ways = ((pair.east_m, "east", "west"), (pair.north_m, "north", "south"))
        least = NEXT_TO * max(abs(pair.east_m), abs(pair.north_m))
        for way_m, ahead, back in ways:
            if abs(way_m) >= least:
                yield f"{100 * abs(way_m):.0f} cm farther {ahead if way_m > 0 else back}"


def stay_findings(lines: Sequence[LineShift]) -> Iterator[Finding]:
    """Flightlines that stay where they should perhaps not."""
    alone = [one.name for one in lines if one.stays == ALONE]
    if alone:
        yield Finding("S02", {"kind": "alone", "count": len(alone), "names": alone})
    for one in lines:
        if one.stays == TOO_FAR:
            yield Finding("S02", {"kind": "far", "up_m": one.found_m, "most_m": MOST_M}, one.name)


def done_sentence(lines: Sequence[LineShift]) -> str:
    """What a run has added to the heights of flightlines."""
    shifted = [one for one in lines if not one.stays]
    if not shifted:
        return (
            "no flightline is shifted (survey.align: vertical): each shift that was found is "
            "within its own error"
        )
    noun = "flightlines was" if len(shifted) == 1 else "flightlines were"
    return (
        f"{grouped(len(shifted))} of {grouped(len(lines))} {noun} shifted by up to "
        f"{100 * max(abs(one.up_m) for one in shifted):.1f} cm in height (survey.align: vertical)"
    )
