"""Grey opening of a grid by octagons, for the progressive one of SMRF.

An octagon is a square widened by a diamond. A diamond is a run along one diagonal, widened along
the other, and by a cross, which joins both colours of a chessboard. The greatest value in a run of
cells down a column or a diagonal is that of the end of one block and the beginning of the next [van
Herk 1992; Gil & Werman 1993], whatever its length; along a row runs double. Each step takes the
greater of rows that are shifted, which the compiler turns into vector instructions.

Heights are kept in single precision, half a millimetre at 8 km; rounding keeps their order.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]

_STEP = 2
"""Step between the radii of openings that are made for all cells: one is left out [cells]."""

_PART = 64
"""Edge of the parts of a grid that are told one by one [cells]."""


def octagon(radius: int) -> tuple[int, int]:
    """Half-width of the square and radius of the diamond that add up to an octagon.

    Parameters
    ----------
    radius : int
        Radius of the octagon [cells].
    """
    diamond = round(radius * (2 - np.sqrt(2)))
    return radius - diamond, diamond


def cut_off(
    surface: NDArray[np.floating], falls: NDArray[np.floating], asked: Mask | None = None
) -> Mask:
    """Cells that fall by more than is allowed from one opening to the next.

    An opening by an octagon is that of any opening by a smaller one. So not all are made for all
    cells, one from the other: where cells fall between two of them (:func:`stages`) by no more than
    the one between them allows, that is not needed. Elsewhere it is made, for the cells alone that
    may be cut off. The same cells are found as by all openings, but for some near the edges, which
    each opening continues level.

    Parameters
    ----------
    surface : (rows, columns) floating
        Heights without gaps [m].
    falls : (n,) floating
        What is allowed to the openings by octagons of radius 1, 2 and so on, of what the one before
        has left [m].
    asked : (rows, columns) bool, optional
        Cells to be told; all by default.

    Returns
    -------
    (rows, columns) bool
    """
    found = np.zeros(surface.shape, dtype=np.bool_)
    told = np.ones(surface.shape, np.bool_) if asked is None else np.ascontiguousarray(asked)
    sizes = np.array([octagon(radius) for radius in range(len(falls) + 1)])
    ends, room = np.array(stages(len(falls))), room_for(surface.shape, len(falls))
    heights = surface.astype(np.float32)
    _cut_off(heights, sizes, ends, falls.astype(np.float32), told, room, found)
    return found


def stages(largest: int) -> list[int]:
    """Radii of the openings that are made for all cells, from 0 on [cells].

    Each rounds off what an edge of the grid cuts, and what is left is continued: by few openings
    less is rounded off, and long halls at the edge would stay.
    """
    return [*range(0, largest, _STEP), largest]


def room_for(shape: tuple[int, ...], radius: int) -> Heights:
    """Two grids with a margin beyond which no window begins that reaches a cell within."""
    return np.empty((2, shape[0] + 4 * radius, shape[1] + 4 * radius), dtype=np.float32)


@njit()
def _cut_off(
    last: Heights, sizes: NDArray[np.int64], ends: NDArray[np.int64], falls: Heights, asked: Mask,
    room: Heights, out: Mask,
) -> None:  # fmt: skip
    """Fill ``out``; ``sizes`` are squares and diamonds of the octagons; the heights are opened."""
    opened, eroded = np.empty_like(last), np.empty(room.shape[1:], np.float32)
    for k in range(1, len(ends)):
        first, end = ends[k - 1] + 1, ends[k]
        margin = 2 * end - first
        rows, columns = last.shape[0] + 2 * margin, last.shape[1] + 2 * margin
        at = erode(last, 2 * end, sizes[first, 0], sizes[first, 1], room)
        for r in range(rows):
            eroded[r, :columns] = room[at, r, :columns]
        # What is eroded by an octagon and what the next one has more is eroded by the next one.
        more = sizes[end] - sizes[first]
        at = _widen(room, at, rows, columns, more[0], more[1])
        dilate(room, at, sizes[end, 0], sizes[end, 1], opened)
        fall = falls[first - 1 : end].min()
        for top in range(0, last.shape[0], _PART):
            for left in range(0, last.shape[1], _PART):
                part = _active(last, opened, fall, asked, top, left, out)
                if part[0] < part[1]:
                    made = np.empty((part[1] - part[0], part[3] - part[2]), np.float32)
                    corner = part[0] + margin - first, part[2] + margin - first
                    for r in range(len(made) + 2 * first):
                        for c in range(made.shape[1] + 2 * first):
                            room[0, r, c] = eroded[corner[0] + r, corner[1] + c]
                    dilate(room, 0, sizes[first, 0], sizes[first, 1], made)
                    _mark(last, made, opened, part, falls[first - 1], falls[end - 1], asked, out)
        last, opened = opened, last


@njit()
def _mark(
    last: Heights, made: Heights, opened: Heights, part: tuple[int, int, int, int], first: float,
    second: float, asked: Mask, out: Mask,
) -> None:  # fmt: skip
    """Mark cells of a part that fall by too much to the opening half-way, or from there."""
    for r in range(len(made)):
        for c in range(made.shape[1]):
            i, j = part[0] + r, part[2] + c
            half_way = made[r, c]
            if asked[i, j] and not out[i, j]:
                out[i, j] = last[i, j] - half_way > first or half_way - opened[i, j] > second


@njit()
def _active(
    last: Heights, opened: Heights, fall: float, asked: Mask, top: int, left: int, known: Mask
) -> tuple[int, int, int, int]:
    """First and last row and column of a part's cells that fall by more, the last ones beyond."""
    first_row, end_row, first_column, end_column = last.shape[0], 0, last.shape[1], 0
    for r in range(top, min(top + _PART, last.shape[0])):
        for c in range(left, min(left + _PART, last.shape[1])):
            if asked[r, c] and not known[r, c] and last[r, c] - opened[r, c] > fall:
                first_row, end_row = min(first_row, r), r + 1
                first_column, end_column = min(first_column, c), max(end_column, c + 1)
    return first_row, end_row, first_column, end_column


