"""The top surface of a ground cell: returns that others confirm, and small voids filled.

Domain: space. :mod:`~spl_batch.airborne.products.confirmed_tops` says which returns are confirmed.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.products.cell_values import (
    by_cell,
    cell_number,
    fill_voids,
    shape_of,
)
from spl_batch.airborne.products.confirmed_tops import Support, confirmed_tops, lift_pits
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, quanta

PIT_M: Final = 2.0
"""Cells so far below most of those around are pits [m]."""


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


def _critical(expected: float, settings: ProductSettings) -> int:
    """Smallest count that noise alone reaches rarely enough, and ``dsm_support`` at least."""
    count = settings.dsm_support
    # pdtrc(k - 1, m) = P(K >= k); it is 0 for m = 0 and k > 0.
    while count > 0 and pdtrc(count - 1, expected) > settings.dsm_false_alarm:
        count += 1
    return count


def support_of(noise: NDArray[np.float64], settings: ProductSettings) -> Support:
    """What confirms a return, given the noise around each raster cell [1/m3]."""
    radii_m = _scales_m(settings)
    # Neighbours mostly share a density: few are left where it changes along a row.
    opens = np.ones(len(noise), np.bool_)
    opens[1:] = noise[1:] != noise[:-1]
    densities, which = np.unique(noise[opens], return_inverse=True)
    expected = [[4.0 / 3.0 * np.pi * per_m3 * r**3 for r in radii_m] for per_m3 in densities]
    return Support(
        radius=np.array([quanta(radius_m) for radius_m in radii_m]),
        needed=np.array([[_critical(count, settings) for count in counts] for counts in expected]),
        noise=which[np.cumsum(opens) - 1],
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
