"""Area and density of a survey for the report, from what its ground cells have counted."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from spl_batch.airborne.context import Context
from spl_batch.airborne.products.doubts.terrain_doubts import (
    BLOCKS,
    CLIMBS,
    DAMS,
    DECKS,
    ENDS,
    FAR_M,
    GAPS,
    RAISED,
    UNSURE_M,
    largest,
)
from spl_batch.airborne.products.footprint import SQUARE_M2
from spl_batch.airborne.report.model import (
    CutOffBlock,
    Density,
    RaisedPatch,
    SteepPatch,
    TerrainDoubts,
    TerrainGap,
)
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.tasks.cells.pulses import _CELLS, _HEIGHTS, _SQUARES, _UNSURE, _VOIDS
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import grouped

UNSURE_SHARE: Final = 0.02
"""A larger share of the terrain that is not known well is told."""


LISTED: Final = 20
"""The largest so many are listed one by one [count]."""

VEGETATION_PER_M2: Final = 1.0
"""Below this density shrubs become ground (``benchmarks.airborne.classes.vegetation``) [1/m2]."""


def area_km2(done: Receipts) -> float | None:
    """Area that the returns of all pieces of a survey cover [km2]; None where nobody counted."""
    facts = _facts(done)
    return None if facts is None else sum(f[_SQUARES] for f in facts) * SQUARE_M2 / 1e6


def density(done: Receipts, context: Context, ground: int) -> Density:
    """How densely returns cover all pieces of a survey."""
    facts, area = _facts(done), area_km2(done)
    if facts is None or not area:
        return Density()
    cells: Counter[int] = Counter()
    for found in facts:
        cells.update({int(returns): n for returns, n in found[_CELLS].items()})
    if not cells:
        return Density()
    cell_m2, area_m2 = context.workflow.products.cell_m**2, area * 1e6
    returns = sum(held * n for held, n in cells.items())
    return Density(
        mean_per_m2=returns / area_m2,
        median_per_m2=_quantile(cells, 0.5) / cell_m2,
        p05_per_m2=_quantile(cells, 0.05) / cell_m2,
        # Without signal no ground was looked for.
        ground_per_m2=ground / area_m2 if returns else None,
        void_share=sum(f[_VOIDS] for f in facts) / cells.total(),
        unsure_share=_unsure_share(done),
    )


def unsure_terrain(done: Receipts) -> tuple[str, ...]:
    """A warning where much of the terrain is not known well."""
    share = _unsure_share(done)
    if share is None or share <= UNSURE_SHARE:
        return ()
    text = (
        f"{share:.1%} of the terrain model lies so far from ground returns, for ground as rough as "
        f"it is there, that its standard deviation is more than {UNSURE_M:g} m: dtm_quality.tif "
        "says where; do not measure heights or volumes there"
    )
    return (text,)


def sparse_vegetation(found: Density, asked: ClassSettings) -> tuple[Finding, ...]:
    """Whether classes of low and medium vegetation are asked of too few returns."""
    density_m2 = found.mean_per_m2
    if asked.vegetation is None or density_m2 is None or density_m2 >= VEGETATION_PER_M2:
        return ()
    values = {"per_m2": density_m2, "high_m": asked.vegetation.high}
    return (Finding("G03", values),)


def _unsure_share(done: Receipts) -> float | None:
    """Share of the terrain's cells that are not known well; None where nobody counted."""
    found = [receipt.facts for receipt in done.get("surface", {}).values()]
    if not all(_UNSURE in facts for facts in found):
        return None
    heights = sum(facts[_HEIGHTS] for facts in found)
    return sum(facts[_UNSURE] for facts in found) / heights if heights else None


def _facts(done: Receipts) -> list[Mapping[str, Any]] | None:
    """What ground cells have counted; None where one is of a version that did not, or none is."""
    found = [receipt.facts for receipt in done.get("surface", {}).values()]
    return found if found and all(_SQUARES in facts for facts in found) else None


def _quantile(cells: Mapping[int, int], share: float) -> int:
    """Smallest value that so many cells do not exceed."""
    values = sorted(cells)
    below: Iterable[int] = np.cumsum([cells[value] for value in values])
    wanted = share * sum(cells.values())
    return next(value for value, n in zip(values, below, strict=True) if n >= wanted)


def terrain_doubts(done: Receipts) -> TerrainDoubts:
    """Gaps and raised patches of all pieces of a survey."""
    facts = [receipt.facts for receipt in done.get("surface", {}).values()]
    names = GAPS, RAISED, DECKS, DAMS, ENDS, CLIMBS, BLOCKS
    gaps, raised, decks, dams, ends, climbs, blocks = (largest(facts, name) for name in names)
    return TerrainDoubts(
        gaps=len(gaps),
        gaps_m2=sum(gap[0] for gap in gaps),
        largest_gaps=tuple(
            TerrainGap(area_m2=area, at_m=_metres(at), away_m=away, sd_m=sigma)
            for area, *at, away, sigma in gaps[:LISTED]
        ),
        raised=len(raised),
        raised_m2=sum(patch[0] for patch in raised),
        largest_raised=_raised(raised),
        decks=len(decks),
        decks_m2=sum(strip[0] for strip in decks),
        largest_decks=_raised(decks),
        dams=len(dams),
        dams_m2=sum(dam[0] for dam in dams),
        largest_dams=_raised(dams),
        deck_ends=len(ends),
        deck_ends_m2=sum(end[0] for end in ends),
        largest_deck_ends=_raised(ends),
        steep=len(climbs),
        steep_m2=sum(patch[0] for patch in climbs),
        largest_steep=tuple(
            SteepPatch(area_m2=area, at_m=_metres(at), rise_m=rise)
            for area, *at, rise in climbs[:LISTED]
        ),
        blocks=len(blocks),
        blocks_m2=sum(block[0] for block in blocks),
        largest_blocks=tuple(
            CutOffBlock(area_m2=area, at_m=_metres(at), height_m=height)
            for area, *at, height in blocks[:LISTED]
        ),
    )


