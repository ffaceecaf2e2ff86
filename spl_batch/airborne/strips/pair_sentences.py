"""What a run says of flightlines that do not fit together."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from spl_batch.airborne.strips.pair_table import TILT_PER_M, PairDifference
from spl_batch.airborne.strips.strip_patches import MOST_PASSES
from spl_batch.errors import counted, grouped

TOLD: Final = 3
"""Pairs that get a sentence of their own, the worst first [count]."""


REMEDIES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "none": "adjust the strips and run again: strip_shifts in report.json says by how much; or "
        "let survey.align: rigid shift them",
        "vertical": "survey.align: rigid shifts places as well",
        "rigid": "one shift for each flightline does not mend it: look for rotations, drifts or "
        "another datum",
    }
)
"""What helps against differences, by what ``survey.align`` is."""


def offset_warnings(pairs: Sequence[PairDifference], align: str = "none") -> Iterator[str]:
    """Sentences on pairs whose flightlines differ by more than a single range does.

    ``align``: how flightlines were shifted before they were compared.
    """
    off = [(away, pair) for pair in pairs if (away := _away(pair)) > 0]
    off.sort(key=lambda found: (-found[0], found[1].first, found[1].second))
    for _, pair in off[:TOLD]:
        yield (
            f"{pair.second} lies {' and '.join(_parts(pair))} of {pair.first}, around "
            f"{grouped(pair.x_m)} E, {grouped(pair.y_m)} N ({grouped(pair.patches)} planar "
            f"patches), more than the ranging noise of {100 * pair.noise_m:.1f} cm: surfaces that "
            f"both have seen are double, and rasters lie between them{_tilt(pair)}; "
            f"{REMEDIES[align]}"
        )
    if len(off) > TOLD:
        yield (
            f"{counted(len(off) - TOLD, 'more pairs')} of flightlines: off by more than their "
            "ranging noise; report.json lists all under strips"
        )


def left_out_warnings(left_out: Mapping[str, int]) -> Iterator[str]:
    """A sentence where a ground cell holds more passes than are compared.

    ``left_out``: passes that are not compared, of each ground cell [count].
    """
    cells = {cell: count for cell, count in left_out.items() if count}
    if cells:
        worst = max(sorted(cells), key=lambda cell: cells[cell])
        yield (
            f"in {counted(len(cells), 'ground cells')} more than {MOST_PASSES} passes overlap, "
            f"{grouped(cells[worst] + MOST_PASSES)} in {worst}: those with most returns are "
            "compared, the others are not; survey.gap_s may be shorter than pauses within a "
            "flightline, or gps_time jumps"
        )


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
        f". The height between them is not the same everywhere: it changes by {100 * rise:.1f} cm "
        f"on {TILT_PER_M:.0f} m and by {100 * change:.1f} cm over these patches, as where a "
        f"flightline is turned by {angle:.3f} degrees; a shift takes away only what is the "
        "same everywhere"
    )


def _parts(pair: PairDifference) -> Iterator[str]:
    if pair.is_off_vertically or (pair.is_tilted and not pair.is_off_horizontally):
        yield f"{100 * abs(pair.up_m):.1f} cm {'above' if pair.up_m > 0 else 'below'}"
    if pair.is_off_horizontally and pair.east_m is not None and pair.north_m is not None:
        yield (
            f"{100 * abs(pair.east_m):.0f} cm {'east' if pair.east_m > 0 else 'west'} and "
            f"{100 * abs(pair.north_m):.0f} cm {'north' if pair.north_m > 0 else 'south'}"
        )
