"""What bounds the default ground method on real tiles: a picture.

Run ``python -m benchmarks.airborne.ground.ground_bounds FOLDER [PICTURE]``.

FOLDER is that of :mod:`~benchmarks.airborne.ground.ground_tiles`. Prints, and draws into PICTURE:

- heath: where the returns of the smoothest cells lie about the producer's terrain, those that he
  calls ground and all, and a profile with his terrain and ours;
- town: error of the terrain within so many metres of the producer's ground, at the edge of the tile
  and within, and without what is taken of each of his other classes; where cells are too high, by
  the class of the point that lifts them, and a profile through the largest patch of these;
- quarry and hillside town (samples 53 and 11): ground that the method misses and objects that it
  takes, over the shaded terrain.
"""

import argparse
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import Delaunay, cKDTree

from benchmarks.airborne.ground.ground_tiles import CLEAR_M, Mask, Tile, project, terrain, tiles

HEATHS: Final = ("VSN601001", "VSN601003")
TOWN: Final = "test_semis"
SAMPLES: Final = ("samp53", "samp11")

CELL_M: Final = 1.0
FEWEST: Final = 12
"""Returns that tell how smooth a cell is [count]."""

SMOOTH_M: Final = 0.045
"""Cells whose returns spread by less about a plane have one surface only [m]."""

LOW_M: Final = 0.3
"""Smooth cells that stand higher above the producer's terrain are tops of shrubs [m]."""

WIDE_M: Final = 0.75
"""Half the width of the profile [m]."""

BARE: Final = -0.15, 0.25
DISTANCES_M: Final = (1, 2, 3, 5, 7, 10)
ZONES_M: Final = ((5.0, 20.0), (20.0, 40.0), (40.0, np.inf))

CLASSES: Final = {
    1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation",
    5: "high vegetation", 6: "building",
}  # fmt: skip
LEAST: Final = 0.01
"""Classes that lift a smaller share of the cells are not drawn."""

WIDE_TOWN_M: Final = 4.0
LONG_M: Final = 80.0
"""Half the width and the length of the town's profile [m]."""

Float = NDArray[np.float64]


class Judged(NamedTuple):
    """A tile, the ground that the method finds in it, and heights above the producer's [m]."""

    tile: Tile
    found: Mask
    above: Float


def judged(folder: Path, name: str) -> Judged:
    """The one tile of a name."""
    tile = tiles(folder, [name])[0]
    found = project("multiscale", cells=False)(tile)
    return Judged(tile, found, tile.xyz[:, 2] - terrain(tile.xyz[tile.ground], tile.xyz[:, :2]))


def smooth(of: Judged) -> Mask:
    """Returns in cells that have one surface only, near the ground."""
    xyz, chosen = of.tile.xyz, np.zeros(len(of.above), np.bool_)
    _, cell = np.unique(np.floor(xyz[:, :2] / CELL_M), axis=0, return_inverse=True)
    for number in range(cell.max() + 1):
        own = np.flatnonzero(cell == number)
        if len(own) < FEWEST or not np.isfinite(of.above[own]).all():
            continue
        design = np.column_stack([np.ones(len(own)), xyz[own, :2] - xyz[own[0], :2]])
        rest = xyz[own, 2] - design @ np.linalg.lstsq(design, xyz[own, 2], rcond=None)[0]
        spread = np.sqrt(np.sum(rest**2) / (len(own) - 3))
        chosen[own] = spread < SMOOTH_M and of.above[own].mean() < LOW_M
    return chosen


