"""Hydro-flattening: terrain and surface in lakes and rivers are those of breaklines.

Domain: space. Source: USGS Lidar Base Specification, Digital Elevation Model Surface Treatments,
Hydro-Flattening. Lakes are flat and level. Rivers are level from bank to bank, at right angles to
their centre line, and nowhere rise downstream; where a line rises, the water stays as low as it was
(a running minimum), so that it lies at or below what was drawn. Islands are holes of the polygons.
Terrain outside is not touched: no hydro-enforcement, single lines do nothing.

A cell belongs to a water where its centre lies inside; of several the lowest counts. Its height
depends on its centre alone, so no tiling changes it. Where nobody flew, which is where density has
no value, voids stay; terrain that reaches over water there, as triangles do off the edge of a
swath, becomes water like all other.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter

from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.formats.breaklines import Water
from spl_batch.lattice.tiles import Bounds

ABOVE_M: Final = 0.25
"""Water that stands higher than the terrain beside it by more than this floods its bank [m]."""

FLOODED_SHARE: Final = 0.05
"""Share of its bank that water may flood without a warning, 0..1."""

Raster = NDArray[np.float32]


class Banks(NamedTuple):
    """Cells beside water; counts of several regions add up."""

    cells: int
    #: Cells of terrain beside water; those lower than it by more than :data:`ABOVE_M` [count].
    banks: int
    flooded: int


def water_heights(waters: Iterable[Water], core: Bounds, shape: tuple[int, int]) -> Raster:
    """Height of the water in each raster cell of a region.

    Parameters
    ----------
    core : Bounds
        The region [quanta].
    shape : (int, int)
        Its rows and columns of cells.

    Returns
    -------
    (rows, cols) float32
        North up [m]; nodata where there is none.
    """
    rows, columns = shape
    size = (core.xmax - core.xmin) / columns * QUANTUM_M
    east = core.xmin * QUANTUM_M + (np.arange(columns) + 0.5) * size
    north = core.ymax * QUANTUM_M - (np.arange(rows) + 0.5) * size
    heights = np.full(shape, np.inf)
    for water in waters:
        west, south, right, top = shapely.bounds(water.area)
        j = np.flatnonzero((east >= west) & (east <= right))
        i = np.flatnonzero((north >= south) & (north <= top))
        if not len(i) or not len(j):
            continue
        x, y = np.meshgrid(east[j], north[i])
        shapely.prepare(water.area)
        row, column = np.nonzero(shapely.contains_xy(water.area, x, y))
        level = _levels(water, x[row, column], y[row, column])
        at = i[row], j[column]
        heights[at] = np.minimum(heights[at], level)
    return np.where(np.isinf(heights), NODATA, heights).astype(np.float32)


def _levels(water: Water, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of a lake, or of a river at the nearest place of the nearest of its lines."""
    if water.level_m is not None:
        return np.full(len(x), water.level_m)
    points = shapely.points(x, y)
    away = np.stack([shapely.distance(line.line, points) for line in water.lines])
    nearest = away.argmin(axis=0)
    found = np.empty(len(x))
    for k, line in enumerate(water.lines):
        mine = nearest == k
        at = shapely.line_locate_point(line.line, points[mine])
        found[mine] = np.interp(at, line.along, line.z)
    return found


def flatten(rasters: dict[str, Raster], water: Raster) -> Banks:
    """Put water into the terrain and what rests on it.

    Parameters
    ----------
    rasters : dict of str to (rows, cols) float32
        ``dtm, dsm, chm, dtm_quality`` of a ground cell; are changed where its ``density`` shows
        that it was flown, and where ``dtm`` has a height all the same. A surface lies nowhere below
        the water; how well a breakline is known is not stated, so that ``dtm_quality`` is void.
    water : (rows, cols) float32
        From :func:`water_heights`.
    """
    held = rasters["dtm"] != np.float32(NODATA)
    wet = (water != np.float32(NODATA)) & (held | (rasters["density"] != np.float32(NODATA)))
    dry = held & ~wet
    banks = dry & binary_dilation(wet, np.ones((3, 3), np.bool_))
    # The highest water of the eight cells around each, lower than everything without any.
    beside = maximum_filter(np.where(wet, water, -np.inf), 3, mode="constant", cval=-np.inf)
    flooded = banks & (rasters["dtm"] < beside - ABOVE_M)
    rasters["dtm"] = np.where(wet, water, rasters["dtm"])
    # Nodata is lower than every water.
    rasters["dsm"] = np.where(wet, np.maximum(rasters["dsm"], water), rasters["dsm"])
    rasters["chm"] = np.where(wet, rasters["dsm"] - water, rasters["chm"])
    rasters["dtm_quality"] = np.where(wet, np.float32(NODATA), rasters["dtm_quality"])
    return Banks(*(int(np.count_nonzero(cells)) for cells in (wet, banks, flooded)))


def bank_findings(found: Iterable[Sequence[int]]) -> Iterator[Finding]:
    """Breaklines that do not fit the terrain.

    ``found``: iterable of (int, int, int), :class:`Banks` of each ground cell that was flattened.
    """
    listed = list(found)
    if not listed:
        return
    cells, banks, flooded = np.sum(listed, axis=0).tolist()
    if not cells:
        yield Finding("G04", {"kind": "none"})
    elif flooded > FLOODED_SHARE * banks:
        values = {"kind": "flooded", "above_m": ABOVE_M, "count": flooded, "of": banks}
        yield Finding("G04", values)
