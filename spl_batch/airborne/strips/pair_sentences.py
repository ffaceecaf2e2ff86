"""What a run says of flightlines that do not fit together."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from spl_batch.airborne.strips.pair_table import TILT_PER_M, PairDifference
from spl_batch.airborne.strips.strip_patches import MOST_PASSES
from spl_batch.engine.findings import Finding

NEXT_TO: Final = 0.1
"""Part of the larger of two horizontal differences below which the smaller is not told."""

REMEDIES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "none": "adjust the strips by strip_shifts of report.json and run again, or set "
        "survey.align: rigid",
        "vertical": "survey.align: rigid shifts places as well",
        "rigid": "no shift of whole flightlines mends it: look for a wrong mounting angle, a "
        "drift or another datum",
    }
)
"""What helps against differences, by what ``survey.align`` is."""


def offset_warnings(
    pairs: Sequence[PairDifference], align: str = "none", apart: int = 0
) -> Iterator[Finding]:
    """Pairs whose flightlines differ by more than a single range does.

    ``align``: how flightlines were shifted before they were compared. ``apart``: returns of the
    ground of flightlines that lie apart from the terrain [count]. The worst pair is told, as
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
        "offset": " and ".join(_parts(pair)) + _tilt(pair),
        "up_m": pair.up_m,
        "noise_m": pair.noise_m,
        "apart": apart,
        "remedy": REMEDIES[align],
    }
    yield Finding("S01", values, place=(pair.x_m, pair.y_m, pair.x_m, pair.y_m))


def left_out_warnings(left_out: Mapping[str, int]) -> Iterator[Finding]:
    """Where a ground cell holds more passes than are compared.

    ``left_out``: passes that are not compared, of each ground cell [count].
    """
    cells = {cell: count for cell, count in left_out.items() if count}
    if cells:
        worst = max(sorted(cells), key=lambda cell: cells[cell])
        values = {
            "kind": "passes", "cells": len(cells), "most": MOST_PASSES,
            "worst": cells[worst] + MOST_PASSES, "cell": worst,
        }  # fmt: skip
        yield Finding("S02", values)


def _away(pair: PairDifference) -> float:
    """How far a pair is off, in parts of its ranging noise; 0 where it is not."""
    vertical = abs(pair.up_m) if pair.is_off_vertically else 0.0
    if pair.is_tilted and pair.change_m is not None:
        vertical = max(vertical, pair.change_m / 2)
    horizontal = 0.0
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        horizontal = float(np.hypot(pair.east_m, pair.north_m))
    return max(vertical, horizontal) / max(pair.noise_m, 1e-3)


def _tilt(pair: PairDifference) -> str:
    """What a tilt means; nothing without one."""
    east, north, change = pair.tilt_east_m, pair.tilt_north_m, pair.change_m
    if east is None or north is None or change is None:
        return ""
    rise = float(np.hypot(east, north))
    angle = np.degrees(np.arctan(rise / TILT_PER_M))
    return (
        f", and {100 * rise:.1f} cm more or less {TILT_PER_M:.0f} m from there, as if turned by "
        f"{angle:.3f} degrees, which no shift mends"
    )


def _parts(pair: PairDifference) -> Iterator[str]:
    if pair.is_off_vertically or (pair.is_tilted and not pair.is_off_horizontally):
        yield f"{100 * abs(pair.up_m):.1f} cm {'higher' if pair.up_m > 0 else 'lower'}"
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        ways = ((pair.east_m, "east", "west"), (pair.north_m, "north", "south"))
        least = NEXT_TO * max(abs(pair.east_m), abs(pair.north_m))
        for way_m, ahead, back in ways:
            if abs(way_m) >= least:
                yield f"{100 * abs(way_m):.0f} cm farther {ahead if way_m > 0 else back}"
