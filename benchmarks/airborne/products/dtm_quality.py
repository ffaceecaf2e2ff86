"""Whether the terrain's standard deviation says how far it is off, on real tiles and on surveys.

Run ``python -m benchmarks.airborne.products.dtm_quality FOLDER [TILE ...] [--surveys SURVEY ...]``.

FOLDER holds classified tiles. The terrain is made as a run makes it: means of the ground in cells
of 1 m, a TIN through them, plates across gaps. It is compared in four ways:

- ``points``: of the producer's ground every second point is withheld; the terrain of the rest
  against the withheld points;
- ``squares``: the same with a third of all squares of 8 m withheld, as large crowns and halls hide
  the ground;
- ``half``: ground is found by the default method in every second point of all; its terrain against
  the producer's ground among the others, by cells of 1 m;
- ``tin``: ground is found in all points; its terrain against the TIN of the producer's ground.
  Where both chose the same points both surfaces are the same, and nothing is off.

SURVEY is a simulated one that has been run; its rasters are compared with the truth.

Printed are how many differences lie within one and 1.96 standard deviations of
``dtm_quality.tif`` (68 and 95 % if it is honest), the RMS of the differences, the median of their
size, and the RMS of the standard deviations. Withheld points' own noise counts against it. Then
what bounds these figures:

- ``same``: share of places where less than a millimetre is off, as both surfaces are made of the
  same points [%];
- ``bias``: median difference [m], and ``without``: what lies within one and 1.96 without it [%];
- ``tail``: size of the differences, in standard deviations, that 95 % keep to, over that of 68 %:
  1.97 of a normal distribution, 2.63 of one that falls off exponentially on both sides (Laplace),
  of which 76 and 94 % lie within one and 1.96.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import rasterio
from numpy.typing import NDArray

from benchmarks.airborne.ground.ground_tiles import Tile, terrain, tiles
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.products.gap_surface import FAR_M, bridged
from spl_batch.airborne.products.terrain_quality import Scatter, scatter_of, terrain_sigma
from spl_batch.airborne.settings import GroundSettings, ProductSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.numerics.triangulation.tin_raster import tin_raster

CELL_M: Final = 1.0
VOID_MAX_M: Final = ProductSettings().void_max_m
SQUARE_M: Final = 8.0
WITHHELD: Final = 1 / 3
SEED: Final = 1

SAME_M: Final = 1e-3
"""Where less is off both surfaces are the same [m]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Compared(NamedTuple):
    """How much too high a terrain is at some places, and the deviation that is said there [m]."""

    off: Float
    said: Float


class Model(NamedTuple):
    """Means of the ground in cells with any: (n, 3), and of all cells the deviation [m].

    ``tin``: height of the TIN of the means, ``above``: of plates across gaps above it, at centres
    of cells [m].
    """

    means: Float
    sigma: Float
    tin: Float
    above: Float


def withheld(ground: Float, way: str) -> Mask:
    """Points to be left out: (n,) bool."""
    rng = np.random.default_rng(SEED)
    if way != "squares":
        return rng.random(len(ground)) < 0.5
    squares = np.floor(ground[:, :2] / SQUARE_M).astype(np.int64)
    _, number = np.unique(squares, axis=0, return_inverse=True)
    number = number.ravel()
    found: Mask = (rng.random(number.max() + 1) < WITHHELD)[number]
    return found


