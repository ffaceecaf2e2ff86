"""Raster minus reference, by class of surface.

The DTM is compared at every reference ground point, bilinearly between cell centres; the
DSM cell by cell with the highest reference return of the cell, because a highest return
per cell is what it is.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.accuracy.error_tally import STEPS_PER_M
from spl_batch.airborne.accuracy.raster_and_reference import Raster, Reference
from spl_batch.constants import CLASS_BUILDING, CLASS_GROUND, CLASS_WATER
from spl_batch.formats.rasters.parts import Grid, known
from spl_batch.numerics.neighbours.point_grid import PointGrid

OPEN_M: Final = 2.0
"""Open ground has nothing tall within this distance [m]."""

TALL_M: Final = 0.5
"""Reference points higher than this above the nearest reference ground are tall [m]."""

CANOPY_M: Final = 2.0
"""Vegetation this far above a ground point within 1 m makes it ground under canopy [m]."""

RETURNS_M: Final = 0.5
"""Kept returns are compared with a reference return no farther off, along and up [m]."""

SLOPE_EDGES_DEG: Final = (0, 5, 15, 30, 90)
"""Classes of terrain slope [deg]."""

Differences = dict[str, NDArray[np.float32]]
"""Raster minus reference [m] by class of surface; ``all`` holds every one."""


def ground_differences(dtm: Raster, reference: Reference) -> NDArray[np.float64]:
    """DTM minus reference at each ground point [m], those of the margin too; NaN on voids."""
    points, _ = _ground(reference.without_noise())
    return dtm.bilinear(points[:, :2]) - points[:, 2]


def _ground(reference: Reference) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ground points (g, 3) of a reference without noise [m], and whether each counts: (g,)."""
    ground = reference.classification == CLASS_GROUND
    return reference.xyz_m[ground], reference.counts[ground]


def terrain_differences(
    dtm: Raster,
    reference: Reference,
    *,
    chm: Raster | None = None,
    at_ground_m: NDArray[np.float64] | None = None,
) -> Differences:
    """DTM minus reference ground points, by class of surface.

    ``all``; ``open_ground``: no reference point more than 0.5 m above the ground within 2 m, no
    surface 0.5 m above both the terrain and the point; ``under_canopy``: vegetation 2 m or more
    above it within 1 m; and ``slope_0_5``, ``slope_5_15``, ... in degrees. ``reference``: all
    classes, those that are not ground show what stands on it; ``chm``: what is no open ground
    stands out in it, and above the reference; ``at_ground_m``: :func:`ground_differences`, where
    they are known.
    """
    reference = reference.without_noise()
    points, counts = _ground(reference)
    is_open, canopy = _cover(reference)
    difference = ground_differences(dtm, reference) if at_ground_m is None else at_ground_m
    if chm is not None:
        height = chm.at(points[:, :2])
        over = height + dtm.at(points[:, :2]) - points[:, 2]
        # Ground that the terrain cuts off stands above the terrain, but not above itself. A void
        # CHM shows nothing against open ground.
        is_open &= ~((height >= TALL_M) & (over >= TALL_M))
    classes = {
        "all": np.ones(len(points), np.bool_),
        "open_ground": is_open,
        "under_canopy": canopy,
    }
    slope = dtm.slope_deg().at(points[:, :2])
    for low, high in itertools.pairwise(SLOPE_EDGES_DEG):
        classes[f"slope_{low}_{high}"] = (slope >= low) & (slope < high)
    used = counts & np.isfinite(difference)
    return _by_class(difference, classes, used)


