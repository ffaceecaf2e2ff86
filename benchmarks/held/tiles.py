"""Ground on classified real tiles: what whole runs call ground, and what their sigma covers.

The producers' overlap (class 12) and noise (7, 18) are left out, and second copies of points.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import laspy
import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator
from scipy.spatial import KDTree

from benchmarks.held import surveys, truth
from benchmarks.held.figures import Figure, Moves, chosen, figure
from benchmarks.held.surveys import Given
from benchmarks.held.terrain import coverage
from benchmarks.held.truth import Grid, Mask, share
from spl_batch.constants import CLASS_GROUND

CRS_CODE: Final = 32615
"""Metric CRS that all tiles are taken to be in, as not each of them names its own."""

FEWEST_POINTS: Final = 1000
"""Tiles with fewer points are left out [count]."""

EDGE_M: Final = 5.0
"""What is left off at the edges of a tile, at most a tenth of its width [m]."""

FAR_M: Final = 10.0
"""Places farther than this from the producer's ground are left out [m]."""

TILES: Final[Moves] = {
    "RMSE": ("m", "more", 0.01),
    "> 0.5 m": ("%", "more", 0.2),
    "< -0.5 m": ("%", "more", 0.2),
    "roofs": ("%", "more", 0.2),
    "shrubs": ("%", "more", 0.5),
    "recall": ("%", "less", 0.5),
    "kappa": ("%", "less", 0.5),
}


class Tile(NamedTuple):
    """Points of a tile, less their corner: (n, 3) [m], and the producer's classes."""

    xyz: Grid
    classes: NDArray[np.uint8]

    @property
    def ground(self) -> Mask:
        """The producer's ground."""
        found: Mask = self.classes == CLASS_GROUND
        return found


