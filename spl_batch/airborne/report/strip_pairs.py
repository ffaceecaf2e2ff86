"""Flightlines that overlap, as a report shows them."""

from spl_batch.airborne.context import Context
from spl_batch.airborne.lines.comparison import difference_map, pairs_of, shifts_of
from spl_batch.airborne.report.model import AlignedLine, StripPair
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.run_record import Receipts


def strip_pairs(done: Receipts) -> tuple[StripPair, ...]:
    """Pairs of flightlines as they are delivered."""
    rows = (pair for r in done.get("strip_pairs", {}).values() for pair in pairs_of(r.facts))
    return tuple(
        StripPair(
            **{k: v for k, v in pair._asdict().items() if k in StripPair.model_fields},
            centre_m=(pair.x_m, pair.y_m),
        )
        for pair in rows
    )


def pairs_not_compared(done: Receipts) -> tuple[tuple[str, str], ...]:
    """Flightlines that overlap without planar patches enough to be compared."""
    receipts = done.get("strip_pairs", {}).values()
    return tuple((one, other) for r in receipts for one, other in r.facts.get("not_compared", ()))


def alignment(done: Receipts) -> tuple[AlignedLine, ...]:
    """Shifts that were applied."""
    return tuple(
        AlignedLine(**one._asdict())
        for receipt in done.get("align", {}).values()
        for one in shifts_of(receipt.facts)
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
