"""Points against the known scene: what [M20 ch. 5] looks at, as numbers.

Points are relative to the scene's centre and ground [m].
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.geiger.coincidence.scene_distances import heights_below, surface_distance
from spl_batch.geiger.coincidence.scene_rays import Targets
from spl_batch.geiger.coincidence.simulate import (
    POSITIONS_M,
    SPOKE_RADIUS_M,
    TARGET_HEIGHT_M,
    Target,
    bars,
)

BAND_M = 0.3
"""Height around a level target within which points are taken for its own [m]."""


class Resolution(NamedTuple):
    """How a tri-bar target comes out.

    Parameters
    ----------
    width_m : float
        Of bars and gaps [m].
    north : bool
        Whether the bars run north.
    bars, gaps : float
        Points, or their summed intensity, for each square metre of the bars and of the gaps,
        the fuller of the two.
    """

    width_m: float
    north: bool
    bars: float
    gaps: float

    @property
    def contrast(self) -> float:
        """Michelson contrast: 1 where gaps are empty, 0 where they are as full as bars."""
        total = self.bars + self.gaps
        return (self.bars - self.gaps) / total if total > 0 else 0.0


def distance_m(xyz_m: NDArray[np.float64], scene: Targets) -> NDArray[np.float64]:
    """Distance of each point from what is in the scene, leaves too: (n,) float64 [m]."""
    out = np.empty(len(xyz_m))
    surface_distance(np.ascontiguousarray(xyz_m), scene, out)
    if len(scene.leaves):
        # A leaf's corner is 0.7 edges from its centre; half an edge is typical.
        leaf = cKDTree(scene.leaves[:, :3]).query(xyz_m, distance_upper_bound=1.0)[0]
        out = np.minimum(out, np.maximum(leaf - 0.5 * scene.leaf_m, 0.0))
    return out


def seen_from_above(
    scene: Targets, low_m: NDArray[np.float64], high_m: NDArray[np.float64], step_m: float
) -> NDArray[np.float64]:
    """Points of opaque surfaces straight below a grid, canopies left out: (n, 3) [m]."""
    axes = [np.arange(a + 0.5 * step_m, b, step_m) for a, b in zip(low_m, high_m, strict=True)]
    x, y = (a.ravel() for a in np.meshgrid(*axes))
    if len(scene.leaves):
        grid = scene.leaf_grid
        i = np.floor((x - grid[0]) / grid[2]).astype(int)
        j = np.floor((y - grid[1]) / grid[2]).astype(int)
        ny, nx = scene.leaf_first.shape
        inside = (i >= 0) & (j >= 0) & (i < nx - 1) & (j < ny)
        under = np.zeros(len(x), np.bool_)
        first = scene.leaf_first
        under[inside] = first[j[inside], i[inside] + 1] > first[j[inside], i[inside]]
        x, y = x[~under], y[~under]
    z = np.empty(len(x))
    heights_below(x, y, scene, z)
    return np.stack([x, y, z], axis=-1)


def completeness(
    truth_m: NDArray[np.float64], xyz_m: NDArray[np.float64], within_m: float
) -> float:
    """Share of true points with a point that near [0..1]; of nothing, 1."""
    if not len(truth_m):
        return 1.0
    if not len(xyz_m):
        return 0.0
    near = cKDTree(xyz_m).query(truth_m, distance_upper_bound=within_m)[0]
    return float(np.isfinite(near).mean())


def spoke_heights(xyz_m: NDArray[np.float64], name: Target = "spokes") -> NDArray[np.float64]:
    """Heights of the points on a spoke target, from its true height [m]."""
    x, y = POSITIONS_M[name]
    near = np.hypot(xyz_m[:, 0] - x, xyz_m[:, 1] - y) < SPOKE_RADIUS_M
    height = xyz_m[near, 2] - TARGET_HEIGHT_M
    near_level: NDArray[np.float64] = height[np.abs(height) < BAND_M]
    return near_level


def tri_bars(
    xyz_m: NDArray[np.float64], weight: NDArray[np.float64] | None = None
) -> list[Resolution]:
    """How full bars and gaps of each tri-bar target are."""
    weight = np.ones(len(xyz_m)) if weight is None else weight
    level = np.abs(xyz_m[:, 2] - TARGET_HEIGHT_M) < BAND_M
    xyz_m, weight = xyz_m[level], weight[level]
    found = []
    for width, north, plates in bars(POSITIONS_M["bars"]):
        axis = 0 if north else 1
        gaps = plates[:2].copy()
        gaps[:, axis] += width
        gaps[:, axis + 2] += width
        bar = np.mean([_filled(xyz_m, weight, p) for p in plates])
        gap = np.max([_filled(xyz_m, weight, p) for p in gaps])
        found.append(Resolution(width, north, float(bar), float(gap)))
    return found


def _filled(
    xyz: NDArray[np.float64], weight: NDArray[np.float64], plate: NDArray[np.float64]
) -> float:
    """Weight of the points over a rectangle for each square metre."""
    inside = (xyz[:, :2] >= plate[:2]).all(axis=1) & (xyz[:, :2] < plate[2:4]).all(axis=1)
    return float(weight[inside].sum() / np.prod(plate[2:4] - plate[:2]))