def read(path: Path) -> Tile | None:
    """A tile of a file; None where the producer names no ground, or there are few points."""
    las = laspy.read(path)
    classes = np.asarray(las.classification).astype(np.uint8)
    good = ~np.isin(classes, (7, 12, 18))
    if good.sum() < FEWEST_POINTS or not (classes[good] == CLASS_GROUND).any():
        return None
    places = np.column_stack([np.rint(1000 * np.asarray(las[axis])) for axis in "xyz"])
    places, first = np.unique(places[good].astype(np.int64), axis=0, return_index=True)
    return Tile((places - 1000 * (places.min(axis=0) // 1000)) / 1000.0, classes[good][first])


CORNER: Final = (500_000.0, 4_000_000.0, 0.0)
"""Where a tile's corner is put [m]."""


def called(xyz: Grid, folder: Path) -> tuple[Mask, Path]:
    """Which points a run calls ground, and the run's output."""
    folder.mkdir(parents=True)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, 0.001), np.array(CORNER)
    header.add_crs(CRS.from_epsg(CRS_CODE))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (xyz + CORNER).T
    las.return_number[:], las.number_of_returns[:] = 1, 1
    las.write(folder / "tile.laz")
    out = surveys.of_cloud(folder / "tile.laz", surveys.LINEAR, folder / "run")
    (path,) = (out / "laz").rglob("*.laz")
    return np.asarray(laspy.read(path).classification) == CLASS_GROUND, out


def kappa(found: Mask, true: Mask) -> tuple[float, float]:
    """Total error and Cohen's kappa of a classification into two classes [%]."""
    agreed = float(np.mean(found == true))
    by_chance = found.mean() * true.mean() + (1 - found.mean()) * (1 - true.mean())
    return 100 * (1 - agreed), 100 * float((agreed - by_chance) / (1 - by_chance))


def samples(given: Given) -> Iterator[Figure]:
    """Kappa and total error of whole runs on the ISPRS samples [Sithole & Vosselman 2003]."""
    for path in given.real("isprs/samp*.la[sz]"):
        tile = read(path)
        assert tile is not None
        mask, _ = called(tile.xyz, given.scratch / path.stem)
        error, agreement = kappa(mask, tile.ground)
        yield figure(f"{path.name[:6]}: kappa", agreement, "%", "less", 0.3)
        yield figure(f"{path.name[:6]}: total error", error, "%", "more", 0.2)


def tiles(given: Given) -> Iterator[Figure]:
    """The default method on classified real tiles, and sigma's coverage on half of their points."""
    found = (read(path) for path in given.real("linear/*.la[sz]"))
    for number, tile in enumerate((one for one in found if one is not None), 1):
        mask, _ = called(tile.xyz, given.scratch / f"tile_{number}")
        yield from chosen(figures(tile, mask), TILES, f"tile {number}: ")
        half = np.random.default_rng(1).random(len(tile.xyz)) < 0.5
        _, out = called(tile.xyz[half], given.scratch / f"half_{number}")
        yield from _of_other_half(tile.xyz[~half & tile.ground], out, f"tile {number}: ")


def figures(tile: Tile, found: Mask) -> dict[str, float]:
    """TIN of what a run calls ground against that of the producer's, on a grid, and shares."""
    low, high = tile.xyz[:, :2].min(axis=0), tile.xyz[:, :2].max(axis=0)
    cell = 1.0 if len(tile.xyz) > np.prod(high - low) else 2.0
    edge = np.minimum(EDGE_M, (high - low) / 10)
    axes = (np.arange(a, b, cell) for a, b in zip(low + edge, high - edge, strict=True))
    places = np.column_stack([v.ravel() for v in np.meshgrid(*axes)])
    ground = tile.xyz[tile.ground]
    near = np.isfinite(KDTree(ground[:, :2]).query(places, distance_upper_bound=FAR_M)[0])
    off = terrain_at(tile.xyz[found], places[near]) - terrain_at(ground, places[near])
    off = off[np.isfinite(off)]
    shares = {"roofs": tile.classes == 6, "shrubs": tile.classes == 4, "recall": tile.ground}
    of_classes = {name: share(found, mask) for name, mask in shares.items() if mask.any()}
    return {
        "RMSE": truth.rms(off),
        "> 0.5 m": 100 * float(np.mean(off > 0.5)),
        "< -0.5 m": 100 * float(np.mean(off < -0.5)),
        "kappa": kappa(found, tile.ground)[1],
        **of_classes,
    }


def terrain_at(ground: Grid, places: Grid) -> Grid:
    """Height of the TIN through ground points at places, the lowest of each; NaN outside [m]."""
    order = np.lexsort(ground.T[::-1])
    _, first = np.unique(ground[order, :2], axis=0, return_index=True)
    lowest = ground[order][first]
    found: Grid = LinearNDInterpolator(lowest[:, :2], lowest[:, 2])(places)
    return found


def _of_other_half(ground: Grid, out: Path, of: str) -> Iterator[Figure]:
    """Delivered terrain against means of other points of the producer's ground in cells of 1 m."""
    cell = np.floor(ground[:, :2]).astype(np.int64)
    _, number, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    place = np.stack([np.bincount(number.ravel(), v) for v in ground.T]) / count
    x, y = place[0] + CORNER[0], place[1] + CORNER[1]
    with rasterio.open(out / "dtm.tif") as source:
        at, (rows, columns) = source.transform, source.shape
    north, east = np.arange(rows) + 0.5, np.arange(columns) + 0.5
    row, column = (at.f - y) / -at.e, (x - at.c) / at.a
    heights, sigma = truth.raster(out / "dtm.tif"), truth.raster(out / "dtm_quality.tif")
    surface = RegularGridInterpolator((north, east), heights, bounds_error=False)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    row, column, z = row[inside], column[inside], place[2][inside]
    said = sigma[row.astype(np.int64), column.astype(np.int64)]
    yield from coverage(surface(np.column_stack([row, column])) - z, said, of)
