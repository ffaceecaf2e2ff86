"""Whether the terrain's standard deviation says how far it is off, on classified real tiles.

Run ``python -m benchmarks.airborne.products.dtm_quality FOLDER [TILE ...]``.

Of the producer's ground of each tile some is withheld, in two ways: every second point, and a
third of all squares of 8 m, as large crowns and halls hide it. The terrain of the rest, as a run
makes it, is compared with the withheld points. Printed are how many of them lie within one and
1.96 standard deviations of ``dtm_quality.tif`` (68 and 95 % if it is honest), the RMS of the
differences, and that of the standard deviations. The withheld points' own noise counts against it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.airborne.ground.ground_tiles import terrain, tiles
from spl_batch.airborne.products.terrain_quality import terrain_sigma

CELL_M: Final = 1.0
SQUARE_M: Final = 8.0
WITHHELD: Final = 1 / 3
SEED: Final = 1

Float = NDArray[np.float64]


def withheld(ground: Float, way: str) -> NDArray[np.bool_]:
    """Points to be left out: (n,) bool."""
    rng = np.random.default_rng(SEED)
    if way == "points":
        return rng.random(len(ground)) < 0.5
    squares = np.floor(ground[:, :2] / SQUARE_M).astype(np.int64)
    _, number = np.unique(squares, axis=0, return_inverse=True)
    number = number.ravel()
    found: NDArray[np.bool_] = (rng.random(number.max() + 1) < WITHHELD)[number]
    return found


def means_of(ground: Float, shape: tuple[int, int]) -> Float:
    """Mean place and height of each cell: (rows, columns, 3) [m]."""
    column, row = np.floor(ground[:, :2] / CELL_M).astype(np.int64).T
    key, cells = row * shape[1] + column, shape[0] * shape[1]
    sums = np.stack([np.bincount(key, axis, minlength=cells) for axis in ground.T], axis=-1)
    count = np.bincount(key, minlength=cells)[:, None]
    means = np.full(sums.shape, np.nan)
    np.divide(sums, count, out=means, where=count > 0)
    return means.reshape(*shape, 3)


def figures(ground: Float, way: str) -> tuple[float, float, float, float]:
    """Within one and 1.96 deviations [%], RMS of differences and of deviations [m]."""
    out = withheld(ground, way)
    width, height = (int(v) + 1 for v in np.floor(ground[:, :2].max(axis=0) / CELL_M))
    means = means_of(ground[~out], (height, width))
    sigma = terrain_sigma(means, CELL_M)
    asked = ground[out]
    column, row = np.floor(asked[:, :2] / CELL_M).astype(np.int64).T
    off = terrain(means[~np.isnan(means[:, :, 2])], asked[:, :2]) - asked[:, 2]
    said = sigma[row, column]
    told = np.isfinite(off) & np.isfinite(said)
    off, said = np.abs(off[told]), said[told]
    within = (100 * float(np.mean(off <= k * said)) for k in (1.0, 1.96))
    one, two = within
    return one, two, float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(said**2)))


def main(folder: Path, wanted: Sequence[str]) -> None:
    """Print a line for each tile and way."""
    print(f"{'':32}{'within 1':>10}{'1.96 sigma':>12}{'RMS off m':>11}{'RMS sigma m':>13}")
    for tile in tiles(folder, wanted):
        for way in ("points", "squares"):
            one, two, off, said = figures(tile.xyz[tile.ground], way)
            print(f"{tile.name[:22]:24}{way:8}{one:9.1f}%{two:11.1f}%{off:11.3f}{said:13.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tiles", nargs="*")
    given = parser.parse_args()
    main(given.folder, given.tiles)