def cells_of(places: Float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of the cell of each place."""
    column, row = np.floor(places[:, :2] / CELL_M).astype(np.int64).T
    return row, column


def model(ground: Float, shape: tuple[int, int]) -> Model:
    """Terrain model of some ground points."""
    row, column = cells_of(ground)
    order = np.argsort(row * shape[1] + column, kind="stable")
    number = (row * shape[1] + column)[order]
    start = np.searchsorted(number, np.arange(shape[0] * shape[1] + 1))
    held, first = start[1:] > start[:-1], start[:-1][start[1:] > start[:-1]]
    of_cells = np.add.reduceat(ground[order], first) / np.diff(start)[held, None]
    x, y, z = np.rint(ground[order] / QUANTUM_M).astype(np.int32).T
    means, count = np.full((len(held), 3), np.nan), np.zeros(len(held))
    products = np.zeros((len(held), 6))
    means[held] = of_cells
    count[held], products[held] = scatter_of((x, y, z), start, QUANTUM_M)
    scatter = Scatter(count.reshape(shape), products.reshape(*shape, 6))
    grid = means.reshape(*shape, 3)
    return Model(of_cells, terrain_sigma(grid, CELL_M, scatter), *surface_of(grid))


def surface_of(grid: Float) -> tuple[Float, Float]:
    """TIN of the means of cells at their centres, and how far plates lie above it [m]."""
    margin = round(2 * VOID_MAX_M / CELL_M)
    wide = np.pad(grid, ((margin, margin), (margin, margin), (0, 0)), constant_values=np.nan)
    wide[:, :, :2] += margin * CELL_M
    held = grid[~np.isnan(grid[:, :, 2])]
    tin = tin_raster(held, CELL_M, grid.shape[:2], VOID_MAX_M)
    wet = np.zeros(wide.shape[:2], np.bool_)
    return tin, bridged(tin, wide, wet, round(CELL_M), FAR_M / CELL_M, (0, 0)) - tin


def shape_of(tile: Tile) -> tuple[int, int]:
    """Rows and columns of cells of a tile."""
    width, height = (int(v) + 1 for v in np.floor(tile.xyz[:, :2].max(axis=0) / CELL_M))
    return height, width


def compared(made: Model, places: Float, heights: Float) -> Compared:
    """A terrain model against heights at places, where it says anything."""
    cells = cells_of(places)
    off = terrain(made.means, places) + np.nan_to_num(made.above[cells]) - heights
    said = made.sigma[cells]
    told = np.isfinite(off) & np.isfinite(said)
    return Compared(off[told], said[told])


def found_in(tile: Tile, looked: Mask) -> Float:
    """Ground points that the default method finds in some of a tile's points."""
    table = tile.table.take(looked)
    mask = ground_mask(table, np.ones(len(table), np.bool_), GroundSettings())
    return tile.xyz[looked][mask]


def by_ways(tile: Tile) -> Iterator[tuple[str, Compared]]:
    """All comparisons of a tile."""
    shape, ground = shape_of(tile), tile.xyz[tile.ground]
    for way in ("points", "squares"):
        out = withheld(ground, way)
        yield way, compared(model(ground[~out], shape), ground[out, :2], ground[out, 2])
    out = withheld(tile.xyz, "half")
    reference = model(tile.xyz[out & tile.ground], shape).means
    made = model(found_in(tile, ~out), shape)
    yield "half", compared(made, reference[:, :2], reference[:, 2])
    made = model(found_in(tile, np.ones(len(out), np.bool_)), shape)
    yield "tin", compared(made, tile.grid, tile.truth)


def of_survey(survey: Path) -> Compared:
    """A simulated survey's terrain against its truth."""
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        truth, bounds = source.read(1).astype(np.float64), source.bounds
    rasters = []
    for name in ("dtm", "dtm_quality"):
        with rasterio.open(survey / "out" / f"{name}.tif") as source:
            window = source.window(*bounds).round_offsets().round_lengths()
            found = source.read(1, window=window, boundless=True, fill_value=source.nodata)
            rasters.append(np.where(found == source.nodata, np.nan, found.astype(np.float64)))
    off, said = rasters[0] - truth, rasters[1]
    told = np.isfinite(off) & np.isfinite(said)
    return Compared(off[told], said[told])


def covered(off: Float, said: Float) -> list[float]:
    """Share of differences within one and 1.96 standard deviations [%]."""
    return [100 * float(np.mean(np.abs(off) <= k * said)) for k in (1.0, 1.96)]


def show(name: str, way: str, found: Compared) -> None:
    """Print a line."""
    size, bias = np.abs(found.off), float(np.median(found.off))
    one, two = covered(*found)
    off, said = (float(np.sqrt(np.mean(v**2))) for v in found)
    same = 100 * float(np.mean(size < SAME_M))
    without = "; ".join(f"{share:.1f}" for share in covered(found.off - bias, found.said))
    most, tail = np.percentile(size / np.maximum(found.said, SAME_M), [68, 95])
    print(
        f"{name[:22]:24}{way:8}{one:9.1f}%{two:11.1f}%{off:11.3f}{np.median(size):10.3f}{said:13.3f}"
        f"{same:8.0f}{bias:9.3f}{without:>14}{tail / most if most > 0 else np.nan:7.2f}",
        flush=True,
    )


def main(folder: Path, wanted: Sequence[str], surveys: Sequence[Path]) -> None:
    """Print a line for each tile and way, and for each survey."""
    print(
        f"{'':32}{'within 1':>10}{'1.96 sigma':>12}{'RMS off m':>11}{'median':>10}{'sigma m':>13}"
        f"{'same':>8}{'bias m':>9}{'without':>14}{'tail':>7}"
    )
    for tile in tiles(folder, wanted):
        for way, found in by_ways(tile):
            show(tile.name, way, found)
    for survey in surveys:
        show(survey.name, "truth", of_survey(survey))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tiles", nargs="*")
    parser.add_argument("--surveys", nargs="*", type=Path, default=[])
    given = parser.parse_args()
    main(given.folder, given.tiles, given.surveys)
