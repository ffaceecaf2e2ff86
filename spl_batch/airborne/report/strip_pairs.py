"""What a report says of flightlines that overlap."""

from spl_batch.airborne.context import Context
from spl_batch.airborne.strips.line_shifts import line_shifts
from spl_batch.airborne.strips.pair_table import PairDifference
from spl_batch.airborne.strips.strip_comparison import alignments_of, difference_map, pairs_of
from spl_batch.airborne.strips.strip_report import AlignedLine, Alignment, LineShift, StripPair
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.run_record import Receipts


def strip_pairs(done: Receipts) -> tuple[StripPair, ...]:
    """Pairs of flightlines as they are delivered, as the report has them."""
    receipts = done.get("strip_pairs", {}).values()
    return tuple(_pair(pair) for receipt in receipts for pair in pairs_of(receipt.facts))


def _pair(pair: PairDifference) -> StripPair:
    return StripPair(
        first=pair.first,
        second=pair.second,
        patches=pair.patches,
        area_m2=pair.area_m2,
        centre_m=(pair.x_m, pair.y_m),
        up_m=pair.up_m,
        up_sd_m=pair.up_sd_m,
        east_m=pair.east_m,
        north_m=pair.north_m,
        horizontal_sd_m=pair.horizontal_sd_m,
        flat_patches=pair.flat_patches,
        rmsd_z_m=pair.rmsd_z_m,
        noise_m=pair.noise_m,
        largest_m=pair.largest_m,
        largest_sd_m=pair.largest_sd_m,
        tilt_east_m=pair.tilt_east_m,
        tilt_north_m=pair.tilt_north_m,
        tilt_sd_m=pair.tilt_sd_m,
        change_m=pair.change_m,
        largest_at_m=None if pair.largest_m is None else (pair.largest_x_m, pair.largest_y_m),
    )


def pairs_not_compared(done: Receipts) -> tuple[tuple[str, str], ...]:
    """Flightlines that overlap without planar patches enough to be compared."""
    receipts = done.get("strip_pairs", {}).values()
    return tuple((one, other) for r in receipts for one, other in r.facts.get("not_compared", ()))


def alignment(done: Receipts, context: Context) -> Alignment | None:
    """Shifts that were applied, as the report has them; None where none were asked for."""
    how = context.workflow.survey.align
    for receipt in done.get("align", {}).values():
        if how != "none":
            return Alignment(
                align=how,
                lines=tuple(AlignedLine(**one._asdict()) for one in alignments_of(receipt.facts)),
                before=tuple(map(_pair, pairs_of(receipt.facts))),
            )
    return None


def strip_shifts(done: Receipts) -> tuple[LineShift, ...]:
    """What would bring flightlines together, as the report has it."""
    return tuple(
        LineShift(**shift._asdict())
        for receipt in done.get("strip_pairs", {}).values()
        for shift in line_shifts(pairs_of(receipt.facts), receipt.facts.get("returns", {}))
    )


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
