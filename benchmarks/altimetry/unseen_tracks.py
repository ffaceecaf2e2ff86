"""Tracks of many kinds of country that nothing was chosen on, beside published filters.

Run ``python -m benchmarks.altimetry.unseen_tracks``; ``--seeds N`` takes N of each, ``--only NAME``
those whose name has this in it, ``--picture FOLDER`` draws them.

Photons come by shots of 0.7 m, as of :mod:`benchmarks.altimetry.odd_tracks`, several of one shot
from one surface. Printed are balanced accuracy, F1 and the noise told over the true one of ours,
and balanced accuracy and F1 of DBSCAN and kNN + Otsu as published. A track is marked where one of
them is ahead by more than 0.05 in either.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.labelled_tracks import (
    FLOOR,
    LAND,
    NOISE,
    SURFACE,
    Labelled,
    draw,
    measured,
    ours,
    peer,
)
from benchmarks.altimetry.photon_beams import lattice

SHOT_M = 0.7
AHEAD = 0.05
"""More than a published filter may be ahead by."""

THEIRS = ("dbscan", "knn_otsu")

Numbers = NDArray[np.float64]


class Country:
    """Shots of a track, to which layers of photons are added."""

    def __init__(self, seed: int, length_m: float = 4000.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.x = np.arange(0.0, length_m, SHOT_M)
        self.parts: list[tuple[Numbers, Numbers, int]] = []

    def layer(
        self,
        rate: float | Numbers,
        height_m: float | Numbers,
        kind: int,
        spread: Callable[[int], Numbers],
    ) -> None:
        """Photons about a height; so many a shot in the mean."""
        n = len(self.x)
        at = np.repeat(np.arange(n), self.rng.poisson(np.broadcast_to(rate, n)))
        height = np.broadcast_to(height_m, n)[at]
        self.parts.append((self.x[at], height + spread(len(at)), kind))

    def ground(self, rate: float | Numbers, height_m: float | Numbers, rough_m: float) -> None:
        """A surface of land."""
        self.layer(rate, height_m, LAND, lambda n: self.rng.normal(0.0, rough_m, n))

    def water(self, rate: float | Numbers, height_m: float | Numbers, rough_m: float) -> None:
        """A surface of water, and a little of the light that it scatters."""
        self.layer(rate, height_m, SURFACE, lambda n: self.rng.normal(0.0, rough_m, n))
        self.layer(0.03 * rate, height_m, NOISE, lambda n: -self.rng.exponential(3.0, n))

    def trees(self, rate: float | Numbers, foot_m: float | Numbers, high_m: float) -> None:
        """Crowns, densest in their upper half."""
        self.layer(rate, foot_m, LAND, lambda n: high_m * self.rng.beta(4.0, 2.0, n))

    def floor(self, rate: float | Numbers, height_m: float | Numbers, rough_m: float) -> None:
        """A floor below water."""
        self.layer(rate, height_m, FLOOR, lambda n: self.rng.normal(0.0, rough_m, n))

    def sky(self, per_m2: float | Numbers, gate_m: tuple[float, float]) -> None:
        """Noise all over the gate."""
        rate = np.asarray(per_m2) * SHOT_M * (gate_m[1] - gate_m[0])
        self.layer(rate, 0.0, NOISE, lambda n: self.rng.uniform(*gate_m, n))

    def labelled(self, name: str) -> Labelled:
        """The photons in order."""
        x, z = (np.concatenate([part[i] for part in self.parts]) for i in range(2))
        label = np.concatenate([np.full(len(part[0]), part[2]) for part in self.parts])
        order = np.lexsort((z, x))
        return Labelled(name, lattice(x[order], z[order]), label[order].astype(np.int64))


def river_between_woods(c: Country) -> None:
    """Rivers of 150 m, 4 m below woods of 22 m."""
    river = c.x % 1300.0 < 150.0
    bank = 2.0 * np.sin(c.x / 500.0)
    c.water(1.5 * river, -4.0, 0.08)
    c.ground(0.35 * ~river, bank, 0.2)
    c.trees(1.1 * ~river, bank, 22.0)
    c.sky(0.012, (-60.0, 60.0))


def reef_with_waves(c: Country) -> None:
    """Chop and swell over a reef between 1.5 and 12 m deep."""
    sea = 0.3 * np.sin(c.x / 6.0)
    c.water(1.0, sea, 0.25)
    c.floor(0.35, -6.5 - 5.0 * np.sin(c.x / 170.0), 0.4)
    c.sky(0.02, (-45.0, 35.0))


def salt_flat(c: Country) -> None:
    """Bright level ground under a bright sky."""
    c.ground(3.0, 0.00005 * c.x, 0.05)
    c.sky(0.06, (-40.0, 60.0))


def steep_island(c: Country) -> None:
    """A cone of slope 0.8 in the sea, by night."""
    land = 250.0 - 0.8 * np.abs(c.x - 2000.0)
    ashore = land > 0.0
    c.ground(0.9 * ashore, land, 0.5)
    c.trees(0.5 * ashore, land, 12.0)
    c.water(1.2 * ~ashore, 0.0, 0.15)
    c.floor(0.2 * (~ashore & (land > -25.0)), land * 0.6, 0.3)
    c.sky(0.0003, (-60.0, 320.0))


def snow_with_fog(c: Country) -> None:
    """A bright plain, along half of it a fog of 60 m that takes half of the light."""
    fog = np.clip(2.0 * np.sin(c.x / 450.0), 0.0, 1.0)
    c.ground(3.5 * (1.0 - 0.5 * fog), 0.004 * c.x, 0.08)
    c.layer(0.5 * fog, 0.004 * c.x, NOISE, lambda n: c.rng.uniform(0.0, 60.0, n))
    c.sky(0.05, (-80.0, 120.0))


def town_at_a_lake(c: Country) -> None:
    """Streets and roofs of 6 to 24 m for two kilometres, then a lake."""
    town = c.x < 2000.0
    block = (c.x // 35.0).astype(np.int64)
    roof = 6.0 + 6.0 * ((block * 7919) % 4)
    built = town & (c.x % 35.0 < 20.0)
    c.ground(1.0 * (town & ~built), 2.0, 0.15)
    c.ground(1.0 * built, 2.0 + roof, 0.1)
    c.trees(0.15 * (town & ~built), 2.0, 9.0)
    c.water(0.8 * ~town, 0.0, 0.06)
    c.sky(0.015, (-70.0, 80.0))


def marsh(c: Country) -> None:
    """Reeds of 2.5 m in patches over shallow water, by day."""
    reeds = np.sin(c.x / 40.0) > -0.2
    c.water(np.where(reeds, 0.4, 1.2), 0.0, 0.06)
    c.layer(0.7 * reeds, 0.0, LAND, lambda n: 2.5 * c.rng.beta(2.0, 2.0, n))
    c.sky(0.02, (-40.0, 40.0))


def dunes(c: Country) -> None:
    """Bare dunes of 60 m, slopes up to 0.9, by night."""
    c.ground(1.2, 30.0 * np.sin(c.x / 33.0 + np.sin(c.x / 170.0)), 0.2)
    c.sky(0.0003, (-100.0, 100.0))


def taiga(c: Country) -> None:
    """Hills under sparse spruces by night: a tenth of the photons from the ground."""
    hill = 60.0 * np.sin(c.x / 400.0)
    c.ground(0.08, hill, 0.2)
    c.trees(0.7, hill, 17.0)
    c.sky(0.0004, (-120.0, 120.0))


def ice_sheet(c: Country) -> None:
    """A bright slope with crevasses of 12 m, by day."""
    crack = c.x % 90.0 < 8.0
    c.ground(3.0 * np.where(crack, 0.4, 1.0), 0.02 * c.x - 12.0 * crack, 0.15)
    c.sky(0.05, (-60.0, 140.0))


def fjord(c: Country) -> None:
    """Water a kilometre wide between walls of 45 degrees, by day."""
    wall = np.abs(c.x - 2000.0) - 500.0
    ashore = wall > 0.0
    c.ground(0.7 * ashore, np.minimum(wall, 400.0), 0.8)
    c.water(0.9 * ~ashore, 0.0, 0.1)
    c.sky(0.012, (-60.0, 460.0))


def open_sea(c: Country) -> None:
    """Swell of 3 m from crest to trough, by night; nothing below."""
    c.water(0.8, 1.5 * np.sin(2.0 * np.pi * c.x / 140.0), 0.25)
    c.sky(0.0002, (-60.0, 40.0))


def sea_ice(c: Country) -> None:
    """Floes 0.3 m above dark leads, ridges of 2 m, under a low sun."""
    lead = c.x % 230.0 < 40.0
    ridge = 2.0 * np.exp(-(((c.x % 310.0 - 150.0) / 4.0) ** 2))
    c.ground(2.5 * ~lead, 0.3 + ridge, 0.06)
    c.water(0.4 * lead, 0.0, 0.04)
    c.sky(0.006, (-50.0, 50.0))


def savanna(c: Country) -> None:
    """A weak beam by day: thin ground and lone trees of 8 m."""
    crown = (c.x % 60.0) < 12.0
    hill = 12.0 * np.sin(c.x / 600.0)
    c.ground(np.where(crown, 0.2, 0.35), hill, 0.15)
    c.trees(0.2 * crown, hill, 8.0)
    c.sky(0.01, (-70.0, 70.0))


def storm(c: Country) -> None:
    """Waves of 0.8 m over a floor at 8 to 16 m, by day."""
    c.water(1.0, 0.0, 0.8)
    c.floor(0.2, -12.0 - 4.0 * np.sin(c.x / 200.0), 0.3)
    c.sky(0.02, (-60.0, 40.0))


def block_field(c: Country) -> None:
    """A level field of blocks under a bright sky."""
    c.ground(1.0, 0.001 * c.x, 0.8)
    c.sky(0.06, (-60.0, 60.0))


KINDS: tuple[Callable[[Country], None], ...] = (
    river_between_woods, reef_with_waves, salt_flat, steep_island, snow_with_fog, town_at_a_lake,
    marsh, dunes, taiga, ice_sheet, fjord, open_sea, sea_ice, savanna,
    storm, block_field,
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each track, and how many are behind."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.unseen_tracks", description=__doc__
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", default="", help="tracks whose name has this in it")
    parser.add_argument("--picture", type=Path, metavar="FOLDER")
    options = parser.parse_args(arguments)
    heads = "".join(f"{name:>14}" for name in THEIRS)
    print(f"{'balanced, F1':24}{'ours':>14}  told{heads}")
    behind = every = 0
    for kind in KINDS:
        name = kind.__name__.replace("_", " ")
        for seed in range(options.seeds if options.only in name else 0):
            country = Country(seed)
            kind(country)
            track = country.labelled(name)
            mine = ours(track)
            found = [mine, *(peer(other)(track) for other in THEIRS)]
            cells = np.array([measured(one.kept, track.label)[:2] for one in found])
            short = bool((cells[1:] - cells[0] > AHEAD).any())
            false = np.count_nonzero(mine.kept & (track.label == NOISE))
            numbers = ["".join(f"{v:7.3f}" for v in cell) for cell in cells]
            numbers.insert(1, f"{mine.told / max(false, 1):6.2f}")
            print(f"{name:24}{''.join(numbers)}{'  behind' if short else ''}", flush=True)
            behind, every = behind + short, every + 1
            if options.picture:
                draw(track, mine, options.picture)
    print(f"{every} tracks, {behind} behind a published filter by more than {AHEAD}")


if __name__ == "__main__":
    main()
