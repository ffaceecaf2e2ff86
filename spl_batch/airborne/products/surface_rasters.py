r"""Terrain, surface, height, density and intensity rasters of one ground cell.

Domain: space. A ground cell is an absolute square whose edge is a whole multiple of the
raster cell; it and a fixed margin around it decide its rasters, whatever tile, block or
task they are computed in.

====== ========================================================================
DTM    TIN through one vertex per raster cell: the robust mean (x, y, z) of its
       ground returns, evaluated at cell centres. The spread of a single range
       (5 cm) stays in a TIN through single returns; averaging removes it, and
       averaging positions too keeps slopes unbiased. In water polygons ground returns are
       put on the water's level first (:mod:`~spl_batch.airborne.ground.water_level`).
DSM    Highest return of the cell that is ground or that its peers confirm: more of
       them in a sphere than noise alone puts there, spheres from ``dsm_near_m`` to
       ``dsm_support_m`` being tried in turn (:mod:`spl_batch.airborne.products.confirmed_tops`).
       What noise puts there is measured by the returns that the filter refused;
       without any, ``dsm_support`` returns do. A wire of few returns per metre
       stands out of the DSM where there is little noise only. In a pit, more than
       :data:`PIT_M` below most cells around, the highest return up to their level does
       without peers; so does, where none is ground or confirmed, the highest up to the
       level of two of them. Never below the DTM.
       A cell without such a return takes the nearest value within
       ``dsm_void_max_m``, of several the lowest.
CHM    DSM - DTM, hence >= 0; nodata where either is.
sigma  Standard deviation of the DTM, by how far the nearest ground is and what that distance
       costs around (:mod:`~spl_batch.airborne.products.terrain_quality`).
====== ========================================================================

Returns that the filter has not assessed (no beam; or no filter at all) take part in a
raster cell only where it holds no assessed signal: there they are all that is known.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.ground.water_level import REACH_M, flattened
from spl_batch.airborne.products.cell_values import (
    fill_voids,
    number_cells,
    ring_offsets,
    robust_cell_means,
    sort_into_cells,
)
from spl_batch.airborne.products.confirmed_tops import Support, confirmed_tops, lift_pits
from spl_batch.airborne.products.flown_cells import flown
from spl_batch.airborne.products.noise_aloft import noise_by_cell
from spl_batch.airborne.products.terrain_quality import terrain_sigma
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA, NOISE_NOT_ASSESSED, NOISE_SIGNAL, QUANTUM_M
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta
from spl_batch.numerics.triangulation.tin_raster import tin_raster

DOMAIN: Final = "space"
"""Needs every flightline of a place."""

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class", "ground", "flags")
"""Columns that :func:`surfaces` reads, and ``afterpulse`` where the time domain ran."""

COLUMNS_OF_INTENSITY: Final = ("intensity", "return_number")
"""Columns that it reads where they are there, for a raster of what was delivered."""

GROUND_FLOOR_M: Final = 0.15
"""Ground returns this near to the median of their cell are no outliers: 3 sigma of a range [m]."""

CORNER_CELLS: Final = 3
"""Returns so near to a corner of the area that is read cover it [raster cells]."""

PIT_M: Final = 2.0
"""Cells so far below most of those around are pits [m]."""


def margin_cells(settings: ProductSettings) -> int:
    """Raster cells around a ground cell whose points decide its rasters [count]."""
    ground_m = max(2.0 * settings.void_max_m, REACH_M)
    return max(_cells(ground_m, settings), _top_margin(settings))


def reach_m(settings: ProductSettings) -> float:
    """Width of the margin that :func:`surfaces` reads around a ground cell [m].

    Twice the widest void that is interpolated over, as the ground on its far side counts, and no
    less than what the level of water is taken from.
    """
    return margin_cells(settings) * quanta(settings.cell_m) * QUANTUM_M


def surfaces(
    table: PointTable, cell: Bounds, settings: ProductSettings
) -> dict[str, NDArray[np.float32]]:
    """Rasters of one ground cell.

    Parameters
    ----------
    table : PointTable
        Points of the cell and of a margin of at least :func:`reach_m`, in any order, with
        :data:`COLUMNS_NEEDED`; points farther out are ignored.
    cell : Bounds
        The ground cell [quanta]; its edges are whole multiples of the raster cell.

    Returns
    -------
    dict of str to (rows, cols) float32
        ``dtm, dsm, chm`` [m], ``dtm_quality`` (standard deviation of ``dtm`` [m]), ``intensity``
        (mean of first returns, as delivered; where the points have it), ``density`` (signal
        returns per m2; 0 where there are none, nodata where nothing was flown); row 0 is the
        northernmost; nodata
        :data:`~spl_batch.constants.NODATA`.
    """
    size = quanta(settings.cell_m)
    if any(edge % size for edge in cell):
        raise ValueError(f"ground cell {cell} is not aligned to raster cells of {size} quanta")
    dtm, sigma = _terrain(table, cell, settings)
    signal, level = _signal(table, cell, settings)
    wide, near = (grow(cell, n * size) for n in (margin_cells(settings), _top_margin(settings)))
    support = _support(noise_by_cell(table, wide, near, size), settings)
    dsm = _top_surface(signal, level, support, cell, settings)
    dsm = np.where(dsm < dtm, dtm, dsm)
    rasters = {"dtm": dtm * QUANTUM_M, "dsm": dsm * QUANTUM_M, "chm": (dsm - dtm) * QUANTUM_M}
    rasters["dtm_quality"] = np.where(np.isnan(dtm), np.nan, sigma)
    rasters |= _counts(signal, cell, size)
    over = flown(table, cell, settings, margin_cells(settings)) | (rasters["density"] > 0)
    rasters["density"] = np.where(over, rasters["density"], np.nan)
    return {name: _delivered(values) for name, values in rasters.items()}


def _delivered(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """North up, nodata for NaN."""
    north_up = np.where(np.isnan(values), NODATA, values)[::-1]
    return np.ascontiguousarray(north_up, dtype=np.float32)


def _shape(bounds: Bounds, size: int) -> tuple[int, int]:
    return (bounds.ymax - bounds.ymin) // size, (bounds.xmax - bounds.xmin) // size


def cell_number(table: PointTable, bounds: Bounds, size: int) -> NDArray[np.int64]:
    """Number of the raster cell of each point within bounds, row by row from the south-west."""
    number = np.empty(len(table), np.int64)
    corner, cols = (bounds.xmin, bounds.ymin), _shape(bounds, size)[1]
    number_cells(table["x"], table["y"], corner, float(size), cols, number)
    return number


def _local(
    table: PointTable, order: NDArray[np.intp], corner: Bounds
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Sorted coordinates relative to a corner: three (n,) int32 [quanta]."""
    return (
        (table["x"].take(order) - corner.xmin).astype(np.int32),
        (table["y"].take(order) - corner.ymin).astype(np.int32),
        table["z"].take(order),
    )


