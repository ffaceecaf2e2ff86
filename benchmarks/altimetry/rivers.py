"""Rivers and ponds between banks, and land that is as level as they are.

Run ``python -m benchmarks.altimetry.rivers``; ``--seeds N`` draws N of each.

Tracks of 4 km are drawn as of :mod:`benchmarks.altimetry.unseen_tracks`, by night and by day, of a
strong beam and of a weak one with 0.3 of its photons. Banks are 4 m high and roll by 2 m, bare or
under woods; a river has a floor between 1.5 and 4.5 m, scattered light alone, or nothing below its
surface. Printed are shares of the photons that are kept: surface called 41, floor more than a metre
deep called 40, land called water; and how much of the water is told of as what may be a river.
"""

import argparse
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.labelled_tracks import FLOOR, LAND, SURFACE, ours
from benchmarks.altimetry.photon_beams import RATE
from benchmarks.altimetry.unseen_tracks import Country
from spl_batch.altimetry.water.level_water import SURFACE_M
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

Numbers = NDArray[np.float64]
Mask = NDArray[np.bool_]
SKIES = {"night": 2e-4, "day": 0.012}
BEAMS = {"strong": 1.0, "weak": 0.3}


def river(
    wide_m: float, floor: float = 0.25, scattered: float = 0.08, trees: float = 0.0
) -> Callable[[Country, float], Mask]:
    """A river in the middle of the track."""

    def draw(c: Country, light: float) -> Mask:
        off = np.abs(c.x - 2000.0) - wide_m / 2.0
        wet = off < 0.0
        roll = 1.5 * np.sin(c.x / 110.0) + np.sin(c.x / 37.0) + 0.3 * np.sin(c.x / 11.0)
        bank = np.clip(0.3 * off, 0.0, 4.0) + roll * np.clip(off / 40.0, 0.0, 1.0)
        pour(c, light, wet, (1.0, floor, scattered), 3.0 + 1.5 * np.sin(c.x / 70.0))
        c.ground(light * ~wet, bank, 0.15)
        c.trees(trees * light * (off > 20.0), bank, 14.0)
        return wet

    return draw


def pour(
    c: Country, light: float, wet: Mask, rates: tuple[float, float, float], depth_m: Numbers
) -> None:
    """Water at 0 m: photons of a shot from surface, floor and scattered light."""
    surface, floor, scattered = (light * rate * wet for rate in rates)
    c.layer(surface, 0.0, SURFACE, lambda n: c.rng.normal(0.0, 0.1, n))
    c.floor(floor, -depth_m, 0.2)
    c.layer(scattered, 0.0, 1, lambda n: -c.rng.exponential(2.0, n))


def ponds(c: Country, light: float) -> Mask:
    """Ponds of 250 m with a bottom that is brighter than their surface."""
    place = c.x % 900.0
    wet = place < 250.0
    pour(c, light, wet, (0.4, 1.0, 0.02), 2.5 * np.sin(np.pi * np.clip(place / 250.0, 0.0, 1.0)))
    rise = np.minimum(np.minimum(np.abs(place - 250.0), 900.0 - place) / 10.0, 1.5)
    c.ground(light * ~wet, rise + 0.5 * np.sin(c.x / 23.0) * (rise >= 1.5), 0.15)
    return wet


def level_banks(c: Country, light: float) -> Mask:
    """A lake of 1.8 km beside land 2 m higher that rolls by 0.25 m."""
    off = np.abs(c.x - 2000.0) - 900.0
    wet = off < 0.0
    pour(c, light, wet, (1.0, 0.25, 0.08), 3.0 + np.sin(c.x / 70.0))
    land = np.clip(0.3 * off, 0.0, 2.0) + 0.25 * np.sin(c.x / 50.0) * (off > 0.0)
    c.ground(light * ~wet, land, 0.1)
    return wet


def fields(c: Country, light: float) -> Mask:
    """Level fields of 180 m at several heights, every other one with crops of 1 to 2.2 m."""
    field = (c.x // 180.0).astype(np.int64)
    height = 0.6 * ((field * 7919) % 5)
    c.ground(0.5 * light, height, 0.06)
    crops = 0.6 * light * (field % 2 == 0)
    c.layer(crops, height, LAND, lambda n: c.rng.uniform(1.0, 2.2, n))
    return np.zeros(len(c.x), np.bool_)


def woods(c: Country, light: float) -> Mask:
    """Woods on low hills, a fifth of the photons from the ground."""
    hill = 12.0 * np.sin(c.x / 300.0)
    c.ground(0.25 * light, hill, 0.2)
    c.trees(1.0 * light, hill, 22.0)
    return np.zeros(len(c.x), np.bool_)


KINDS: dict[str, Callable[[Country, float], Mask]] = {
    **{f"river of {m:g} m": river(m) for m in (100.0, 200.0, 400.0, 1000.0, 2000.0)},
    "river of 400 m, woods": river(400.0, trees=0.6),
    "river of 400 m, scatters": river(400.0, floor=0.0, scattered=0.15),
    "river of 400 m, dark": river(400.0, floor=0.0, scattered=0.0),
    "ponds of 250 m": ponds, "lake, level banks": level_banks,
    "fields and crops": fields, "woods": woods,
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.rivers", description=__doc__
    )
    parser.add_argument("--seeds", type=int, default=2)
    seeds = parser.parse_args(arguments).seeds
    heads = ("as 41", "as 40", "land", "maybe")
    print(f"{'':36}" + "".join(f"{head:>8}" for head in heads))
    for name, draw in KINDS.items():
        for sky, noise in SKIES.items():
            for beam, light in BEAMS.items():
                found = [shares(draw, light, noise, seed) for seed in range(seeds)]
                text = "".join(
                    "       -" if np.isnan(v) else f"{v:8.2f}" for v in np.mean(found, 0)
                )
                print(f"{f'{name}, {sky}, {beam}':36}{text}", flush=True)


def shares(
    draw: Callable[[Country, float], Mask], light: float, noise: float, seed: int
) -> list[float]:
    """Shares as of the table; NaN of what is not there."""
    c = Country(seed)
    wet = draw(c, light)
    c.sky(noise, (-50.0, 60.0))
    track = c.labelled("river")
    mine = ours(track)
    assert mine.beam is not None
    cells, (along, height) = mine.beam.cells, track.photons
    at = np.searchsorted(cells.index, along // quanta(RATE.cell_m))
    depth = (cells.level[at].astype(np.float64) - height) / QUANTA_PER_M
    water = cells.calm[at] & (depth >= -SURFACE_M)
    surface = water & (depth <= SURFACE_M)
    kept, deep = mine.kept, height < -SURFACE_M * QUANTA_PER_M
    rows = np.searchsorted(c.x, cells.index * RATE.cell_m + RATE.cell_m / 2.0)
    river = wet[np.minimum(rows, len(wet) - 1)]
    chosen = (
        (kept & (track.label == SURFACE), surface),
        (kept & (track.label == FLOOR) & deep, water & ~surface),
        (kept & (track.label == LAND), water),
    )
    values = [called[some].mean() if some.any() else np.nan for some, called in chosen]
    return [*values, cells.maybe[river].mean() if river.any() else cells.maybe.mean()]


if __name__ == "__main__":
    main()
