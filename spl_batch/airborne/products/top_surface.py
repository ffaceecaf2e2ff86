"""The top surface of a ground cell: the highest return of each raster cell that others confirm.

Domain: space. Small voids are filled.

Noise that the filter leaves hangs mostly a few metres above surfaces and crowns, where a count in a
sphere takes it for a thin crown. So only *peers* confirm a return
(:mod:`spl_batch.airborne.filter.ellipsoid.spacing`): a crown's top has its twigs, noise above a
roof only other noise. Spheres of several radii are tried: a roof is confirmed within half a metre,
a thin crown within two. Neighbours are looked for cell by cell, as few returns ask and one or two
cells are far.

Ground returns need no confirmation and give none: noise just above sparse ground must not live on
it.

At the rim of a crown twigs are sparse. Where nearly all tops around stand far above a cell's own
confirmed return, its highest return counts that is no higher than most of them (:func:`lift_pits`).
In a cell whose returns are all unconfirmed, two of the tops around are enough.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.products.cell_values import (
    by_cell,
    cell_number,
    fill_voids,
    shape_of,
)
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, quanta
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import sort_in
from spl_batch.numerics.sorting import sort

PIT_M: Final = 2.0
"""Cells so far below most of those around are pits [m]. Half moves 1 + 1 cells of the DSM, twice
nothing."""

PIT_NEIGHBOURS = 6
"""Of eight cells around, those that have to stand above a pit [count]."""

RIM_NEIGHBOURS = 2
"""Of eight cells around, those whose tops confirm a return of a cell without ground [count]."""


SPARE_PEERS: Final = 256
"""Peers beyond twice what noise lets expect that confirm a return at any false alarm [count]."""


class Support(NamedTuple):
    """What confirms a return: spheres, the smallest first."""

    radius: NDArray[np.int64]  #: (s,): radii [quanta].
    #: (k, s): peers that each must hold, besides the confirmed one, by the noise around [count].
    needed: NDArray[np.int64]
    noise: NDArray[np.int64]  #: (cells,): which row of these is that of a raster cell.
    #: Spacing is the distance to this neighbour, at most the largest radius [count].
    neighbours: int
    peer_ratio: float  #: A peer's spacing is at least the return's divided by this.


def _void_cells(settings: ProductSettings) -> int:
    return quanta(settings.dsm_void_max_m) // quanta(settings.cell_m)


def cells_within(length_m: float, settings: ProductSettings) -> int:
    """Raster cells that a length may reach into [count]."""
    return -(-quanta(length_m) // quanta(settings.cell_m))


def _scales_m(settings: ProductSettings) -> tuple[float, ...]:
    """Radii of the spheres that confirm a return, each twice the one before [m]."""
    radii_m = [settings.dsm_near_m]
    while 2.0 * radii_m[-1] < settings.dsm_support_m:
        radii_m.append(2.0 * radii_m[-1])
    return (*radii_m, settings.dsm_support_m)


def _support_cells(settings: ProductSettings) -> int:
    """Cells that decide on a top: its largest sphere, the spacing in there, the cells around."""
    return cells_within(2.0 * settings.dsm_support_m, settings) + 1


def top_margin(settings: ProductSettings) -> int:
    """Raster cells around a ground cell that its DSM and the check of its DTM look at [count]."""
    return _void_cells(settings) + _support_cells(settings)


def support_of(noise: NDArray[np.float64], settings: ProductSettings) -> Support:
    """What confirms a return, given the noise around each raster cell [1/m3].

    The smallest count that noise alone reaches rarely enough, and ``dsm_support`` at least.
    """
    radii_m, least = _scales_m(settings), settings.dsm_support
    densities, which = np.unique(noise, return_inverse=True)
    expected = 4.0 / 3.0 * np.pi * densities[:, None] * np.array(radii_m) ** 3
    # Up to this lambda P(K >= k | lambda) is small enough, by k.
    end = max(least, int(2.0 * expected.max(initial=0.0))) + SPARE_PEERS
    most = gammaincinv(np.arange(max(least, 1), end), settings.dsm_false_alarm)
    return Support(
        radius=np.array([quanta(radius_m) for radius_m in radii_m]),
        needed=least
        + (np.searchsorted(most, expected) if least else np.zeros(expected.shape, np.int64)),
        noise=which,
        neighbours=settings.dsm_spacing_neighbours,
        peer_ratio=settings.dsm_peer_ratio,
    )


def top_surface(
    signal: PointTable,
    level: NDArray[np.uint8],
    support: Support,
    cell: Bounds,
    settings: ProductSettings,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """DSM from the south, small voids filled [quanta], NaN in the larger ones.

    And which cells were filled.
    """
    size = quanta(settings.cell_m)
    near = grow(cell, top_margin(settings) * size)
    rows, cols = shape_of(near, size)
    # An afterpulse of noise must neither stand out nor confirm the noise in front of it.
    own = ~dependents(signal) | (signal["ground"] == 1)
    needed = signal.select(("x", "y", "z", "ground"))
    tops = _tops(needed.take(own & (level == 0)), near, size, support)
    if (level > 0).any():
        # A cell holds one level only; the better returns may confirm the others.
        number = cell_number(signal, near, size)[level > 0]
        lesser = np.bincount(number, minlength=rows * cols) > 0
        tops[lesser] = _tops(needed.take(own), near, size, support)[lesser]
    tops = tops.reshape(rows, cols)
    # The outermost cells lack neighbours that could confirm them: they must lend nothing.
    edge = _support_cells(settings)
    tops = np.ascontiguousarray(tops[edge : rows - edge, edge : cols - edge])
    filled = fill_voids(tops, settings.dsm_void_max_m / settings.cell_m)
    rim = top_margin(settings) - edge
    core = slice(rim, filled.shape[0] - rim), slice(rim, filled.shape[1] - rim)
    return filled[core], np.isnan(tops)[core]


def _tops(signal: PointTable, near: Bounds, size: int, support: Support) -> NDArray[np.float64]:
    """Highest confirmed return of each raster cell, row by row [quanta]; NaN without any."""
    rows, cols = shape_of(near, size)
    places, start, order = by_cell(signal, near, size)
    xyz = np.stack(places, axis=1)
    tops = np.empty(rows * cols)
    confirmed_tops(xyz, signal["ground"][order] == 1, start, (cols, size), support, tops)
    lifted = tops.reshape(rows, cols).copy()
    z = np.ascontiguousarray(xyz[:, 2])
    lift_pits(z, start, tops.reshape(rows, cols), PIT_M / QUANTUM_M, lifted)
    return lifted.ravel()


@njit()
def confirmed_tops(
    xyz: NDArray[np.int32],
    ground: NDArray[np.bool_],
    start: NDArray[np.int64],
    grid: tuple[int, int],
    by: Support,
    tops: NDArray[np.float64],
) -> None:
    """Height of the highest confirmed return of each cell into ``tops``, NaN without [quanta].

    ``xyz``: (n, 3), from the corner of the raster, in the order of
    :func:`spl_batch.airborne.products.cell_values.sort_into_cells`, whose ``start`` it is;
    ``ground``: returns that need no confirmation and give none; ``grid``: cells of a row, and their
    edge [quanta].
    """
    cap2, ratio2, limit = 0.0, by.peer_ratio**2, np.empty(len(by.radius))
    for scale in range(len(limit)):
        limit[scale] = float(by.radius[scale]) ** 2
        cap2 = max(cap2, limit[scale])
    nearest, spacing = np.empty(by.neighbours), np.empty(len(xyz))
    for p in range(len(xyz)):
        spacing[p] = np.nan
    for cell in range(len(tops)):
        tops[cell] = np.nan
        for p in range(start[cell], start[cell + 1]):
            accepted = ground[p]
            if not accepted:
                _find_spacing(xyz, start, grid, p, cell, cap2, nearest, spacing)
            for scale in range(len(limit)):
                if accepted:
                    break
                accepted = _has_peers(
                    xyz, ground, start, grid, p, cell, limit[scale],
                    by.needed[by.noise[cell], scale] + 1, ratio2,
                    cap2, nearest, spacing,
                )  # fmt: skip
            if accepted:
                tops[cell] = xyz[p, 2]
                break


@njit()
def _place_of(xyz, z, low, high):  # type: ignore[no-untyped-def]
    """First return of a cell that is no higher than ``z``."""
    while low < high:
        middle = (low + high) >> 1
        if xyz[middle, 2] > z:
            low = middle + 1
        else:
            high = middle
    return low


@njit()
def _gap2(xyz, p, row, col, size):  # type: ignore[no-untyped-def]
    """Squared distance from a return to a cell, seen from above [quanta2]."""
    x, y = np.float64(xyz[p, 0]), np.float64(xyz[p, 1])
    east, north = np.float64(col) * size, np.float64(row) * size
    dx, dy = max(east - x, x - (east + size), 0.0), max(north - y, y - (north + size), 0.0)
    return dx * dx + dy * dy


@njit()
def _find_spacing(xyz, start, grid, p, cell, cap2, nearest, spacing):  # type: ignore[no-untyped-def]
    """Squared spacing of a return, if it is not known yet, by rings of cells around [quanta2]."""
    if not np.isnan(spacing[p]):
        return
    cols, size = grid
    rows, row, col = (len(start) - 1) // cols, cell // cols, cell % cols
    last = len(nearest) - 1
    for k in range(len(nearest)):
        nearest[k] = cap2
    west, south = np.float64(xyz[p, 0] - col * size), np.float64(xyz[p, 1] - row * size)
    aside = min(west, size - west, south, size - south)
    ring = 0
    while ring == 0 or (aside + (ring - 1) * size) ** 2 < nearest[last]:
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            step = 1 if abs(r - row) == ring else 2 * ring
            for c in range(col - ring, col + ring + 1, step):
                if 0 <= c < cols and _gap2(xyz, p, r, c, size) < nearest[last]:
                    other = r * cols + c
                    _look_through(xyz, p, start[other], start[other + 1], nearest)
        ring += 1
    spacing[p] = nearest[last]


@njit()
def _look_through(xyz, p, low, high, nearest):  # type: ignore[no-untyped-def]
    """Put squared distances to a cell's returns among the nearest ones, in order."""
    x, y, z = np.float64(xyz[p, 0]), np.float64(xyz[p, 1]), np.float64(xyz[p, 2])
    last, middle = len(nearest) - 1, _place_of(xyz, xyz[p, 2], low, high)
    for way in (1, -1):
        q = middle if way > 0 else middle - 1
        while low <= q < high:
            dz = xyz[q, 2] - z
            if dz * dz >= nearest[last]:
                break
            dx, dy = xyz[q, 0] - x, xyz[q, 1] - y
            distance = dx * dx + dy * dy + dz * dz
            if distance < nearest[last] and q != p:
                sort_in(nearest, distance)
            q += way


