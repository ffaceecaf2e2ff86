"""Places of a survey that belong together, and the terrain below them."""

from collections.abc import Callable, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from spl_batch.airborne.products.product_table import is_piece
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.engine.report.run_record import Receipts
from spl_batch.formats.rasters.parts import Part, overview_frame, read_overview

WALLS: Final = 0.25
"""Share of the terrain in a place that is enough to be what something in it lies above: in a narrow
valley most of it are walls."""

MOST_SQUARES: Final = 64
"""Squares along a side in which the neighbours of the largest box are looked for [count]."""

Box = Sequence[int]
"""West, south, east and north [quanta]."""


def joined(
    boxes: Sequence[Box], alike: Callable[[int, int], bool] = lambda _, __: True
) -> list[list[int]]:
    """Numbers of boxes that touch, at corners too, and are alike: each group, and so its others.

    ``alike``: whether two boxes that touch belong together, by their numbers.
    """
    if not boxes:
        return []
    sides = np.array(boxes, np.int64)
    across = sides[:, 2:] - sides[:, :2]
    edge = max(int(np.median(across)), int(across.max()) // MOST_SQUARES, 1)
    near: dict[tuple[int, int], list[int]] = {}
    for k, (west, south, east, north) in enumerate((sides // edge).tolist()):
        for at in product(range(west, east + 1), range(south, north + 1)):
            near.setdefault(at, []).append(k)
    pairs = {
        (i, j)
        for those in near.values()
        for i, j in combinations(those, 2)
        if _touch(boxes[i], boxes[j]) and alike(i, j)
    }
    one, other = np.array(sorted(pairs), np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(one)), (one, other)), (len(boxes), len(boxes)))
    _, group = connected_components(graph, directed=False)
    found: dict[int, list[int]] = {}
    for k, number in enumerate(group.tolist()):
        found.setdefault(number, []).append(k)
    return list(found.values())


def around(boxes: Sequence[Box]) -> list[int]:
    """Box around some."""
    sides = np.array(boxes, np.int64)
    return [*sides[:, :2].min(axis=0).tolist(), *sides[:, 2:].max(axis=0).tolist()]


def extent_of(done: Receipts) -> list[int] | None:
    """Box around all points; None where they are not known."""
    found = [r.facts["bounds"] for r in done.get("index_file", {}).values() if r.facts["bounds"]]
    return around([[*box[:2], *box[3:5]] for box in found]) if found else None


def clipped(box: Box, extent: Box | None) -> list[int]:
    """Part of a box where there are points; all of it where they are not known or elsewhere."""
    if extent is None or not _touch(box, extent):
        return list(box)
    low = [max(*sides) for sides in zip(box[:2], extent[:2], strict=True)]
    return low + [min(*sides) for sides in zip(box[2:], extent[2:], strict=True)]


def within(boxes: Sequence[Box], extent: Box | None = None) -> str:
    """Text of the box around some; ``extent``: beyond it there are no points."""
    west, south, east, north = (round(side * QUANTUM_M) for side in clipped(around(boxes), extent))
    return f"within x {west} to {east} and y {south} to {north}"


def largest(
    boxes: Sequence[Box],
    amounts: Sequence[float],
    cells: Sequence[Box] | None = None,
    extent: Box | None = None,
) -> str:
    """Text of where some boxes lie: of several places that do not touch, the largest.

    Parameters
    ----------
    boxes : sequence of Box
        What is told.
    amounts : sequence of float
        How much of it lies in each.
    cells : sequence of Box, optional
        What must touch to be one place, if not the boxes.
    extent : Box, optional
        Beyond it there are no points.
    """
    groups = joined(cells or boxes)
    most = max(groups, key=lambda group: sum(amounts[k] for k in group))
    where = within([boxes[k] for k in most], extent)
    return where if len(groups) == 1 else f"in {len(groups)} places, the largest {where}"


def _touch(one: Box, other: Box) -> bool:
    return all(one[k] <= other[k + 2] and other[k] <= one[k + 2] for k in (0, 1))


class _Frame(NamedTuple):
    """Where a piece of the terrain lies [m]."""

    path: Path
    bounds_m: tuple[float, float, float, float]


class Terrain:
    """Delivered terrain of all pieces.

    Parameters
    ----------
    output : Path
        Folder of the rasters.
    """

    def __init__(self, output: Path) -> None:
        self._frames = []
        for path in sorted(output.glob("dtm*.tif")):
            if is_piece(path.stem, "dtm"):
                rows, cols, left, top, cell = overview_frame(path)
                bounds = (left, top - rows * cell, left + cols * cell, top)
                self._frames.append(_Frame(path, bounds))

    def below(
        self, boxes: Sequence[Box], of_m: Sequence[float | None] | None = None
    ) -> list[float | None]:
        """Median height under each of some boxes side by side, in coarse cells if they are large.

        None where nothing is known [m]. ``of_m``: height of what lies in each box; if a quarter of
        its terrain is lower, the rest are walls beside it, and do not count [m].
        """
        if not boxes:
            return []
        west, south, east, north = (side * QUANTUM_M for side in around(boxes))
        parts = [
            read_overview(path, bounds_m=(west, south, east, north))
            for path, (left, low, right, top) in self._frames
            if left < east and west < right and low < north and south < top
        ]
        found = []
        for box, height_m in zip(boxes, of_m or [None] * len(boxes), strict=True):
            known = np.concatenate(
                [np.empty(0, np.float32), *(_within(part, box) for part in parts)]
            )
            lower = known[known < (np.inf if height_m is None else height_m)]
            used = lower if len(lower) >= WALLS * len(known) else known
            found.append(float(np.median(used)) if len(used) else None)
        return found


def _within(part: Part, box: Box) -> NDArray[np.float32]:
    """Known heights in the cells that a box touches."""
    west, south, east, north = (side * QUANTUM_M for side in box)
    rows, cols = part.values.shape
    row0, row1 = ((part.top_m - side) / part.cell_m for side in (north, south))
    col0, col1 = ((side - part.left_m) / part.cell_m for side in (west, east))
    values = part.values[
        min(max(int(np.floor(row0)), 0), rows) : max(int(np.ceil(row1)), 0),
        min(max(int(np.floor(col0)), 0), cols) : max(int(np.ceil(col1)), 0),
    ]
    return values[values > NODATA]
