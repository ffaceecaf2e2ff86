"""Ground does not depend on where ground cells lie: each place is judged by what is around it."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable

LENGTH_M, WIDTH_M, FOREST_M = 240, 32, 96
CORNER_M = np.array([272_000.0, 3_290_000.0])
FIRST_CUT_M = 37.0
CELL_M, BUFFER_M = 80.0, GroundSettings().buffer_m

EDGE_M = 6
FEW = 2e-4
CLEAR_M, MOST_M = 0.01, 0.08
BESIDE_M, SEAM_M = 10.0, 5e-4
"""Share of the points whose label may differ, and of the terrain's cells that may by more than a
centimetre, and the most; and the mean beside cuts, where a seam would be. At the edges of the data,
which are left out, a triangulation ends in slivers that reach beyond any buffer; what lies below
them counts within 48 m. Of the forest each label is of a few ground returns, and moves its cell by
decimetres: it is wider, and how much single cells differ is not asked."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


def cloud(
    per_m2: float, seed: int, width_m: int = WIDTH_M
) -> tuple[np.random.Generator, Float, Float]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 1, (2, int(per_m2 * LENGTH_M * width_m)))
    return rng, x * LENGTH_M, y * width_m


def table(x: Float, y: Float, z: Float, sigma_m: Float | float) -> PointTable:
    places = np.rint(1000 * np.column_stack([x + CORNER_M[0], y + CORNER_M[1], z])).astype(np.int64)
    order = np.lexsort(places.T)
    east, north, up = places[order].T
    told = np.broadcast_to(np.float32(sigma_m), len(x))[order]
    return PointTable({"x": east, "y": north, "z": up.astype(np.int32), "range_sigma": told})


def forest() -> PointTable:
    """Even ground under trees in the west, ever more ravines to the east: one block in ten."""
    rng, x, y = cloud(14, 5, FOREST_M)
    z = 25 * (x / LENGTH_M) ** 2 * np.abs(np.sin(x / 12)) + rng.normal(0, 0.05, len(x))
    under = rng.random(len(x)) < 0.8
    z[under] += rng.gamma(1.0, 1.5, int(under.sum()))
    return table(x, y, z, 0.05)


def mountain() -> PointTable:
    """Slopes of up to 50 degrees under trees."""
    rng, x, y = cloud(10, 6)
    z = 40 * np.sin(x / 40) + 0.4 * y + rng.normal(0, 0.05, len(x))
    under = rng.random(len(x)) < 0.6
    z[under] += rng.uniform(0, 20, int(under.sum()))
    return table(x, y, z, 0.05)


def town() -> PointTable:
    """Houses on even ground, half of the streets under trees."""
    rng, x, y = cloud(8, 7)
    z = 0.02 * x + rng.normal(0, 0.03, len(x))
    roof = (x % 24 < 11) & (np.abs(y - 14) < 6)
    z[roof] += 6.0
    under = ~roof & (y > 22) & (rng.random(len(x)) < 0.7)
    z[under] += rng.uniform(1, 9, int(under.sum()))
    return table(x, y, z, 0.05)


def two_flightlines() -> PointTable:
    """Meadow; ranges of the line in the east, which begins beside a cut, scatter thrice as far."""
    rng, x, y = cloud(14, 8)
    sigma_m = np.where(x > 100, 0.12, 0.04)
    z = 0.05 * x + rng.normal(0, 1, len(x)) * sigma_m
    under = rng.random(len(x)) < 0.3
    z[under] += rng.gamma(1.0, 0.3, int(under.sum()))
    return table(x, y, z, sigma_m)


def thinning() -> PointTable:
    """Trees; from four points per m2 in the west to one in the east."""
    rng, x, y = cloud(4, 9)
    kept = rng.random(len(x)) < 1 - 0.75 * x / LENGTH_M
    x, y = x[kept], y[kept]
    z = 2 * np.sin(x / 15) + rng.normal(0, 0.04, len(x))
    under = rng.random(len(x)) < 0.5
    z[under] += rng.uniform(0.3, 8, int(under.sum()))
    return table(x, y, z, 0.05)


SCENES: Mapping[str, Callable[[], PointTable]] = {
    "forest": forest,
    "mountain": mountain,
    "town": town,
    "two flightlines": two_flightlines,
    "thinning": thinning,
}


def in_cells(points: PointTable, settings: GroundSettings) -> Mask:
    """Ground of cells from west to east."""
    x = points["x"] / 1000 - CORNER_M[0] - FIRST_CUT_M
    cell = np.floor(x / CELL_M)
    found = np.zeros(len(points), np.bool_)
    for k in np.unique(cell):
        near = np.flatnonzero(np.abs(x - (k + 0.5) * CELL_M) < CELL_M / 2 + BUFFER_M)
        own = cell[near] == k
        mask = ground_mask(points.take(near), np.ones(len(near), np.bool_), settings, own)
        found[near[own]] = mask[own]
    return found


def terrain(points: PointTable, ground: Mask, width_m: int) -> Float:
    """Terrain through the means of cells of 1 m, at their middles."""
    places = np.column_stack([points[axis][ground] for axis in "xyz"]) / 1000
    places[:, :2] -= CORNER_M
    number = np.floor(places[:, :2]).astype(int) @ (1, LENGTH_M)
    _, cell = np.unique(number, return_inverse=True)
    means = np.column_stack([np.bincount(cell.ravel(), v) for v in places.T])
    means /= np.bincount(cell.ravel())[:, None]
    x, y = np.meshgrid(np.arange(LENGTH_M) + 0.5, np.arange(width_m) + 0.5)
    made: Float = LinearNDInterpolator(means[:, :2], means[:, 2])(x, y)
    return made


@pytest.mark.parametrize(
    ("scene", "method"),
    [(name, "multiscale") for name in SCENES if name != "thinning"] + [("thinning", "ptd")],
)
def test_ground_is_the_same_wherever_cells_are_cut(scene: str, method: str) -> None:
    points, settings = SCENES[scene](), GroundSettings.model_validate({"method": method})
    whole = ground_mask(points, np.ones(len(points), np.bool_), settings)
    east, north = (
        points[axis] / 1000 - corner for axis, corner in zip("xy", CORNER_M, strict=True)
    )
    width_m = FOREST_M if scene == "forest" else WIDTH_M
    inside = np.abs(east - LENGTH_M / 2) < LENGTH_M / 2 - EDGE_M
    inside &= np.abs(north - width_m / 2) < width_m / 2 - EDGE_M
    cut = in_cells(points, settings)
    assert np.mean((cut != whole)[inside]) < FEW
    off = np.abs(terrain(points, cut, width_m) - terrain(points, whole, width_m))
    beside = (np.arange(LENGTH_M) + 0.5 - FIRST_CUT_M + CELL_M / 2) % CELL_M - CELL_M / 2
    off = off[EDGE_M:-EDGE_M, EDGE_M:-EDGE_M]
    assert np.mean(off > CLEAR_M) < 10 * FEW
    assert off[:, np.abs(beside[EDGE_M:-EDGE_M]) < BESIDE_M].mean() < SEAM_M
    if scene != "forest":
        assert off.max() < MOST_M