@njit()
def _has_peers(  # type: ignore[no-untyped-def]
    xyz, ground, start, grid, p, cell, limit, wanted, ratio2, cap2, nearest, spacing
):
    """Whether a return has enough peers within a distance, itself among them."""
    # `filter.ellipsoid.spacing.peer_distances` is given all spacings. Here few are needed and each
    # costs a search, so they are found on the way.
    cols, size = grid
    rows, row, col = (len(start) - 1) // cols, cell // cols, cell % cols
    count, ring = 0, 0
    while count < wanted and (ring == 0 or ((ring - 1) * size) ** 2 <= limit):
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            step = 1 if abs(r - row) == ring else 2 * ring
            for c in range(col - ring, col + ring + 1, step):
                if 0 <= c < cols and count < wanted and _gap2(xyz, p, r, c, size) <= limit:
                    count += _peers_in(
                        xyz, ground, start, grid, p, r * cols + c, limit, wanted - count, ratio2,
                        cap2, nearest, spacing,
                    )  # fmt: skip
        ring += 1
    return count >= wanted


@njit()
def _peers_in(  # type: ignore[no-untyped-def]
    xyz, ground, start, grid, p, cell, limit, wanted, ratio2, cap2, nearest, spacing
):
    """Peers of a return in a cell, at most ``wanted``."""
    x, y, z = np.float64(xyz[p, 0]), np.float64(xyz[p, 1]), np.float64(xyz[p, 2])
    low, high = start[cell], start[cell + 1]
    middle, count = _place_of(xyz, xyz[p, 2], low, high), 0
    for way in (1, -1):
        q = middle if way > 0 else middle - 1
        while low <= q < high and count < wanted:
            dz = xyz[q, 2] - z
            if dz * dz > limit:
                break
            dx, dy = xyz[q, 0] - x, xyz[q, 1] - y
            if dx * dx + dy * dy + dz * dz <= limit and not ground[q]:
                _find_spacing(xyz, start, grid, q, cell, cap2, nearest, spacing)
                count += spacing[q] * ratio2 >= spacing[p]
            q += way
    return count