def _cover(reference: Reference) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which ground points are open, and which lie under vegetation: two (g,) bool."""
    points, _ = _ground(reference)
    others = ~np.isin(reference.classification, (CLASS_GROUND, CLASS_WATER))
    if not len(points) or not others.any():
        return np.ones(len(points), np.bool_), np.zeros(len(points), np.bool_)
    above = reference.xyz_m[others]
    foot = PointGrid.of(points).nearest(above)[:, 0]
    height = above[:, 2] - points[foot, 2]
    plants = reference.classification[others] != CLASS_BUILDING
    return (
        ~_near(points, above[height > TALL_M], OPEN_M),
        _near(points, above[plants & (height >= CANOPY_M)], 1.0),
    )


def _near(
    points: NDArray[np.float64], others: NDArray[np.float64], radius_m: float
) -> NDArray[np.bool_]:
    """Which points have one of the others nearer than this, horizontally: (n,) bool."""
    if not len(others):
        return np.zeros(len(points), np.bool_)
    return PointGrid.of(others).nearest(points, reach=radius_m)[:, 0] >= 0


def surface_differences(dsm: Raster, reference: Reference) -> Differences:
    """DSM minus the highest reference return of each cell, by class of surface.

    ``all``; ``ground``, ``water``, ``building`` (roofs: the cell and its eight neighbours),
    ``building_edge`` (the other cells topped by a building), ``vegetation`` (all else), by the
    class of the highest reference point. A cell counts where that point does.
    """
    reference = reference.without_noise()
    row, col, held = dsm.grid.place(reference.xyz_m[:, :2])
    rows, cols = dsm.values.shape
    picked = np.flatnonzero(held)
    cell = row[picked] * cols + col[picked]
    highest = np.full(rows * cols, -1, np.intp)
    # The last that is put into a cell stays; equal heights are settled by class.
    order = np.lexsort((reference.classification[picked], reference.xyz_m[picked, 2]))
    highest[cell[order]] = picked[order]
    cell = np.flatnonzero(highest >= 0)
    top = highest[cell]
    surface = known(dsm.values.ravel()[cell])
    kind = reference.classification[top]
    roof = np.zeros((rows + 2, cols + 2), np.bool_)
    r, c = cell // cols + 1, cell % cols + 1
    roof[r, c] = kind == CLASS_BUILDING
    inner = np.ones(len(cell), np.bool_)
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            inner &= roof[r + dr, c + dc]
    building = kind == CLASS_BUILDING
    classes = {
        "all": np.ones(len(cell), np.bool_),
        "ground": kind == CLASS_GROUND,
        "water": kind == CLASS_WATER,
        "building": inner,
        "building_edge": building & ~inner,
        "vegetation": ~np.isin(kind, (CLASS_GROUND, CLASS_WATER, CLASS_BUILDING)),
    }
    difference = surface - reference.xyz_m[top, 2]
    return _by_class(difference, classes, reference.counts[top] & np.isfinite(difference))


def return_differences(
    clouds: Iterable[NDArray[np.float64]], reference: Reference
) -> Iterator[Differences]:
    """Kept returns minus the reference's nearest ground or roof, as [W17 5.4] compares filters.

    ``clouds``: (n, 3) float64 each, returns [m]; they are held one after the other. Of each:
    ``ground``, ``building``: of the returns within :data:`RETURNS_M` of a reference point of that
    class, horizontally and in height.
    """
    known = reference.without_noise()
    grids: dict[str, tuple[NDArray[np.float64], PointGrid | None]] = {}
    for name, code in (("ground", CLASS_GROUND), ("building", CLASS_BUILDING)):
        points = known.xyz_m[known.classification == code]
        grids[name] = points, PointGrid.of(points) if len(points) else None
    for xyz_m in clouds:
        out: Differences = {}
        for name, (points, grid) in grids.items():
            out[name] = np.empty(0, np.float32)
            if grid is not None:
                nearest = grid.nearest(xyz_m, reach=RETURNS_M)[:, 0]
                near = nearest >= 0
                off = xyz_m[near, 2] - points[nearest[near], 2]
                out[name] = off[np.abs(off) <= RETURNS_M].astype(np.float32)
        yield out


def _by_class(
    difference: NDArray[np.float64],
    classes: Mapping[str, NDArray[np.bool_]],
    used: NDArray[np.bool_],
) -> Differences:
    return {name: difference[mask & used].astype(np.float32) for name, mask in classes.items()}


def difference_sums(
    at_ground_m: NDArray[np.float64], reference: Reference, grid: Grid
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """DTM minus reference ground that counts, added up over the points of each cell of a map.

    Cells that hold a point, counted row by row; sum of the differences [0.1 mm], so that sums of
    several places do not depend on their order; points [count]. The DTM is taken at each point, so
    slopes leave no trace.
    """
    points, counts = _ground(reference.without_noise())
    row, col, held = grid.place(points[:, :2])
    used = held & counts & np.isfinite(at_ground_m)
    steps = np.rint(at_ground_m[used] * STEPS_PER_M).astype(np.int64)
    cell, place = np.unique(row[used] * grid.columns + col[used], return_inverse=True)
    total = np.zeros(len(cell), np.int64)
    np.add.at(total, place, steps)
    return cell, total, np.bincount(place, minlength=len(cell)).astype(np.int64)