def heath(of: Judged, axes: Any, profile: Any) -> None:
    """Returns about the producer's terrain, and a profile."""
    tile, bare = of.tile, smooth(of)
    off = np.median(terrain(tile.xyz[of.found], tile.grid) - tile.truth)
    cells = len(np.unique(np.floor(tile.xyz[bare, :2] / CELL_M), axis=0))
    print(f"{tile.name}: ours {100 * off:.1f} cm above the producer's terrain")
    if cells:
        own = of.above[bare]
        print(
            f"  {cells} smooth cells: all returns {100 * own.mean():.1f} cm above it, "
            f"{100 * tile.ground[bare].mean():.0f} % of them his ground, "
            f"{100 * of.found[bare].mean():.0f} % ours"
        )
    bins = np.arange(*BARE, 0.01)
    picked = bare if cells else np.ones(len(bare), np.bool_)
    for chosen, label in (
        (picked, "returns of smooth cells" if cells else "all returns"),
        (picked & of.found, "our ground"),
        (picked & tile.ground, "producer's ground"),
    ):
        axes.hist(of.above[chosen], bins, label=label, histtype="step", linewidth=1.4)
    axes.set(
        title=tile.name[:9], xlabel="height above the producer's terrain [m]", ylabel="returns"
    )
    axes.legend(fontsize=7, loc="upper right")
    middle = np.median(tile.xyz[:, 1])
    near = np.abs(tile.xyz[:, 1] - middle) < WIDE_M
    for chosen, colour, size in (
        (near & ~tile.ground, "0.7", 2), (near & tile.ground, "tab:orange", 9)
    ):  # fmt: skip
        profile.scatter(tile.xyz[chosen, 0], of.above[chosen], size, colour)
    west, east = np.quantile(tile.xyz[:, 0], (0.03, 0.97))
    x = np.arange(float(west), float(east), 0.25)
    line = np.column_stack([x, np.full(len(x), middle)])
    ours = terrain(tile.xyz[of.found], line) - terrain(tile.xyz[tile.ground], line)
    profile.plot(x, ours, "tab:blue", label="our terrain")
    profile.axhline(0, color="tab:orange", label="producer's terrain")
    profile.set(ylim=(-0.3, 1.2), title=f"{tile.name[:9]}: 1.5 m wide", xlabel="east [m]")
    profile.legend(fontsize=7, loc="upper right")


def town(of: Judged, axes: Any) -> None:
    """Error by the distance to the producer's ground."""
    tile = of.tile
    off = terrain(tile.xyz[of.found], tile.grid) - tile.truth
    far = cKDTree(tile.xyz[tile.ground, :2]).query(tile.grid)[0]
    known = np.isfinite(off)
    whole = np.sum(off[known] ** 2)
    errors = []
    for most in DISTANCES_M:
        near = known & (far < most)
        errors.append(float(np.sqrt(np.mean(off[near] ** 2))))
        print(
            f"{tile.name}: {100 * near.sum() / known.sum():.1f} % of cells within {most} m of the "
            f"producer's ground: RMSE {errors[-1]:.3f} m, "
            f"{100 * np.sum(off[near] ** 2) / whole:.0f} % of all squares"
        )
    high = tile.xyz[:, :2].max(axis=0)
    edge = np.minimum(tile.grid, high - tile.grid).min(axis=1)
    for least, most in ZONES_M:
        there = known & (edge >= least) & (edge < most)
        rms = np.sqrt(np.mean(off[there] ** 2))
        print(
            f"  {least:g} to {most:g} m off the edge: RMSE {rms:.3f} m, "
            f"{100 * np.mean(off[there] > CLEAR_M):.2f} % of cells too high"
        )
    for number in np.unique(tile.classes[of.found & ~tile.ground]):
        rest = terrain(tile.xyz[of.found & (tile.classes != number)], tile.grid) - tile.truth
        rest = rest[np.isfinite(rest)]
        print(
            f"  without class {number}: RMSE {np.sqrt(np.mean(rest**2)):.3f} m, "
            f"{100 * np.mean(rest > CLEAR_M):.2f} % of cells too high"
        )
    axes.plot(DISTANCES_M, errors, "o-")
    axes.set(
        title="town", xlabel="cells no farther from the producer's ground [m]", ylabel="RMSE [m]",
        ylim=(0, None),
    )  # fmt: skip