@njit()
def erode(heights: Heights, margin: int, square: int, diamond: int, room: Heights) -> int:
    """Erode a grid that goes on level for a margin; which grid has the result, its sign turned."""
    rows, columns = heights.shape[0] + 2 * margin, heights.shape[1] + 2 * margin
    for r in range(rows):
        from_row = min(max(r - margin, 0), len(heights) - 1)
        _continue(heights[from_row], margin, room[0, r, :columns])
    return _widen(room, 0, rows, columns, square, diamond)


@njit()
def dilate(room: Heights, at: int, square: int, diamond: int, out: Heights) -> None:
    """Fill with the dilation of what was eroded, which has a margin of the octagon's radius."""
    reach = square + diamond
    rows, columns = out.shape[0] + 2 * reach, out.shape[1] + 2 * reach
    for r in range(rows):
        _turn_over(room[at, r, :columns])
    at = _widen(room, at, rows, columns, square, diamond)
    for r in range(len(out)):
        out[r] = room[at, r, : out.shape[1]]


@njit()
def _continue(heights: Heights, margin: int, out: Heights) -> None:
    """A row with the other sign, and level on both sides."""
    columns = len(heights)
    for c in range(margin):
        out[c] = -heights[0]
        out[margin + columns + c] = -heights[-1]
    for c in range(columns):
        out[margin + c] = -heights[c]


@njit()
def _turn_over(heights: Heights) -> None:
    """Heights with the other sign, in their place."""
    for c in range(len(heights)):
        heights[c] = -heights[c]


