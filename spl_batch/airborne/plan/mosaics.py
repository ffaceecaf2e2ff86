"""Which ground cells share a raster file: all, unless they lie far apart."""

import math
from collections.abc import Iterable, Mapping, Sequence

from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, shared

APART_Q = 1_000_000
"""Gap beyond which what lies on either side is a piece of its own, where so much would be empty: a
few stray points 10 km away would make rasters of hundreds of square kilometres [quanta]."""

LEAST_FILL = 0.02
"""Share of a mosaic that ground cells must cover where some lie far apart."""


def split_mosaic(
    cells: Mapping[CellId, int], boxes: Sequence[Sequence[int]], cell_q: int, pixel_q: int
) -> list[tuple[list[CellId], Bounds]]:
    """Ground cells and region of each mosaic.

    Parameters
    ----------
    boxes : sequence of sequence of int
        Bounding boxes of the input files: x, y, z, x, y, z [quanta].
    cell_q, pixel_q : int
        Edges of a ground cell and of a raster cell [quanta].

    Returns
    -------
    list of (list of CellId, Bounds)
        The part with most points first, equals by position; regions are whole raster cells, cut to
        the points.
    """
    everything = sorted(cells)
    if not everything:
        return []
    whole = _region(everything, boxes, cell_q, pixel_q)
    filled = math.fsum(shared(cell_bounds(cell, cell_q), whole).area_m2 for cell in everything)
    if filled >= LEAST_FILL * whole.area_m2:
        return [(everything, whole)]
    parts = _pieces(everything, cell_q)
    parts.sort(key=lambda part: (-sum(cells[cell] for cell in part), part[0]))
    return [(part, _region(part, boxes, cell_q, pixel_q)) for part in parts]


def _region(
    cells: Sequence[CellId], boxes: Sequence[Sequence[int]], cell_q: int, pixel_q: int
) -> Bounds:
    """Smallest region of whole raster cells that holds the points of some ground cells."""
    edges = [cell_bounds(cell, cell_q) for cell in cells]
    west, south = min(e.xmin for e in edges), min(e.ymin for e in edges)
    east, north = max(e.xmax for e in edges), max(e.ymax for e in edges)
    near = [b for b in boxes if b[0] < east and b[3] >= west and b[1] < north and b[4] >= south]
    return Bounds(
        max(west, min(b[0] for b in near) // pixel_q * pixel_q),
        max(south, min(b[1] for b in near) // pixel_q * pixel_q),
        min(east, (max(b[3] for b in near) // pixel_q + 1) * pixel_q),
        min(north, (max(b[4] for b in near) // pixel_q + 1) * pixel_q),
    )


def _pieces(cells: Iterable[CellId], cell_q: int) -> list[list[CellId]]:
    """Ground cells that are joined through neighbouring squares of :data:`APART_Q`."""
    step = max(APART_Q // cell_q, 1)
    squares: dict[tuple[int, int], list[CellId]] = {}
    for cell in cells:
        squares.setdefault((cell.i // step, cell.j // step), []).append(cell)
    pieces: list[list[CellId]] = []
    while squares:
        start = min(squares)
        front, piece = [start], squares.pop(start)
        while front:
            i, j = front.pop()
            near = [(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
            for square in near:
                if square in squares:
                    piece.extend(squares.pop(square))
                    front.append(square)
        pieces.append(sorted(piece))
    return pieces
