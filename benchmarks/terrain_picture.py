"""What bounds the terrain: ``python -m benchmarks.terrain_picture TILE... [--png PNG]``.

Of each classified tile (LAS or LAZ) the strip of 4 m in which a run's ground is farthest from the
producer's, in a profile: returns, the producer's ground and ours as TINs along the middle.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.held import tiles
from benchmarks.held.truth import Grid, Mask

PNG: Final = Path("docs/images/ground_profiles.png")

WIDE_M: Final = 4.0
"""Width of a strip [m]."""

LONG_M: Final = 60.0
"""Length of what is drawn of it [m]."""


def worst(tile: tiles.Tile, mask: Mask) -> tuple[Grid, Grid, Grid]:
    """Places along the strip of the largest error, and both terrains there: (n, 2), (n,), (n,) [m].

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
    off[np.isfinite(off).mean(axis=1) < 0.9] = 0.0  # a strip beyond the ground of one
    number = np.nanmean(np.square(off), axis=1).argmax()
    return places[number], ours[number], theirs[number]


def main() -> None:
    """Draw a profile of each tile, one below the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("tile", nargs="+", type=Path)
    parser.add_argument("--png", type=Path, default=PNG)
    given = parser.parse_args()
    figure = Figure(figsize=(9, 3.2 * len(given.tile)))
    axes = figure.subplots(len(given.tile), squeeze=False)
    for path, axis in zip(given.tile, axes[:, 0], strict=True):
        tile = tiles.read(path)
        if tile is None:
            parser.error(f"{path}: no ground of a producer, or few points")
        with tempfile.TemporaryDirectory() as scratch:
            mask, _ = tiles.called(tile.xyz, Path(scratch) / "tile")
        places, ours, theirs = worst(tile, mask)
        near = np.abs(tile.xyz[:, 1] - places[0, 1]) <= WIDE_M / 2
        near &= (tile.xyz[:, 0] >= places[0, 0]) & (tile.xyz[:, 0] <= places[-1, 0])
        for some, colour, label in (
            (near & ~tile.ground, "0.75", "other returns"),
            (near & tile.ground, "tab:orange", "the producer's ground"),
        ):
            axis.scatter(*tile.xyz[some][:, [0, 2]].T, s=3, color=colour, label=label)
        axis.plot(places[:, 0], theirs, color="tab:orange", label="TIN of the producer's ground")
        axis.plot(places[:, 0], ours, color="tab:blue", label="TIN of ours")
        low = np.nanmin([ours, theirs]) - 1.0
        axis.set(ylim=(low, np.nanmax([ours, theirs]) + 6.0), ylabel="height [m]")
        axis.set_title(path.name, loc="left", fontsize=9)
    axes[0, 0].legend(fontsize=8, loc="upper right")
    axes[-1, 0].set_xlabel("easting in the tile [m]")
    figure.tight_layout()
    figure.savefig(given.png, dpi=110)


if __name__ == "__main__":
    main()
