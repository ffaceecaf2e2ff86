r"""Terrain, surface, height, density and intensity rasters of one ground cell.

Domain: space. A ground cell is an absolute square whose edge is a whole multiple of the raster
cell. It and a fixed margin around it decide its rasters, whatever tile, block or task computes
them.

====== ========================================================================
DTM    TIN through one vertex per raster cell, evaluated at cell centres: the robust
       mean (x, y, z) of its ground returns. Through single returns a TIN would keep
       the spread of a range (5 cm); means of positions too keep slopes unbiased. Across
       gaps thin plates go on with the slopes of the rim
       (:mod:`~spl_batch.airborne.products.gap_surface`). Terrain ends where its ground does: the
       outside reaches over edges longer than ``edge_max_m``, 15 of the ground's spacings by
       default. Near ground neither is farther off the nearest returns than their spread. In
       water polygons ground returns are put on the water's level first
       (:mod:`~spl_batch.airborne.ground.water.level`).
DSM    Highest return of the cell that is ground or that its peers confirm: more of
       them in a sphere than noise alone puts there, spheres from ``dsm_near_m`` to
       ``dsm_support_m`` in turn (:mod:`spl_batch.airborne.products.top_surface`).
       That noise is what the filter expects; where none is known,
       ``dsm_support`` returns do. A wire of few returns per metre stands out of the
       DSM only where there is little noise. In a pit, more than 2 m below most cells
       around, the highest return up to their level needs no peers. Where none is
       ground or confirmed, nor does the highest up to the level of two of them.
       Never below the DTM. A cell without such a return takes the nearest value
       within ``dsm_void_max_m``, of several the lowest, where there is terrain.
CHM    DSM - DTM, hence >= 0; nodata where either is.
sigma  Standard deviation of the DTM, by how far the nearest ground is, what that distance costs
       around, and the layer that ground returns fill, and by what the nearest returns correct
       (:mod:`~spl_batch.airborne.products.terrain_quality`).
====== ========================================================================

Returns that the filter has not assessed (no beam; or no filter at all) take part in a raster cell
only where it holds no assessed signal.
"""

from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.water.level import REACH_M, flattened, in_water, water_levels
from spl_batch.airborne.products.cell_values import (
    by_cell,
    cell_number,
    north_up,
    robust_cell_means,
    shape_of,
)
from spl_batch.airborne.products.flown_cells import about_ground, covered_cells
from spl_batch.airborne.products.gap_surface import FAR_M, bridged
from spl_batch.airborne.products.terrain_quality import Scatter, scatter_of, terrain_sigma
from spl_batch.airborne.products.top_surface import (
    cells_within,
    support_of,
    top_margin,
    top_surface,
)
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NOISE_NOT_ASSESSED, NOISE_SIGNAL, QUANTUM_M
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta, shared
from spl_batch.numerics.nearest_heights import nearest_heights
from spl_batch.numerics.triangulation.tin_raster import tin_raster

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class", "ground", "flags")
"""Columns that :func:`surfaces` reads, and :data:`OPTIONAL` ones."""

COLUMNS_OF_INTENSITY: Final = ("intensity", "return_number")
"""Columns that it reads where they are there, for a raster of what was delivered."""

OPTIONAL: Final = (*COLUMNS_OF_INTENSITY, "afterpulse", "noise_density")
"""All that it reads where it is there: what the time domain and the filter give."""

NEAR_M: Final = 2.0
"""A cell with ground returns no farther from its centre is as high as the nearest of them [m]. Half
moves nothing, twice 3 + 0 cells of its sigma."""

OFF_M: Final = 0.5
"""Terrain that is off by more is wrong: less beyond the range of the nearest ground and what its
slope explains is left to the surface [m]."""

CORNER_CELLS: Final = 3
"""Returns so near to a corner of the area that is read cover it [raster cells]. Without, a hall
that is wider than the margin leaves a void in the terrain near its walls."""


def margin_cells(settings: ProductSettings) -> int:
    """Raster cells around a ground cell whose points decide its rasters [count]."""
    ground_m = max(2.0 * settings.void_max_m, REACH_M)
    return max(cells_within(ground_m, settings), top_margin(settings))


def reach_m(settings: ProductSettings) -> float:
    """Width of the margin that :func:`surfaces` reads around a ground cell [m].

    Twice the widest void that is interpolated over, as the ground on its far side counts, and no
    less than what the level of water is taken from.
    """
    return margin_cells(settings) * quanta(settings.cell_m) * QUANTUM_M


def surfaces(
    table: PointTable, cell: Bounds, settings: ProductSettings, range_sigma_m: float
) -> dict[str, NDArray[np.float32]]:
    """Rasters of one ground cell.

    Parameters
    ----------
    table : PointTable
        Points of the cell and of a margin of at least :func:`reach_m`, in any order, with
        :data:`COLUMNS_NEEDED`; points farther out are ignored.
    cell : Bounds
        The ground cell [quanta]; its edges are whole multiples of the raster cell.
    settings : ProductSettings
        Cell size and distances.
    range_sigma_m : float
        Spread of the sensor's ranges, one sigma [m].

    Returns
    -------
    dict of str to (rows, cols) float32
        ``dtm, dsm, chm`` [m], ``dtm_quality`` (standard deviation of ``dtm`` [m]),
        ``intensity`` (mean of first returns, as delivered; where the points have it),
        ``density`` (signal returns per m2; 0 where there are none, nodata where nothing was
        flown); row 0 is the northernmost; nodata :data:`~spl_batch.constants.NODATA`.
    """
    return _Surfaces(table, cell, settings, range_sigma_m).rasters()


