"""Outline of a flightline: squares that its first returns cover, as polygons.

Each ground cell tells which squares of :data:`EDGE_M` a swath covers, packed; those of all cells
together are traced along their edges. A wide survey is drawn in coarser squares, and steps no
larger than a square become straight lines.
"""

import base64
import zlib
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.lattice.tiles import Bounds

DOMAIN: Final = "space"

EDGE_M: Final = 5
"""Edge of a square of an outline [m]."""

MOST: Final = 2**22
"""A flightline is drawn in no more squares than this [count]."""

STEP: Final = 1.0
"""An outline may differ by this from its squares: their steps become lines [edges]."""

Packed = tuple[int, int, int, int, str]
"""Western column and southern row, rows and columns of squares, and which of them are covered."""


def packed(covered: NDArray[np.bool_], squares: Bounds) -> Packed | None:
    """Squares of an outline that hold covered squares of 1 m; None where none does.

    Parameters
    ----------
    covered : (rows, cols) bool
        Row 0 southernmost.
    squares : Bounds
        Columns and rows of these squares of 1 m.
    """
    row, column = np.nonzero(covered)
    if not len(row):
        return None
    row, column = (row + squares.ymin) // EDGE_M, (column + squares.xmin) // EDGE_M
    south, west = int(row.min()), int(column.min())
    held = np.zeros((int(row.max()) - south + 1, int(column.max()) - west + 1), np.bool_)
    held[row - south, column - west] = True
    text = base64.b85encode(zlib.compress(np.packbits(held).tobytes())).decode("ascii")
    return west, south, held.shape[0], held.shape[1], text


def _unpacked(rows: int, columns: int, text: str) -> NDArray[np.bool_]:
    content = np.frombuffer(zlib.decompress(base64.b85decode(text)), np.uint8)
    return np.unpackbits(content, count=rows * columns).reshape(rows, columns).astype(np.bool_)


def outline(pieces: Iterable[Packed]) -> shapely.MultiPolygon:
    """Polygons around the squares of a flightline, in the survey's CRS [m].

    ``pieces``: at least one, of as many ground cells as there are.
    """
    listed = list(pieces)
    west, south = min(piece[0] for piece in listed), min(piece[1] for piece in listed)
    east = max(piece[0] + piece[3] for piece in listed)
    north = max(piece[1] + piece[2] for piece in listed)
    coarser = int(np.ceil(np.sqrt((north - south) * (east - west) / MOST)))
    west, south = (side // coarser * coarser for side in (west, south))
    held = np.zeros((-(-(north - south) // coarser), -(-(east - west) // coarser)), np.uint8)
    for column, row, rows, columns, text in listed:
        at = np.nonzero(_unpacked(rows, columns, text))
        held[(at[0] + row - south) // coarser, (at[1] + column - west) // coarser] = 1
    return _traced(held, (west, south), coarser * EDGE_M)


def _traced(held: NDArray[np.uint8], corner: Sequence[int], edge_m: int) -> shapely.MultiPolygon:
    from rasterio.features import shapes  # noqa: PLC0415 - loads GDAL, and one task draws

    rings = [shapely.geometry.shape(one) for one, _ in shapes(held, mask=held > 0)]
    drawn = shapely.simplify(shapely.union_all(rings), STEP)
    place = np.array(corner) * EDGE_M
    found = shapely.transform(drawn, lambda xy: xy * edge_m + place)
    return found if found.geom_type == "MultiPolygon" else shapely.MultiPolygon([found])