@njit()
def lift_pits(
    z: NDArray[np.int32],
    start: NDArray[np.int64],
    tops: NDArray[np.float64],
    depth: float,
    out: NDArray[np.float64],
) -> None:
    """Tops with pits lifted to returns that the tops around confirm, into ``out``, a copy of them.

    A cell ``depth`` below :data:`PIT_NEIGHBOURS` of the eight around it is a pit, filled with its
    highest return no higher than that many of them; a cell without a top, in which no return is
    ground, gets one no higher than :data:`RIM_NEIGHBOURS` of them. ``z, start`` by cell, highest
    first [quanta].
    """
    rows, cols = tops.shape
    around = np.empty(8)
    for row in range(1, rows - 1):
        for col in range(1, cols - 1):
            cell = row * cols + col
            void = np.isnan(tops[row, col])
            if void and start[cell] == start[cell + 1]:
                continue
            known = 0
            for other in range(9):
                top = tops[row + other // 3 - 1, col + other % 3 - 1]
                if other != 4 and not np.isnan(top):
                    around[known] = top
                    known += 1
            above = RIM_NEIGHBOURS if void else PIT_NEIGHBOURS
            if known < above:
                continue
            sort(around[:known])
            level = around[known - above]
            if not void and tops[row, col] > level - depth:
                continue
            for p in range(start[cell], start[cell + 1]):
                if z[p] <= level:
                    out[row, col] = np.fmax(tops[row, col], np.float64(z[p]))
                    break
