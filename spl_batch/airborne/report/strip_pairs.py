"""Flightlines that overlap, as a report shows them."""

from typing import Literal

from pydantic import Field

from spl_batch.airborne.context import Context
from spl_batch.airborne.lines.comparison import difference_map, pairs_of, shifts_of
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.parts import Count, Number, Part
from spl_batch.engine.report.run_record import Receipts


class StripPair(Part):
    """Where a flightline lies against another that overlaps it, from planar patches of both."""

    first: str = Field(description="The flightline that is compared with.")
    second: str = Field(description="The one that is compared.")
    patches: Count = Field(description="Planar patches that both have [count].")
    area_m2: Number = Field(description="Area of these patches [m2].")
    centre_m: tuple[Number, Number] = Field(description="Easting and northing of their middle [m].")
    up_m: Number = Field(description="The second above the first [m].")
    up_sd_m: Number = Field(description="Standard deviation of it [m].")
    east_m: Number = Field(None, description="The second east of the first; null if flat [m].")
    north_m: Number = Field(None, description="The second north of the first; null if flat [m].")
    horizontal_sd_m: Number = Field(
        None, description="Standard deviation of these, in the worst direction [m]."
    )
    flat_patches: Count = Field(0, description="Smooth patches of up to 10 degrees [count].")
    rmsd_z_m: Number = Field(
        None, description="Root mean square of the vertical differences of these [m]."
    )
    noise_m: Number = Field(description="Ranging noise: spread about the smoothest patches [m].")
    largest_m: Number = Field(
        None, description="Largest vertical difference of a smooth patch of up to 10 degrees [m]."
    )
    largest_sd_m: Number = Field(None, description="Standard deviation of it [m].")
    largest_at_m: tuple[Number, Number] | None = Field(
        None, description="Easting and northing of that patch [m]."
    )
    tilt_east_m: Number = Field(
        None, description="Change of up_m on 100 m to the east; null where no tilt is sure [m]."
    )
    tilt_north_m: Number = Field(None, description="The same to the north [m].")
    tilt_sd_m: Number = Field(
        None, description="Standard deviation of these, in the worst direction [m]."
    )
    change_m: Number = Field(None, description="Change of up_m over all patches by that tilt [m].")


class AlignedLine(Part):
    """What was added to the heights of a flightline, and how sure it is."""

    name: str = Field(description="The flightline.")
    up_m: Number = Field(description="Added to its heights [m].")
    found_m: Number = Field(description="The shift as found; null without a pair [m].")
    sd_m: Number = Field(None, description="Standard deviation of it [m].")
    stays: Literal["", "kept", "not compared", "not sure", "too far"] = Field(
        description="Why nothing was added: the others are shifted against it; too few planar "
        "patches with others; less than two standard deviations; more than 2 m. Empty where "
        "something was."
    )


class Alignment(Part):
    """Shifts in height that bring flightlines together, applied to all that was delivered."""

    lines: tuple[AlignedLine, ...] = Field(
        description="All flightlines; of those that overlap one is kept as it is: the one to which "
        "the others, weighted by their returns, come by the shortest way."
    )
    before: tuple[StripPair, ...] = Field(
        description="Pairs of flightlines as they were recorded; strips has what is left."
    )


def strip_pairs(done: Receipts, key: str = "pairs") -> tuple[StripPair, ...]:
    """Pairs of flightlines as they are delivered; with ``before`` as they were recorded."""
    rows = (pair for r in done.get("strip_pairs", {}).values() for pair in pairs_of(r.facts, key))
    return tuple(
        StripPair(
            **{k: v for k, v in pair._asdict().items() if k in StripPair.model_fields},
            centre_m=(pair.x_m, pair.y_m),
            largest_at_m=None if pair.largest_m is None else (pair.largest_x_m, pair.largest_y_m),
        )
        for pair in rows
    )


def pairs_not_compared(done: Receipts) -> tuple[tuple[str, str], ...]:
    """Flightlines that overlap without planar patches enough to be compared."""
    receipts = done.get("strip_pairs", {}).values()
    return tuple((one, other) for r in receipts for one, other in r.facts.get("not_compared", ()))


def alignment(done: Receipts) -> Alignment | None:
    """Shifts that were applied; None where none were asked for."""
    for receipt in done.get("strip_pairs", {}).values():
        if "shifts" in receipt.facts:
            lines = tuple(AlignedLine(**one._asdict()) for one in shifts_of(receipt.facts))
            return Alignment(lines=lines, before=strip_pairs(done, "before"))
    return None


def strip_map(done: Receipts, context: Context) -> Raster | None:
    """Height between flightlines by place; None where no two share planar patches [m]."""
    if not done.get("strip_pairs"):
        return None
    found = difference_map(context)
    if found is None:
        return None
    values, (west, east, south, north) = found
    raster = Raster(values, (west, east, south, north))
    return raster if raster.any_value else None
