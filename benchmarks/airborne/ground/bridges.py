"""Bridges of any width, depth and direction: ``python -m benchmarks.airborne.ground.bridges``.

A level deck of ``--widths`` spans a valley of ``--depths``, whose floor is ``--floor`` wide and
whose sides rise by ``--slope``, turned by ``--azimuths`` off the grid, with trees on a fifth of the
ground; default settings. Of each the table says, in metres and cells of 1 m,

- ``floor``: the largest error of the terrain on the valley's floor below the deck;
- ``deck``: the largest error below the deck, and ``cells``: how many are off by more than 0.5 m
  there;
- ``rest``: the largest error elsewhere, two cells and more off the deck.

A bridge is *held* where no cell of the floor is off by more than 0.5 m, else *told* by a warning
that says what is off, else *SILENT*; so are its ``ends``, all cells below the deck and beside it.
"""

import argparse
import itertools
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from scipy import ndimage

from benchmarks.airborne.ground import steep
from benchmarks.airborne.ground.steep_scenes import COMMON, EDGE_M
from benchmarks.airborne.told import kinds, telling
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.engine.verbs.running import run

LARGEST_M: Final = 0.5
"""Largest error that is held [m]."""

BEYOND_M: Final = 4.0
"""How far a deck reaches beyond the valley's edges [m]."""

SAYS: Final = ("deck", "deck end", "dam", "steep", "roof")
"""Kinds of warnings that say what is off."""


class Bridge(NamedTuple):
    """A bridge over a valley.

    Parameters
    ----------
    width_m, depth_m : float
        Width of the deck, and depth of the valley [m].
    azimuth_deg : float
        Direction of the deck off the grid's east [degrees].
    slope_deg : float
        How steep the valley's sides are [degrees].
    floor_m : float
        Width of the valley's floor [m].
    """

    width_m: float
    depth_m: float
    azimuth_deg: float
    slope_deg: float
    floor_m: float

    def strip(self, half_m: float, aside_m: float) -> list[tuple[float, float]]:
        """Corners of a rectangle around the middle, so long along the deck and across it [m]."""
        turn = math.radians(self.azimuth_deg)
        along = np.array([math.cos(turn), math.sin(turn)])
        across = np.array([-along[1], along[0]])
        corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        middle = np.full(2, EDGE_M / 2)
        places = [middle + s * half_m * along + t * aside_m * across for s, t in corners]
        return [(float(east), float(north)) for east, north in places]

    @property
    def half_m(self) -> float:
        """Half of the deck's length [m]."""
        side = self.depth_m / math.tan(math.radians(self.slope_deg))
        return self.floor_m / 2 + side + BEYOND_M

    def scene(self, seed: int) -> dict[str, Any]:
        """Content of a scene file."""
        form = {
            "ring_m": self.strip(self.floor_m / 2, 2.0 * EDGE_M),
            "slope_deg": self.slope_deg,
            "height_m": -self.depth_m,
        }
        first, last, *_ = self.strip(self.half_m, 0.0)
        return {
            **COMMON,
            "name": "bridge",
            "seed": seed,
            "trees": {"cover": 0.2},
            "terrain": {**COMMON["terrain"], "landforms": [form]},
            "bridges": [{"ends_m": [first, last], "width_m": self.width_m}],
        }


def processed(bridge: Bridge, seed: int, folder: Path) -> Path:
    """Simulate and run one survey."""
    survey = folder / ("_".join(f"{value:g}" for value in bridge) + f"_{seed}")
    if not (survey / "workflow.yaml").exists():
        simulate(parse_scene(bridge.scene(seed), "bridge"), survey)
    run(survey / "workflow.yaml", workers=0)
    return survey


def figures(bridge: Bridge, survey: Path) -> dict[str, float]:
    """Errors of the terrain."""
    truth, _ = steep.load(survey)
    dtm = steep.delivered(survey, truth)
    rows, columns = np.indices(dtm.shape)
    # A scene's own corner is that of its truth.
    east, north = columns + 0.5, dtm.shape[0] - rows - 0.5
    below, level = (
        shapely.contains_xy(shapely.Polygon(bridge.strip(half, bridge.width_m / 2)), east, north)
        for half in (bridge.half_m, bridge.floor_m / 2)
    )
    inside = np.zeros(dtm.shape, dtype=np.bool_)
    inside[steep.RIM : -steep.RIM, steep.RIM : -steep.RIM] = True
    off = np.abs(dtm - truth.height)
    rest = inside & ~ndimage.binary_dilation(below, iterations=2)
    deck = off[below & inside]
    return {
        "floor": float(np.nanmax(off[level & inside])),
        "deck": float(np.nanmax(deck)),
        "cells": float(np.sum(deck > LARGEST_M)),
        "rest": float(np.nanmax(off[rest])),
    }


def verdict(off_m: float, told: Sequence[str]) -> str:
    """Held, told or silent."""
    if off_m <= LARGEST_M:
        return "held"
    return "told" if told else "SILENT"


def main() -> None:
    """Simulate, run, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--widths", nargs="+", type=float, default=[5, 10, 15, 20, 25])
    parser.add_argument("--depths", nargs="+", type=float, default=[4, 6, 10, 15])
    parser.add_argument("--azimuths", nargs="+", type=float, default=[0, 20, 45])
    parser.add_argument("--slope", type=float, default=45.0)
    parser.add_argument("--floor", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=11)
    given = parser.parse_args()
    print("width depth azimuth   floor    deck   cells    rest")
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        for row in itertools.product(given.widths, given.depths, given.azimuths):
            bridge = Bridge(*row, given.slope, given.floor)
            survey = processed(bridge, given.seed, folder)
            found = figures(bridge, survey)
            said = steep.warnings(survey, "out")
            told = telling(said, SAYS)
            words = f"{verdict(found['floor'], told)}, ends {verdict(found['deck'], told)}"
            print(
                "{:5g} {:5g} {:7g} ".format(*row)
                + "".join(
                    f"{value:8.{0 if key == 'cells' else 2}f}" for key, value in found.items()
                )
                + f"  {words} [{', '.join(kinds(said))}]",
                flush=True,
            )


if __name__ == "__main__":
    main()