def _raised(found: Sequence[Sequence[float]]) -> tuple[RaisedPatch, ...]:
    """The largest of some raised patches or strips."""
    return tuple(
        RaisedPatch(area_m2=area, at_m=_metres(at), height_m=height)
        for area, *at, height in found[:LISTED]
    )


def doubt_warnings(found: TerrainDoubts) -> Iterator[str]:
    """Sentences with number, place and consequence."""
    if found.largest_gaps:
        gap = found.largest_gaps[0]
        yield (
            f"{_counted(found.gaps, 'gap')} in the ground, "
            f"{_area(found.gaps_m2, gap.area_m2, found.gaps, gap.at_m)}: heights are interpolated "
            f"from ground up to {gap.away_m:.0f} m away, more than {FAR_M:g} m, where it is so "
            f"rough that they are known to {gap.sd_m:.1f} m, more than {UNSURE_M:g} m. Do not "
            "measure heights or volumes there"
        )
    if found.largest_raised:
        patch = found.largest_raised[0]
        area = _area(found.raised_m2, patch.area_m2, found.raised, patch.at_m)
        yield (
            f"{_counted(found.raised, 'raised flat patch', 'raised flat patches')} of a building's "
            f"size in the terrain, {area}, "
            f"{patch.height_m:.1f} m above the ground around with walls on most sides: probably a "
            "roof that was taken for ground. Heights of the terrain, and heights above it, are "
            "off by so much there; look at the place"
        )
    if found.largest_decks:
        deck = found.largest_decks[0]
        area = _area(found.decks_m2, deck.area_m2, found.decks, deck.at_m)
        yield (
            f"{_counted(found.decks, 'raised strip')} of the terrain between two walls, {area}, "
            f"{deck.height_m:.1f} m above the level floor on both sides, going on at its own "
            "height to the others: probably a wide bridge that was taken for ground, if it is no "
            "dam, bank or pier. Below a bridge heights of the terrain are off by so much; look at "
            "the place, and classify its deck by hand"
        )
    if found.largest_dams:
        dam = found.largest_dams[0]
        area = _area(found.dams_m2, dam.area_m2, found.dams, dam.at_m)
        yield (
            f"The terrain spans {_counted(found.dams, 'gap')} between ground returns as a dam, "
            f"{area}, up to {dam.height_m:.1f} m above the ground on both sides: what stands there "
            "was cut off, and heights are interpolated. If it is a bridge they are too high by so "
            "much, if it is a dam, a bank or a rock, too low by what is left of it; "
            "dtm_quality.tif has half of that. Do not measure there, and draw the ground by hand "
            "if it matters"
        )
    if found.largest_deck_ends:
        end = found.largest_deck_ends[0]
        area = _area(found.deck_ends_m2, end.area_m2, found.deck_ends, end.at_m)
        yield (
            f"{_counted(found.deck_ends, 'place')} of the terrain where what was cut off goes on "
            f"level from ground, {area}, up to {end.height_m:.1f} m above the ground on both "
            "sides: probably the end of a bridge deck that was taken for ground, and heights are "
            "too high by so much, if it is no crest; dtm_quality.tif has half of that. Look at the "
            "place, and classify the deck by hand"
        )
    if found.largest_steep:
        climb = found.largest_steep[0]
        area = _area(found.steep_m2, climb.area_m2, found.steep, climb.at_m)
        yield (
            f"{_counted(found.steep, 'steep patch', 'steep patches')} of the terrain, over 45 "
            f"degrees, without a ground return, {area}, rising by {climb.rise_m:.0f} m: what lay "
            "there was cut off, as rims, spurs and crests of steep ground are, or something beside "
            "it is no ground, as the end of a bridge deck or noise beyond a swath's edge. Heights "
            "may be off by metres there; look at the place, and classify it by hand if it matters"
        )


def block_warning(found: TerrainDoubts) -> Iterator[str]:
    """Sentence on raised blocks that were cut off and are perhaps hills."""
    if found.largest_blocks:
        block = found.largest_blocks[0]
        area = _area(found.blocks_m2, block.area_m2, found.blocks, block.at_m)
        yield (
            f"{_counted(found.blocks, 'raised block')}, {area}, {block.height_m:.0f} m above the "
            "terrain model, cut off as a building is, though its sides hold returns at all heights "
            "as no wall does, or though it is long and runs on: if it is a mound, a dam, a heap or "
            "a bank between walls, heights of the terrain are off by so much there, and "
            "dtm_quality.tif has half of that; look at the place, and classify it by hand if it is "
            "ground"
        )


def _metres(place: Sequence[float]) -> tuple[float, float]:
    return place[0] * QUANTUM_M, place[1] * QUANTUM_M


def _counted(number: int, one: str, more: str | None = None) -> str:
    return f"{grouped(number)} {one if number == 1 else more or one + 's'}"


def _area(
    total_m2: float | None,
    area_m2: float | None,
    number: int,
    at_m: tuple[float | None, float | None],
) -> str:
    """Area of all and of the largest, and where that lies."""
    said = f"{grouped(round(total_m2 or 0))} m2"
    if number > 1:
        said += f" in all, the largest {grouped(round(area_m2 or 0))} m2"
    east, north = (grouped(place or 0.0) for place in at_m)
    return f"{said} at {east} E, {north} N"