def too_high(of: Judged, axes: Any, profile: Any) -> None:
    """Cells that are too high, by the class of the highest corner of their triangle; a profile."""
    tile, ours = of.tile, of.tile.xyz[of.found]
    off = terrain(ours, tile.grid) - tile.truth
    places = tile.grid[off > CLEAR_M]
    triangles = Delaunay(ours[:, :2])
    corners = triangles.simplices[triangles.find_simplex(places)]
    above = np.nan_to_num(of.above[of.found][corners], nan=-np.inf)
    lifts = np.take_along_axis(corners, above.argmax(axis=1)[:, None], axis=1)[:, 0]
    classes = tile.classes[of.found][lifts]
    for number in np.unique(classes):
        own = classes == number
        print(
            f"  too high by class {number}: {100 * own.mean():.0f} % of {len(own)} cells, points "
            f"{np.median(above.max(axis=1)[own]):.2f} m above the producer's terrain"
        )
        if own.mean() > LEAST:
            label = f"{CLASSES.get(int(number), f'class {number}')}: {own.sum()}"
            axes.scatter(*places[own].T, 1.5, label=label)
    axes.set(title="town: cells > 0.5 m too high", aspect="equal")
    axes.legend(fontsize=7, loc="lower left", markerscale=4)
    step = 2.0
    column, row = np.floor(places / step).astype(int).T
    held = np.zeros((row.max() + 1, column.max() + 1), np.bool_)
    held[row, column] = True
    patches, _ = ndimage.label(held, np.ones((3, 3)))
    largest = np.bincount(patches[patches > 0]).argmax()
    size = int((patches == largest).sum())
    print(f"  largest patch: {size * step**2:.0f} m2 of {held.sum() * step**2:.0f} m2")
    x, y = np.median(places[patches[row, column] == largest], axis=0)
    near = (np.abs(tile.xyz[:, 1] - y) < WIDE_TOWN_M) & (np.abs(tile.xyz[:, 0] - x) < LONG_M)
    for number in np.unique(tile.classes[near]):
        own = near & (tile.classes == number)
        label = CLASSES.get(int(number), f"class {number}")
        profile.scatter(tile.xyz[own, 0], of.above[own], 6, label=label)
    profile.set(
        title=f"its largest patch, {size * step**2:.0f} m2: {2 * WIDE_TOWN_M:g} m wide",
        xlabel="east [m]", ylabel="height above the producer's terrain [m]", ylim=(-1, 5),
    )  # fmt: skip
    profile.legend(fontsize=7, loc="upper right")


def mistakes(of: Judged, axes: Any) -> None:
    """Missed ground and taken objects over the shaded terrain."""
    tile = of.tile
    low, high = tile.xyz[:, :2].min(axis=0), tile.xyz[:, :2].max(axis=0)
    x, y = (np.arange(a, b, 1.0) for a, b in zip(low, high, strict=True))
    places = np.column_stack([v.ravel() for v in np.meshgrid(x, y)])
    height = terrain(tile.xyz[tile.ground], places).reshape(len(y), len(x))
    north, east = np.gradient(height)
    shade = (1 + 0.7 * (north - east)) / np.sqrt(1 + north**2 + east**2)
    extent = (low[0], high[0], low[1], high[1])
    axes.imshow(shade, cmap="gray", origin="lower", extent=extent, vmin=-0.3, vmax=2)
    missed, taken = tile.ground & ~of.found, ~tile.ground & of.found
    for chosen, colour, label in ((missed, "red", "missed"), (taken, "blue", "taken")):
        size = 0.6
        axes.scatter(*tile.xyz[chosen, :2].T, size, colour, label=f"{label}: {chosen.sum()}")
    objects = int((~tile.ground).sum())
    print(f"{tile.name}: of {tile.ground.sum()} ground {missed.sum()} missed, of {objects} objects "
          f"{taken.sum()} taken")  # fmt: skip
    axes.set_title(f"sample {tile.name[4:6]}")
    axes.legend(fontsize=7, loc="lower right", markerscale=6)


def main(folder: Path, picture: Path | None) -> None:
    """Print, and draw."""
    figure = Figure(figsize=(20, 8), layout="constrained")
    axes = figure.subplots(2, 5)
    for column, name in enumerate(HEATHS):
        heath(judged(folder, name), axes[0, column], axes[1, column])
    of_town = judged(folder, TOWN)
    town(of_town, axes[0, 2])
    too_high(of_town, axes[0, 3], axes[1, 3])
    mistakes(judged(folder, SAMPLES[0]), axes[1, 2])
    grid = axes[0, 4].get_gridspec()
    for spare in axes[:, 4]:
        spare.remove()
    mistakes(judged(folder, SAMPLES[1]), figure.add_subplot(grid[:, 4]))
    if picture:
        figure.savefig(picture, dpi=90)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("picture", type=Path, nargs="?")
    given = parser.parse_args()
    main(given.folder, given.picture)