@njit()
def _widen(room: Heights, at: int, rows: int, columns: int, square: int, diamond: int) -> int:
    """Greatest height in an octagon around each cell that is its radius off the edges.

    Parameters
    ----------
    room : (2, a, b) float32
        Two grids; both are written to.
    at : int
        Grid whose upper left corner has the heights.
    rows, columns : int
        Shape of these.
    square, diamond : int
        What the octagon is made of.

    Returns
    -------
    int
        Grid whose upper left corner has the results.
    """
    if square:
        length = 2 * square + 1
        at = _across(room, at, rows, columns, length)
        columns -= length - 1
        _down(room, at, rows, columns, length, 0)
        rows -= length - 1
    if diamond:
        here, there = room[at], room[1 - at]
        for r in range(rows - 2):
            _greatest(
                here[r, 1 : columns - 1], here[r + 1, : columns - 2], here[r + 1, 1 : columns - 1],
                here[r + 1, 2:columns], here[r + 2, 1 : columns - 1], there[r],
            )  # fmt: skip
        at, rows, columns = 1 - at, rows - 2, columns - 2
        _down(room, at, rows, columns, diamond, 1)
        rows, columns = rows - diamond + 1, columns - diamond + 1
        _down(room, at, rows, columns, diamond, -1)
    return at


@njit()
def _across(room: Heights, at: int, rows: int, columns: int, length: int) -> int:
    """Greatest of so many cells of a row, the first of them in its left corner; runs double."""
    steps = 0
    for r in range(rows):
        here, there = room[at, r], room[1 - at, r]
        run, wide, steps = 1, columns, 0
        while run < length:
            step = min(run, length - run)
            wide -= step
            _greater(here[:wide], here[step : step + wide], there)
            here, there = there, here
            run, steps = run + step, steps + 1
    return (at + steps) % 2


@njit()
def _down(room: Heights, at: int, rows: int, columns: int, length: int, right: int) -> None:
    """Greatest of so many cells down a column or a diagonal, put into its upper left corner.

    Of each block of so many rows all ends are found, and of the next one all beginnings.

    Parameters
    ----------
    room : (2, a, b) float32
        Two grids: the heights, which the results replace, and room for the ends.
    at : int
        Grid of the heights.
    rows, columns : int
        Shape of these.
    length : int
        Cells in a run.
    right : int
        Columns from one row to the next: -1, 0 or 1.
    """
    if length == 1:
        return
    heights, ends = room[at], room[1 - at]
    begun = np.empty((2, columns), np.float32)
    wide = columns - abs(right) * (length - 1)
    first, last = max(-right, 0) * (length - 1), max(right, 0) * (length - 1)
    for top in range(0, rows - length + 1, length):
        below = top + length
        ends[below - 1, :columns] = heights[below - 1, :columns]
        for r in range(below - 2, top - 1, -1):
            _go_on(heights[r, :columns], ends[r + 1, :columns], -right, ends[r, :columns])
        heights[top, :wide] = ends[top, first : first + wide]
        for r in range(top + 1, min(below, rows - length + 1)):
            new, old = begun[r % 2], begun[1 - r % 2]
            if r == top + 1:
                new[:] = heights[below, :columns]
            else:
                _go_on(heights[r + length - 1, :columns], old, right, new)
            _greater(ends[r, first : first + wide], new[last : last + wide], heights[r])


@njit()
def _go_on(row: Heights, before: Heights, right: int, out: Heights) -> None:
    """Greater of a row and the one before, whose cells are so many columns further left."""
    columns = len(row)
    one, other = max(right, 0), max(-right, 0)
    out[0], out[columns - 1] = row[0], row[columns - 1]
    _greater(
        row[one : columns - other], before[other : columns - one], out[one : columns - other]
    )  # fmt: skip


@njit()
def _greater(one: Heights, other: Heights, out: Heights) -> None:
    """Greater of two heights each."""
    for i in range(len(one)):
        out[i] = max(one[i], other[i])


@njit()
def _greatest(
    up: Heights, left: Heights, here: Heights, right: Heights, down: Heights, out: Heights
) -> None:
    """Greatest of five heights each."""
    for i in range(len(up)):
        along, across = max(up[i], down[i]), max(left[i], right[i])
        around = max(along, across)
        out[i] = max(around, here[i])