def _terrain(
    table: PointTable, cell: Bounds, settings: ProductSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """DTM [quanta] and its standard deviation [m] from the south; NaN in voids."""
    size = quanta(settings.cell_m)
    wide = grow(cell, margin_cells(settings) * size)
    found = (table["ground"] == 1) & inside(table["x"], table["y"], wide)
    ground = flattened(table.select(("x", "y", "z", "flags")).take(found))
    rows, cols = _shape(wide, size)
    order, start = sort_into_cells(cell_number(ground, wide, size), ground["z"], rows * cols)
    means = np.empty((rows * cols, 3))
    robust_cell_means(_local(ground, order, wide), start, GROUND_FLOOR_M / QUANTUM_M, means)
    margin = margin_cells(settings)
    sigma = terrain_sigma(means.reshape(rows, cols, 3) * QUANTUM_M, settings.cell_m)
    vertices = means[~np.isnan(means[:, 2])]
    vertices = np.concatenate([vertices, _covered_corners(table, wide, vertices, size)])
    vertices[:, :2] -= wide.xmax - cell.xmax
    dtm = tin_raster(vertices, size, _shape(cell, size), quanta(settings.void_max_m))
    return dtm, sigma[margin:-margin, margin:-margin]


def _covered_corners(
    table: PointTable, wide: Bounds, vertices: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Vertices for corners of an area that have returns but no ground: (k, 3) [quanta].

    A hall or a lake wider than the margin may hide the ground around a corner. The triangles would
    end at its rim, and cells in it that lie near enough to ground would stay void. The corner is as
    high as the nearest vertex, which counts only for the slope of those cells; where nothing was
    returned the survey ends, and so do the triangles.
    """
    near, found = CORNER_CELLS * size, []
    for west in (0, wide.xmax - wide.xmin):
        beside = None
        for south in (0, wide.ymax - wide.ymin):
            corner = west, south
            away = np.abs(vertices[:, :2] - corner).max(axis=1)
            if not len(away) or away.min() <= near:
                continue
            if beside is None:
                beside = np.flatnonzero(np.abs(table["x"] - (wide.xmin + west)) <= near)
            held = beside[np.abs(table["y"][beside] - (wide.ymin + south)) <= near]
            returns = table.select(("x", "y", "noise_class", "flags")).take(held)
            signal = inside(returns["x"], returns["y"], wide)
            signal &= returns["noise_class"] == NOISE_SIGNAL
            if (signal & ~returns.has(EXCLUDED | PointFlag.OUTSIDE_AOI)).any():
                distance2 = ((vertices[:, :2] - corner) ** 2).sum(axis=1)
                found.append([*corner, vertices[distance2.argmin(), 2]])
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def _signal(
    table: PointTable, cell: Bounds, settings: ProductSettings
) -> tuple[PointTable, NDArray[np.uint8]]:
    """Returns that surfaces are made of, and their level: 0 assessed signal, 1 not assessed."""
    size = quanta(settings.cell_m)
    near = grow(cell, _top_margin(settings) * size)
    noise_class = table["noise_class"]
    usable = (noise_class == NOISE_SIGNAL) | (noise_class == NOISE_NOT_ASSESSED)
    usable &= ~table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)
    usable &= inside(table["x"], table["y"], near)
    also = (name for name in (*COLUMNS_OF_INTENSITY, "afterpulse") if name in table)
    signal = table.select((*COLUMNS_NEEDED, *also)).take(usable)
    level = (signal["noise_class"] == NOISE_NOT_ASSESSED).astype(np.uint8)
    if not level.any():
        return signal, level
    rows, cols = _shape(near, size)
    number = cell_number(signal, near, size)
    assessed = np.bincount(number[level == 0], minlength=rows * cols) > 0
    kept = (level == 0) | ~assessed[number]
    return signal.take(kept), level[kept]


def _void_cells(settings: ProductSettings) -> int:
    return quanta(settings.dsm_void_max_m) // quanta(settings.cell_m)


def _cells(length_m: float, settings: ProductSettings) -> int:
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
    return _cells(2.0 * settings.dsm_support_m, settings) + 1


def _top_margin(settings: ProductSettings) -> int:
    """Raster cells around a ground cell that its DSM looks at [count]."""
    return _void_cells(settings) + _support_cells(settings)


def _critical(expected: float, settings: ProductSettings) -> int:
    """Smallest count that noise alone reaches rarely enough, and ``dsm_support`` at least."""
    count = settings.dsm_support
    # pdtrc(k - 1, m) = P(K >= k); it is 0 for m = 0 and k > 0.
    while count > 0 and pdtrc(count - 1, expected) > settings.dsm_false_alarm:
        count += 1
    return count


def _support(noise: NDArray[np.float64], settings: ProductSettings) -> Support:
    """What confirms a return, given the noise around each raster cell [1/m3]."""
    radii_m = _scales_m(settings)
    densities, row = np.unique(noise, return_inverse=True)
    expected = [[4.0 / 3.0 * np.pi * per_m3 * r**3 for r in radii_m] for per_m3 in densities]
    return Support(
        radius=np.array([quanta(radius_m) for radius_m in radii_m]),
        needed=np.array([[_critical(count, settings) for count in counts] for counts in expected]),
        noise=row,
        neighbours=settings.dsm_spacing_neighbours,
        peer_ratio=settings.dsm_peer_ratio,
    )


def _top_surface(
    signal: PointTable,
    level: NDArray[np.uint8],
    support: Support,
    cell: Bounds,
    settings: ProductSettings,
) -> NDArray[np.float64]:
    """DSM from the south, small voids filled [quanta]; NaN in the larger ones."""
    size = quanta(settings.cell_m)
    near = grow(cell, _top_margin(settings) * size)
    rows, cols = _shape(near, size)
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
    filled = np.empty_like(tops)
    fill_voids(tops, ring_offsets(settings.dsm_void_max_m / settings.cell_m), filled)
    void = _void_cells(settings)
    return filled[void : filled.shape[0] - void, void : filled.shape[1] - void]


def _tops(signal: PointTable, near: Bounds, size: int, support: Support) -> NDArray[np.float64]:
    """Highest confirmed return of each raster cell, row by row [quanta]; NaN without any."""
    rows, cols = _shape(near, size)
    order, start = sort_into_cells(cell_number(signal, near, size), signal["z"], rows * cols)
    xyz = np.stack(_local(signal, order, near), axis=1)
    tops = np.empty(rows * cols)
    confirmed_tops(xyz, signal["ground"][order] == 1, start, (cols, size), support, tops)
    lifted = np.empty((rows, cols))
    z = np.ascontiguousarray(xyz[:, 2])
    lift_pits(z, start, tops.reshape(rows, cols), PIT_M / QUANTUM_M, lifted)
    return lifted.ravel()


def _counts(signal: PointTable, cell: Bounds, size: int) -> dict[str, NDArray[np.float64]]:
    """Signal returns per m2, and mean intensity of the first returns (NaN without any)."""
    needed = signal.select([n for n in ("x", "y", *COLUMNS_OF_INTENSITY) if n in signal])
    core = needed.take(inside(signal["x"], signal["y"], cell))
    shape = _shape(cell, size)
    cells = shape[0] * shape[1]
    number = cell_number(core, cell, size)
    density = np.bincount(number, minlength=cells) / (size * QUANTUM_M) ** 2
    if "intensity" not in core:
        return {"density": density.reshape(shape)}
    first = core["return_number"] <= 1
    number = number[first]
    # Sums of whole numbers below 2**53 are exact in float64, in any order.
    total = np.bincount(number, weights=core["intensity"][first], minlength=cells)
    count = np.bincount(number, minlength=cells)
    mean = np.divide(total, count, out=np.full(cells, np.nan), where=count > 0)
    return {"intensity": mean.reshape(shape), "density": density.reshape(shape)}
