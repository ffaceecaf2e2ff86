"""Parts of a survey that lie far apart, as a report shows them: each where it is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from spl_batch.airborne.context import Context
from spl_batch.airborne.products.product_table import PRODUCTS
from spl_batch.airborne.report.model import Piece as PieceReport
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.run_record import Receipts
from spl_batch.formats.rasters.parts import overview_frame

Box = tuple[float, float, float, float]
"""West, south, east and north edges [m]."""

GAP_M: Final = 1000.0
"""What lies farther apart than this, in easting or northing, may be pieces of their own [m]."""

FULL_SHARE: Final = 0.2
"""Pieces of one raster that fill more of their common rectangle are shown on one map."""

PICTURED: Final = 5
"""Pieces that the report has pictures of, the largest first [count]."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One part of a survey.

    Parameters
    ----------
    bounds_m : Box
        Where it lies.
    suffix : str
        What the names of its rasters end in: nothing, ``_2`` and so on.
    rasters : tuple of str
        Their names.
    """

    bounds_m: Box
    suffix: str
    rasters: tuple[str, ...]


def find_pieces(done: Receipts, context: Context) -> list[Piece]:
    """Pieces of a survey, largest raster first and largest piece of each first.

    Parameters
    ----------
    done : mapping of str to mapping of str to Receipt
        Finished tasks by kind and name.
    context : Context
        The run.

    Returns
    -------
    list of Piece
        One where all lies together; none where there is no raster.
    """
    made = done.get("mosaic", {})
    cells = [_metres(r.facts["core"]) for r in done.get("surface", {}).values()]
    files = [r.facts["bounds"] for r in done.get("index_file", {}).values()]
    found = [_metres((*box[0:2], *box[3:5])) for box in files if box]
    pieces: list[Piece] = []
    for suffix in ["", *(f"_{number}" for number in range(2, len(made) + 2))]:
        if f"dtm{suffix}" not in made:
            break
        names = (f"{product.name}{suffix}" for product in PRODUCTS if product.delivered)
        rasters = tuple(f"{name}.tif" for name in names if name in made)
        frame = _frame(context.output / f"dtm{suffix}.tif")
        inside = [box for cell in cells if (box := _common(cell, frame)) is not None]
        held = [part for box in inside if (part := _shrunk(box, found)) is not None]
        pieces.extend(Piece(_around(group), suffix, rasters) for group in split(held))
    return pieces


def in_words(pieces: Sequence[Piece]) -> tuple[PieceReport, ...]:
    """Pieces as a report has them; none where all lies together."""
    if len(pieces) < 2:
        return ()
    return tuple(
        PieceReport(extent_m=(p.bounds_m[0], p.bounds_m[2], p.bounds_m[1], p.bounds_m[3]),
                    rasters=p.rasters)
        for p in pieces
    )  # fmt: skip


def split(boxes: Sequence[Box]) -> list[list[Box]]:
    """Boxes by the piece that they belong to, the largest piece first.

    Boxes that are less than :data:`GAP_M` apart are of one piece; all are, where they fill more
    than :data:`FULL_SHARE` of their rectangle.
    """
    groups: list[list[Box]] = []
    for box in sorted(boxes):
        near = [g for g in groups if any(_apart(box, other) <= GAP_M for other in g)]
        groups = [g for g in groups if g not in near]
        groups.append([box, *(other for group in near for other in group)])
    groups.sort(key=lambda group: (-sum(map(_area, group)), min(group)))
    whole = sum(map(_area, map(_around, groups)))
    if len(groups) < 2 or whole > FULL_SHARE * _area(_around(boxes)):
        return [list(boxes)] if boxes else []
    return groups


def cropped(raster: Raster, bounds_m: Box) -> Raster:
    """Cells of a raster that a region touches; one at least."""
    west, _, _, north = raster.extent_m
    cell = raster.cell_m
    rows, columns = raster.values.shape
    col0 = min(max(int((bounds_m[0] - west) // cell), 0), columns - 1)
    row0 = min(max(int((north - bounds_m[3]) // cell), 0), rows - 1)
    col1 = min(max(-int((west - bounds_m[2]) // cell), col0 + 1), columns)
    row1 = min(max(-int((bounds_m[1] - north) // cell), row0 + 1), rows)
    extent = (west + col0 * cell, west + col1 * cell, north - row1 * cell, north - row0 * cell)
    return Raster(raster.values[row0:row1, col0:col1], extent)


def _frame(path: Path) -> Box:
    """Where a raster lies."""
    rows, columns, left, top, cell = overview_frame(path)
    return (left, top - rows * cell, left + columns * cell, top)


def _metres(bounds_q: Sequence[int]) -> Box:
    west, south, east, north = (edge * QUANTUM_M for edge in bounds_q)
    return (west, south, east, north)


def _common(one: Box, other: Box) -> Box | None:
    """What two boxes have in common; None without an area."""
    west, south = max(one[0], other[0]), max(one[1], other[1])
    east, north = min(one[2], other[2]), min(one[3], other[3])
    return (west, south, east, north) if west < east and south < north else None


def _shrunk(box: Box, found: Iterable[Box]) -> Box | None:
    """The part of a box that files reach into; None where none does."""
    parts = [part for file in found if (part := _common(box, file)) is not None]
    return _around(parts) if parts else None


def _apart(one: Box, other: Box) -> float:
    """Gap between two boxes, the larger of both directions; 0 where they touch [m]."""
    along = max(one[0] - other[2], other[0] - one[2], 0.0)
    across = max(one[1] - other[3], other[1] - one[3], 0.0)
    return max(along, across)


def _around(boxes: Sequence[Box]) -> Box:
    """The smallest box around some."""
    return (
        min(b[0] for b in boxes), min(b[1] for b in boxes),
        max(b[2] for b in boxes), max(b[3] for b in boxes),
    )  # fmt: skip


def _area(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])
