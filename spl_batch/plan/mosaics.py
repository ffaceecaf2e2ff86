"""Which ground cells share a raster file: all, unless they lie far apart."""

from collections.abc import Iterable, Sequence

from spl_batch.plan.density import FAR_Q
from spl_batch.tiling import Bounds, CellId, cell_bounds

LARGEST_SPARSE = 1_000_000_000
"""Raster cells of a mosaic that may be nearly empty [count]."""

LEAST_FILL = 0.02
"""Share of a larger mosaic that must be covered by ground cells."""


def split_mosaic(
    cells: Iterable[CellId], boxes: Sequence[Sequence[int]], cell_q: int, pixel_q: int
) -> list[tuple[list[CellId], Bounds]]:
    """Ground cells and region of each mosaic.

    Parameters
    ----------
    cells : iterable of CellId
        Finished ground cells.
    boxes : sequence of sequence of int
        Bounding boxes of the input files: x, y, z, x, y, z [quanta].
    cell_q, pixel_q : int
        Edges of a ground cell and of a raster cell [quanta].

    Returns
    -------
    list of (list of CellId, Bounds)
        Largest part first, equals by position; regions are whole raster cells, cut to
        the points.
    """
    everything = sorted(cells)
    if not everything:
        return []
    whole = _region(everything, boxes, cell_q, pixel_q)
    pixels = (whole.xmax - whole.xmin) * (whole.ymax - whole.ymin) / pixel_q**2
    filled = len(everything) * cell_q**2 / pixel_q**2
    if pixels <= LARGEST_SPARSE or filled >= LEAST_FILL * pixels:
        return [(everything, whole)]
    parts = sorted(_pieces(everything, cell_q), key=lambda part: (-len(part), part[0]))
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
    """Ground cells that are joined through neighbouring squares of :data:`FAR_Q`."""
    step = max(FAR_Q // cell_q, 1)
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
