"""Kernels of :mod:`~spl_batch.airborne.pulses.level_places`: returns by place, and their sums."""

from spl_batch.numerics.compiled import njit


@njit()
def number_places(xyz, line, west, south, square, columns, rows, at):  # type: ignore[no-untyped-def]
    """Number of the square of each return, those of each flightline by themselves."""
    for i in range(len(xyz)):
        row, column = (xyz[i, 1] - south) // square, (xyz[i, 0] - west) // square
        at[i] = (line[i] * rows + row) * columns + column


@njit()
def add_up(xyz, west, south, square, place, low, sums):  # type: ignore[no-untyped-def]
    """Make returns offsets in their place, and add up their moments.

    ``xyz`` is overwritten; ``low`` begins above all heights; ``sums`` are those of
    :func:`~spl_batch.airborne.pulses.level_places._planes`.
    """
    for i in range(len(xyz)):
        low[place[i]] = min(low[place[i]], xyz[i, 2])
    for i in range(len(xyz)):
        p = place[i]
        x, y, z = (xyz[i, 0] - west) % square, (xyz[i, 1] - south) % square, xyz[i, 2] - low[p]
        xyz[i, 0], xyz[i, 1], xyz[i, 2] = x, y, z
        sums[p, 0] += 1
        sums[p, 1] += x
        sums[p, 2] += y
        sums[p, 3] += z
        sums[p, 4] += x * x
        sums[p, 5] += x * y
        sums[p, 6] += y * y
        sums[p, 7] += x * z
        sums[p, 8] += y * z
        sums[p, 9] += z * z


@njit()
def spans(offset, place, edge, highest, lowest, count):  # type: ignore[no-untyped-def]
    """Highest and lowest return of each cell of each place, and returns in it.

    ``highest`` begins below all heights, ``lowest`` above: (places, cells, cells), as ``count``.
    """
    for i in range(len(offset)):
        p, row, column = place[i], offset[i, 1] // edge, offset[i, 0] // edge
        highest[p, row, column] = max(highest[p, row, column], offset[i, 2])
        lowest[p, row, column] = min(lowest[p, row, column], offset[i, 2])
        count[p, row, column] += 1
