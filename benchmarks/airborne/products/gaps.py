"""Terrain across gaps: squares of real ground are withheld, and what the rest makes of them.

Run ``python -m benchmarks.airborne.products.gaps FOLDER [TILE ...] [--sides M ...] [--found]``.

FOLDER holds classified tiles. The producer's ground is withheld in squares of 12, 20, 40 and 60 m,
as far from each other as they are wide, 20 m at least. With ``--found`` all points are withheld
there, and ground is found by the default method in the others. What is left makes the terrain in
cells of 1 m; it is compared with withheld cells from 4 m off the nearest ground on, as far as
terrain is interpolated:

- ``TIN``: linear between the means of cells;
- ``plates``: as a run makes it (:mod:`spl_batch.airborne.products.gap_surface`);
- ``CT``: scipy's ``CloughTocher2DInterpolator`` on the same triangles;
- ``GDAL``: ``rasterio.fill.fillnodata``, weights by inverse distance, smoothed twice.

Printed are the RMSE [m], the share of cells more than 0.5 m off and the largest difference, for
each of them, and how many differences lie within one and 1.96 standard deviations of
``dtm_quality.tif`` with the TIN and with plates [%].
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rasterio.fill import fillnodata
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.ndimage import distance_transform_edt

from benchmarks.airborne.ground.ground_tiles import Tile, terrain, tiles
from benchmarks.airborne.products.dtm_quality import (
    CELL_M,
    VOID_MAX_M,
    Model,
    cells_of,
    covered,
    found_in,
    model,
    shape_of,
)
from spl_batch.airborne.products.gap_surface import FAR_M

SIDES_M: Final = (12.0, 20.0, 40.0, 60.0)
APART_M: Final = 20.0
"""Squares are no nearer to each other than this [m]."""

SHIFTS: Final = (0.0, 1 / 3, 2 / 3)
"""Of the squares' lattice, in its steps: each is a trial of its own."""

CLEAR_M: Final = 0.5
FEW: Final = 50
"""Cells that a line is made of, at least [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Trial(NamedTuple):
    """Differences of each method, and the deviation that is said there [m]."""

    off: dict[str, Float]
    said: Float


def in_squares(places: Float, shape: tuple[int, int], side: float, shift: float) -> Mask:
    """Places in squares that lie, with a rim around, in a tile: (n,) bool."""
    apart = max(side, APART_M)
    step = side + apart
    found = np.ones(len(places), np.bool_)
    for axis, cells in zip(places[:, :2].T, shape[::-1], strict=True):
        start = np.floor(axis / step - shift) * step + shift * step + apart / 2
        found &= (axis >= start) & (axis < start + side)
        found &= (start >= apart / 2) & (start + side + apart / 2 <= cells * CELL_M)
    return found


def filled(made: Model) -> Float:
    """Raster of the means, its voids filled by GDAL."""
    heights = np.zeros(made.tin.shape, np.float32)
    held = np.zeros(made.tin.shape, np.uint8)
    held[cells_of(made.means)] = 1
    base = made.means[0, 2]
    heights[cells_of(made.means)] = made.means[:, 2] - base
    wide = 2 * VOID_MAX_M / CELL_M
    return np.asarray(fillnodata(heights, held, wide, 2), np.float64) + base


def trial(ground: Float, truth: Float, shape: tuple[int, int]) -> Trial | None:
    """Terrain of some ground against the means of withheld cells, if any is far from it."""
    made = model(ground, shape)
    held = np.zeros(shape, np.bool_)
    held[cells_of(made.means)] = True
    away = distance_transform_edt(~held)[cells_of(truth)] * CELL_M
    truth = truth[(away > FAR_M) & (away <= VOID_MAX_M)]
    if not len(truth):
        return None
    cells = cells_of(truth)
    tin = terrain(made.means, truth[:, :2]) - truth[:, 2]
    off = {
        "TIN": tin,
        "plates": tin + made.above[cells],
        "CT": CloughTocher2DInterpolator(made.means[:, :2], made.means[:, 2])(truth[:, :2])
        - truth[:, 2],
        "GDAL": tin + filled(made)[cells] - made.tin[cells],
    }
    said = made.sigma[cells]
    told = np.isfinite(said) & np.isfinite(sum(off.values()))
    return Trial({name: values[told] for name, values in off.items()}, said[told])


def trials(tile: Tile, side: float, *, find: bool) -> Iterator[Trial]:
    """All trials of a tile with squares of one size."""
    shape, xyz = shape_of(tile), tile.xyz
    for shift in SHIFTS:
        out = in_squares(xyz, shape, side, shift)
        if (out & tile.ground).any():
            ground = found_in(tile, ~out) if find else xyz[tile.ground & ~out]
            found = trial(ground, model(xyz[tile.ground & out], shape).means, shape)
            if found is not None:
                yield found


def line(found: Sequence[Trial]) -> str:
    """What is printed of some trials."""
    said = np.concatenate([one.said for one in found])
    text = f"{len(said):7}"
    for name in found[0].off:
        off = np.concatenate([one.off[name] for one in found])
        size = np.abs(off)
        wrong = 100 * float(np.mean(size > CLEAR_M))
        text += f"{np.sqrt(np.mean(off**2)):9.3f}{wrong:6.1f}%{size.max():6.1f}"
    for name in ("TIN", "plates"):
        one, two = covered(np.concatenate([t.off[name] for t in found]), said)
        text += f"{one:9.0f};{two:4.0f}"
    return text


def main(folder: Path, wanted: Sequence[str], sides: Sequence[float], *, find: bool) -> None:
    """Print a line for each tile and side."""
    heads = "".join(f"{name:>14} [m] max" for name in ("TIN", "plates", "CT", "GDAL"))
    print(f"{'':22}{'side m':>8}{'cells':>7}{heads}  within 1; 1.96 sigma, TIN and plates")
    for tile in tiles(folder, wanted):
        for side in sides:
            found = list(trials(tile, side, find=find))
            if sum(len(one.said) for one in found) >= FEW:
                print(f"{tile.name[:20]:22}{side:8.0f}{line(found)}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tiles", nargs="*")
    parser.add_argument("--sides", nargs="+", type=float, default=SIDES_M)
    parser.add_argument("--found", action="store_true")
    given = parser.parse_args()
    main(given.folder, given.tiles, given.sides, find=given.found)