class _Surfaces:
    """Rasters of one ground cell; see :func:`surfaces`."""

    def __init__(
        self, table: PointTable, cell: Bounds, settings: ProductSettings, range_sigma_m: float
    ) -> None:
        size = quanta(settings.cell_m)
        if any(edge % size for edge in cell):
            raise ValueError(f"ground cell {cell} is not aligned to raster cells of {size} quanta")
        self._cell, self._settings, self._size = cell, settings, size
        # Ground returns within three standard deviations of a range are no outliers.
        self._floor_m = 3.0 * range_sigma_m
        self.region = grow(cell, margin_cells(settings) * size)
        self._table = table
        near = (table["ground"] == 1) & inside(table["x"], table["y"], self.region)
        ground = table.select(("x", "y", "z", "flags")).take(near)
        # Under a deck what is left of the water may hang together with no other.
        self._ground = flattened(ground, water_levels(*in_water(ground)[1], beyond=True))

    def rasters(self) -> dict[str, NDArray[np.float32]]:
        """Rasters as :func:`surfaces` returns them."""
        table, cell, settings, size = self._table, self._cell, self._settings, self._size
        signal, level = _signal(table, cell, settings)
        near = grow(cell, top_margin(settings) * size)
        support = support_of(_noise_aloft(signal, near, size), settings)
        dsm, lent = top_surface(signal, level, support, cell, settings)
        ground = self._means()
        dtm, sigma = self._terrain(near, *ground)
        dsm[lent & np.isnan(dtm)] = np.nan
        dsm = np.where(dsm < dtm, dtm, dsm)
        rasters = {"dtm": dtm * QUANTUM_M, "dsm": dsm * QUANTUM_M, "chm": (dsm - dtm) * QUANTUM_M}
        rasters["dtm_quality"] = np.where(np.isnan(dtm), np.nan, sigma)
        rasters |= _counts(signal, cell, size)
        over = self._flown(ground[0]) | (rasters["density"] > 0)
        rasters["density"] = np.where(over, rasters["density"], np.nan)
        return {name: north_up(values) for name, values in rasters.items()}

    def _flown(self, means: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Raster cells of the ground cell that were flown."""
        table, ground = self._table, means[~np.isnan(means[:, 2])]
        there = about_ground(table, self.region, ground, self._size)
        return covered_cells(table["x"][there], table["y"][there], self._cell, self._settings)

    def _means(self) -> tuple[NDArray[np.float64], Scatter, NDArray[np.bool_]]:
        """Robust means and scatter of the ground of raster cells, and which of them are wet."""
        rows, cols = shape_of(self.region, self._size)
        place, start, _ = by_cell(self._ground, self.region, self._size)
        means = np.empty((rows * cols, 3))
        robust_cell_means(place, start, self._floor_m / QUANTUM_M, means)
        held = start[1:] > start[:-1]
        scatter = Scatter(np.zeros(rows * cols, np.int32), np.zeros((rows * cols, 6), np.float32))
        for whole, found in zip(scatter, scatter_of(place, start, QUANTUM_M), strict=True):
            whole[held] = found
        wet = np.zeros(rows * cols, np.bool_)
        of_water = self._ground.take(self._ground.has(PointFlag.WATER))
        wet[cell_number(of_water, self.region, self._size)] = True
        return means, scatter, wet

    def _terrain(
        self, near: Bounds, means: NDArray[np.float64], scatter: Scatter, wet: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """DTM [quanta] and its standard deviation [m] from the south; NaN in voids."""
        cell, size, settings = self._cell, self._size, self._settings
        margin, (rows, cols) = margin_cells(settings), shape_of(self.region, size)
        scatter = Scatter(*(v.reshape(rows, cols, *v.shape[1:]) for v in scatter))
        sigma = terrain_sigma(means.reshape(rows, cols, 3) * QUANTUM_M, settings.cell_m, scatter)
        vertices = means[~np.isnan(means[:, 2])]
        vertices = np.concatenate([vertices, self._covered_corners(vertices)])
        vertices[:, :2] -= self.region.xmax - cell.xmax
        reach, longest = quanta(settings.void_max_m), settings.edge_max_m
        longest = None if longest is None else longest / QUANTUM_M
        dtm = tin_raster(vertices, size, shape_of(cell, size), reach, longest, margin * size)
        corner = self.region.ymin // size, self.region.xmin // size
        far = FAR_M / settings.cell_m
        dtm = bridged(dtm, means.reshape(rows, cols, 3), wet.reshape(rows, cols), size, far, corner)
        sigma = sigma[margin:-margin, margin:-margin]
        # fmin and fmax pass over cells without returns near.
        low, high = self._honoured(near, shape_of(cell, size))
        misfit = np.fmax(np.fmax(low - dtm, dtm - high), 0.0) * QUANTUM_M
        dtm = np.where(misfit > OFF_M, np.clip(dtm, low, high), dtm)
        return dtm, np.maximum(sigma, misfit)

    def _honoured(self, near: Bounds, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Least and most that the ground within :data:`NEAR_M` allows, else NaN: (2, ., .)."""
        ground = self._ground.take(inside(self._ground["x"], self._ground["y"], near))
        rows, cols = shape_of(near, self._size)
        places, start, _ = by_cell(ground, near, self._size)
        lattice, found = (cols, (rows - shape[0]) // 2, self._size), np.empty((2, *shape))
        nearest_heights(places, start, lattice, float(quanta(NEAR_M)), found)
        return found

    def _has_signal(self, region: Bounds) -> bool:
        """Whether a part of the area holds signal."""
        there = inside(self._table["x"], self._table["y"], shared(region, self.region))
        returns = self._table.select(("noise_class", "flags")).take(there)
        signal = returns["noise_class"] == NOISE_SIGNAL
        signal &= ~returns.has(EXCLUDED | PointFlag.OUTSIDE_AOI)
        return bool(signal.any())

    def _covered_corners(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vertices for corners of an area that have returns but no ground: (k, 3) [quanta].

        A hall or a lake wider than the margin may hide the ground around a corner. The triangles
        would end at its rim, and cells in it that lie near enough to ground would stay void. The
        corner is as high as the nearest vertex, which counts only for the slope of those cells;
        where nothing was returned the survey ends, and so do the triangles.
        """
        near, wide, found = CORNER_CELLS * self._size, self.region, []
        for x, y in product((wide.xmin, wide.xmax), (wide.ymin, wide.ymax)):
            corner = x - wide.xmin, y - wide.ymin
            off = vertices[:, :2] - corner
            bare = len(off) and np.abs(off).max(axis=1).min() > near
            if bare and self._has_signal(grow(Bounds(x, y, x + 1, y + 1), near)):
                found.append([*corner, vertices[(off**2).sum(axis=1).argmin(), 2]])
        return np.array(found, dtype=np.float64).reshape(-1, 3)


def _signal(
    table: PointTable, cell: Bounds, settings: ProductSettings
) -> tuple[PointTable, NDArray[np.uint8]]:
    """Returns that surfaces are made of, and their level: 0 assessed signal, 1 not assessed."""
    size = quanta(settings.cell_m)
    near = grow(cell, top_margin(settings) * size)
    noise_class = table["noise_class"]
    usable = (noise_class == NOISE_SIGNAL) | (noise_class == NOISE_NOT_ASSESSED)
    usable &= ~table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)
    usable &= inside(table["x"], table["y"], near)
    also = (name for name in OPTIONAL if name in table)
    signal = table.select((*COLUMNS_NEEDED, *also)).take(usable)
    level = (signal["noise_class"] == NOISE_NOT_ASSESSED).astype(np.uint8)
    if not level.any():
        return signal, level
    rows, cols = shape_of(near, size)
    number = cell_number(signal, near, size)
    assessed = np.bincount(number[level == 0], minlength=rows * cols) > 0
    kept = (level == 0) | ~assessed[number]
    return signal.take(kept), level[kept]


def _noise_aloft(signal: PointTable, near: Bounds, size: int) -> NDArray[np.float64]:
    """Most noise that is expected at a return of each raster cell, row by row [1/m3].

    Where none is known it is the most that is known around; 0 without any.
    """
    rows, cols = shape_of(near, size)
    found = np.full(rows * cols, -1.0)
    if "noise_density" in signal:
        expected = signal["noise_density"]
        known = np.isfinite(expected)
        np.maximum.at(found, cell_number(signal, near, size)[known], expected[known])
    return np.where(found < 0.0, found.max(initial=0.0), found)


def _counts(signal: PointTable, cell: Bounds, size: int) -> dict[str, NDArray[np.float64]]:
    """Signal returns per m2; mean intensity of first returns, of all in a cell without; or NaN."""
    needed = signal.select([n for n in ("x", "y", "z", *COLUMNS_OF_INTENSITY) if n in signal])
    core = needed.take(inside(signal["x"], signal["y"], cell))
    shape = shape_of(cell, size)
    cells = shape[0] * shape[1]
    number = cell_number(core, cell, size)
    density = np.bincount(number, minlength=cells) / (size * QUANTUM_M) ** 2
    found = {"density": density.reshape(shape)}
    if "intensity" not in core:
        return found
    first = core["return_number"] <= 1
    first |= np.bincount(number[first], minlength=cells)[number] == 0
    number = number[first]
    # Sums of whole numbers below 2**53 are exact in float64, in any order.
    total = np.bincount(number, weights=core["intensity"][first], minlength=cells)
    count = np.bincount(number, minlength=cells)
    mean = np.divide(total, count, out=np.full(cells, np.nan), where=count > 0)
    return found | {"intensity": mean.reshape(shape)}
