"""What bounds the terrain: ``python -m benchmarks.terrain_picture [TILE...] [--png PNG]``.

Of simulated scenes, and of each classified tile (LAS or LAZ), the 4 m in which a run's ground is
farthest from the true or the producer's one, in a profile: returns, and both grounds as TINs along
the middle.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.held import scenes, surveys, tiles, truth
from benchmarks.held.truth import Grid, Mask
from spl_batch.constants import CLASS_GROUND

PNG: Final = Path("docs/images/ground_profiles.png")

SCENES: Final = ("ridges 50 deg, trees", "bridge over a valley")
"""Simulated scenes that are drawn, tiles or none."""

WIDE_M: Final = 4.0
"""Width of a profile [m]."""

LONG_M: Final = 60.0
"""Length of what is drawn of it [m]."""


def worst(tile: tiles.Tile, mask: Mask) -> tuple[Grid, Grid, Grid]:
    """Where the profile of the largest error runs, and both terrains there: (n, 2), (n,), (n,) [m].

    Parameters
    ----------
    tile : Tile
        Points and the producer's classes.
    mask : (points,) bool
        Points that a run calls ground.
    """
    low, high = tile.xyz[:, :2].min(axis=0) + tiles.EDGE_M, tile.xyz[:, :2].max(axis=0)
    high = high - tiles.EDGE_M
    along = np.arange(0.0, min(LONG_M, high[0] - low[0]), 0.25)
    starts = np.arange(low[0], high[0] - along[-1], LONG_M / 4)
    middles = np.arange(low[1] + WIDE_M / 2, high[1], WIDE_M)
    places = np.stack(np.broadcast_arrays(starts[:, None, None] + along, middles[:, None]), axis=-1)
    places = places.reshape(-1, len(along), 2)
    ours, theirs = (
        tiles.terrain_at(tile.xyz[of], places.reshape(-1, 2)).reshape(-1, len(along))
        for of in (mask, tile.ground)
    )
    off = ours - theirs
    off[np.isfinite(off).mean(axis=1) < 0.9] = 0.0  # beyond the ground of one
    number = np.nanmean(np.square(off), axis=1).argmax()
    return places[number], ours[number], theirs[number]


def _simulated(name: str, folder: Path) -> tuple[tiles.Tile, Mask]:
    """Returns that a run of a scene kept, with their true ground, and what it calls ground."""
    table = truth.points(surveys.once(scenes.steep(name), folder))
    kept = table["noise_class"] == 0
    xyz = np.column_stack([table[axis][kept] for axis in "xyz"])
    classes = np.where(truth.of(table, "ground")[kept], CLASS_GROUND, 1).astype(np.uint8)
    corner = np.floor(xyz.min(axis=0))
    return tiles.Tile(xyz - corner, classes), table["classification"][kept] == CLASS_GROUND


def _drawn(name: str, path: Path | None) -> tuple[tiles.Tile, Mask]:
    """Points of a tile or, without one, of a scene, and which a run calls ground."""
    with tempfile.TemporaryDirectory() as scratch:
        if path is None:
            return _simulated(name, Path(scratch) / "scene")
        tile = tiles.read(path)
        if tile is None:
            raise SystemExit(f"{path}: no ground of a producer, or few points")
        return tile, tiles.called(tile.xyz, Path(scratch) / "tile")[0]


def main() -> None:
    """Draw a profile of each scene and tile, one below the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("tile", nargs="*", type=Path)
    parser.add_argument("--png", type=Path, default=PNG)
    given = parser.parse_args()
    drawn: list[tuple[str, str, Path | None]] = []
    drawn += [(f"{name} (simulated)", name, None) for name in SCENES]
    drawn += [(path.name, "", path) for path in given.tile]
    figure = Figure(figsize=(9, 2.8 * len(drawn)))
    axes = figure.subplots(len(drawn), squeeze=False)
    for (title, name, path), axis in zip(drawn, axes[:, 0], strict=True):
        tile, mask = _drawn(name, path)
        places, ours, theirs = worst(tile, mask)
        near = np.abs(tile.xyz[:, 1] - places[0, 1]) <= WIDE_M / 2
        near &= (tile.xyz[:, 0] >= places[0, 0]) & (tile.xyz[:, 0] <= places[-1, 0])
        for some, colour, label in (
            (near & ~tile.ground, "0.75", "other returns"),
            (near & tile.ground, "tab:orange", "ground, true or the producer's"),
        ):
            axis.scatter(*tile.xyz[some][:, [0, 2]].T, s=3, color=colour, label=label)
        axis.plot(places[:, 0], theirs, color="tab:orange", label="TIN of that ground")
        axis.plot(places[:, 0], ours, color="tab:blue", label="TIN of ours")
        low = np.nanmin([ours, theirs]) - 1.0
        axis.set(ylim=(low, np.nanmax([ours, theirs]) + 6.0), ylabel="height [m]")
        axis.set_title(title, loc="left", fontsize=9)
    axes[0, 0].legend(fontsize=8, loc="upper right")
    axes[-1, 0].set_xlabel("easting [m]")
    figure.tight_layout()
    figure.savefig(given.png, dpi=110)


if __name__ == "__main__":
    main()
