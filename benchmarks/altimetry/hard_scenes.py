"""Scenes that are easily taken for something else: lagoons, dry hills, fog over rolling ground.

Run ``python -m benchmarks.altimetry.hard_scenes [lagoons|floors|hills|woods|fog|errors]``; by
default all of them.

lagoons  a faint surface over a bright floor, by night and by day: balanced accuracy and F1 of ours
         and of DBSCAN as published, how much of the surface is kept, how much of what is kept is
         called surface (41), how much of the floor that is kept and lies deeper than a metre is
         called floor (40), and the RMSE of the surface where the profile has one; after them
         surfaces as bright as a shallow floor, and brighter.
floors   between 2 and 28 m with slopes of 0.06 to 0.5, and sand waves of 2 m in 60 m: balanced
         accuracy, share of the floor that is kept, the same of DBSCAN, profile cells that show the
         floor, and whether a run says that it is lost.
hills    dry land of 3 to 80 m relief over 4 km, six draws each by night and by day: the share of
         its signal that is called water.
woods    closed ones of even and uneven height over rolling ground: photons of a shot that reach the
         ground, cells whose ground is off by more than 2 m, RMSE, the median error that is told,
         and cells within twice that.
fog      from 5 to 25 m above rolling ground, or above its mean, along half of a track or all of it:
         draws in which a run names at least 3 % of the signal as what may be fog, and the share of
         fog in the signal where it does not.
errors   how many errors of heights lie within once and twice the error that is told: ground on
         smooth and rough terrain, surface and floor of water.
"""

import argparse
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.labelled_tracks import (
    FLOOR,
    LAND,
    NOISE,
    SURFACE,
    Found,
    Labelled,
    measured,
    ours,
    peer,
)
from benchmarks.altimetry.odd_tracks import DAY, NIGHT, SHOT_M, Scene, always, make
from benchmarks.altimetry.photon_beams import PROFILE, RATE, Beam, lattice
from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground.lost_floor import lost_floor
from spl_batch.altimetry.noise.mist import in_mist
from spl_batch.altimetry.report.beam_warnings import floor_said
from spl_batch.altimetry.water.level_water import NO_WATER, SURFACE_M
from spl_batch.constants import QUANTA_PER_M

Numbers = NDArray[np.float64]
Along = Callable[[Numbers], Numbers]
SKIES = {"night": NIGHT, "day": DAY}
DEPTHS: dict[str, Along] = {
    "1 to 6 m": lambda x: 3.5 + 2.5 * np.sin(x / 300.0),
    "1 to 3 m": lambda x: 2.0 + np.sin(x / 200.0),
    "2 and 6 m in steps": lambda x: 2.0 + 4.0 * ((x // 250.0) % 2),
    "1.3 m": always(1.3),
}
LIGHT = ((0.1, 0.3), (0.1, 0.9), (0.25, 1.2))
"""Photons of a shot from surface and floor."""

SHALLOW: dict[str, Along] = {
    "0.9 m": always(0.9),
    "0.6 to 1.2 m": lambda x: 0.9 + 0.3 * np.sin(x / 300.0),
    "1 to 1.6 m": lambda x: 1.3 + 0.3 * np.sin(x / 200.0),
}
EVEN = ((1.0, 1.0), (1.0, 0.2), (0.3, 0.3))
"""Floors that the surface hides, and photons of a shot from both."""


def metres(track: Labelled) -> tuple[Numbers, Numbers]:
    """Photons along the track and in height."""
    along, height = track.photons
    return along / QUANTA_PER_M, height / QUANTA_PER_M


def depths_of(found: Found, track: Labelled) -> Numbers:
    """Depth of photons below what is called water, (n,) [m]; NaN elsewhere."""
    assert found.beam is not None
    scale = found.beam.scale
    cell = np.searchsorted(scale.index, track.photons[0] // round(RATE.cell_m * QUANTA_PER_M))
    return np.where(scale.calm[cell], found.beam.depth_m(*track.photons), np.nan)


def lagoons() -> None:
    """The table of lagoons."""
    heads = ("ours", "F1", "DBSCAN", "F1", "surface", "as 41", "as 40", "level m")
    print(f"{'lagoon, photons of surface, floor':42}" + "".join(f"{h:>9}" for h in heads))
    for depths, light in ((DEPTHS, LIGHT), (SHALLOW, EVEN)):
        for (name, depth_m), (surface, floor) in itertools.product(depths.items(), light):
            for sky, noise in SKIES.items():
                scene = Scene(
                    noise,
                    surface=always(surface),
                    floor=always(floor),
                    depth_m=depth_m,
                    column=0.03,
                )
                track = make("lagoon", scene, 1)
                found, theirs = ours(track), peer("dbscan")(track)
                depth, columns = depths_of(found, track), columns_of(track)
                level = columns["ground"][columns["water"] == 1]
                z = metres(track)[1]
                lit, deep = track.label == SURFACE, (track.label == FLOOR) & (z < -SURFACE_M)
                values = (
                    *measured(found.kept, track.label)[:2],
                    *measured(theirs.kept, track.label)[:2],
                    found.kept[lit].mean(),
                    (np.abs(depth[lit & found.kept]) <= SURFACE_M).mean(),
                    (depth[deep & found.kept] > SURFACE_M).mean(),
                    np.sqrt(np.nanmean(level**2)),
                )
                text = f"{name}, {surface:g}, {floor:g}, {sky}"
                print(f"{text:42}" + "".join(f"{v:9.3f}" for v in values), flush=True)


def zigzag(slope: float) -> Along:
    """A floor between 2 and 28 m."""
    return lambda x: 15.0 + 26.0 / np.pi * np.arcsin(np.sin(np.pi * slope * x / 26.0))


STEEP: dict[str, Along] = {
    **{f"slope of {slope:g}": zigzag(slope) for slope in (0.06, 0.1, 0.2, 0.3, 0.5)},
    "sand waves of 60 m": lambda x: 6.0 + 2.0 * np.sin(2.0 * np.pi * x / 60.0),
}


def floors() -> None:
    """The table of steep floors."""
    heads = ("ours", "floor", "DBSCAN", "floor", "cells", "of", "said")
    print(f"{'steep floor':32}" + "".join(f"{h:>9}" for h in heads))
    for name, depth_m in STEEP.items():
        for sky, noise in SKIES.items():
            track = make("floor", Scene(noise, floor=always(0.3), depth_m=depth_m), 1)
            found, theirs = ours(track), peer("dbscan")(track)
            assert found.beam is not None
            columns, cells = columns_of(track), found.beam.cells
            wet, seen = columns["water"] == 1, np.isfinite(columns["floor"])
            shown = cells.index[np.isfinite(cells.floor[:, 0])]
            lost = lost_floor(columns["cell"][wet], seen[wet], shown, PROFILE.cell_m)
            rates = [
                value for one in (found, theirs) for value in measured(one.kept, track.label)[::2]
            ]
            said = "yes" if any(floor_said(lost)) else ""
            text = "".join(f"{v:9.3f}" for v in rates)
            text += f"{np.count_nonzero(wet & seen):9}{np.count_nonzero(wet):9}{said:>9}"
            print(f"{f'{name}, {sky}':32}{text}", flush=True)


def wood(ground: float, noise: float, seed: int, *, even: bool) -> Labelled:
    """Closed woods, 30 m high or 10 to 30 m, with so many photons of a shot from the ground."""
    rng = np.random.default_rng(seed)
    shot = np.arange(0.0, 4000.0, SHOT_M)
    high = 30.0 if even else 20.0 + 10.0 * np.sin(shot / 17.0) * np.sin(shot / 61.0)
    at = [np.repeat(np.arange(len(shot)), rng.poisson(r, len(shot))) for r in (ground, 1.4)]
    sky = rng.uniform((0.0, -60.0), (4000.0, 90.0), (round(noise * 150.0 * 4000.0), 2))
    crowns = rolling(shot[at[1]]) + np.broadcast_to(high, shot.shape)[at[1]] * rng.beta(
        3.0, 1.6, len(at[1])
    )
    z = np.concatenate([rolling(shot[at[0]]) + rng.normal(0.0, 0.2, len(at[0])), crowns, sky[:, 1]])
    x = np.concatenate([shot[at[0]], shot[at[1]], sky[:, 0]])
    order = np.lexsort((z, x))
    label = np.repeat([LAND, LAND, NOISE], [len(at[0]), len(at[1]), len(sky)])
    return Labelled("wood", lattice(x[order], z[order]), label[order])


def rolling(x: Numbers) -> Numbers:
    """Ground of the woods."""
    return 5.0 * np.sin(x / 300.0)


def woods() -> None:
    """The table of closed woods."""
    heads = ("cells", "off 2 m", "RMSE [m]", "told", "within 2")
    print(f"{'closed woods':32}" + "".join(f"{h:>10}" for h in heads))
    for even in (True, False):
        for ground in (0.05, 0.1, 0.15, 0.3):
            for sky, noise in SKIES.items():
                parts = [columns_of(wood(ground, noise, seed, even=even)) for seed in range(2)]
                off, told = (
                    np.concatenate(values)
                    for values in zip(
                        *(
                            (one["ground"] - rolling(one["along_track"]), one["ground_error"])
                            for one in parts
                        ),
                        strict=True,
                    )
                )
                known = np.isfinite(off)
                off, told = off[known], told[known]
                values = (
                    f"{len(off):10}{np.mean(np.abs(off) > 2.0):10.2f}"
                    f"{np.sqrt(np.mean(off**2)):10.2f}{np.median(told):10.2f}"
                    f"{np.mean(np.abs(off) < 2.0 * told):10.2f}"
                )
                name = f"{'even' if even else 'uneven'}, {ground:g}, {sky}"
                print(f"{name:32}{values}", flush=True)


def terrain(seed: int, relief_m: float, falls: float) -> Along:
    """Waves of 20 m to 4 km whose heights fall by this power of their number."""
    rng = np.random.default_rng(seed)
    number = np.arange(1, 200)
    high, phase = rng.rayleigh(1.0, 199) / number**falls, rng.uniform(0.0, 2.0 * np.pi, 199)
    at = np.arange(-100.0, 4101.0)
    z = (high * np.sin(2.0 * np.pi * number * at[:, None] / 4000.0 + phase)).sum(axis=1)
    z = (z - z.min()) / np.ptp(z) * relief_m
    return lambda x: np.interp(x, at, z)


def dry(relief_m: float, falls: float, noise: float, seed: int, trees: float = 0.0) -> Labelled:
    """A track over such terrain."""
    scene = Scene(
        noise, land=((0.0, 4000.0),), land_m=terrain(seed, relief_m, falls), gate_m=(-100.0, 150.0),
        trees=trees,
    )  # fmt: skip
    return make("land", scene, seed)


def hills() -> None:
    """The table of dry hills."""
    print(f"{'dry hills':30}{'called water':>14}{'most':>8}")
    for relief_m in (3.0, 8.0, 12.0, 20.0, 40.0, 80.0):
        for falls in (1.5, 2.5):
            shares = []
            for seed in range(6):
                track = dry(relief_m, falls, (NIGHT, DAY)[seed % 2], seed)
                found = ours(track)
                wet = np.isfinite(depths_of(found, track)) & found.kept & (track.label == LAND)
                shares.append(np.count_nonzero(wet) / np.count_nonzero(track.label == LAND))
            text = f"{relief_m:g} m, {'rough' if falls < 2.0 else 'smooth'}"
            print(f"{text:30}{np.mean(shares):14.1%}{max(shares):8.1%}", flush=True)


def foggy(land_m: Along, light: Along, noise: float, seed: int, *, level: bool) -> Labelled:
    """Fog from 5 to 25 m above the ground, or above its mean, where light is lost."""
    rng = np.random.default_rng([seed, 9])
    shot = np.arange(0.0, 4000.0, SHOT_M)
    foot, clear = land_m(shot), light(shot)
    ground = np.repeat(np.arange(len(shot)), rng.poisson(1.2 * clear))
    fog = np.repeat(np.arange(len(shot)), rng.poisson(1.0 - clear))
    high = (foot.mean() if level else foot[fog]) + rng.uniform(5.0, 25.0, len(fog))
    fog, high = fog[high > foot[fog]], high[high > foot[fog]]
    n = rng.poisson(noise * 4000.0 * 250.0)
    x = np.concatenate([shot[ground], shot[fog], rng.uniform(0.0, 4000.0, n)])
    low = foot[ground] + rng.normal(0.0, 0.3, len(ground))
    z = np.concatenate([low, high, rng.uniform(-100.0, 150.0, n)])
    # Fog has the label of a surface here, to be told apart from the sky.
    label = np.repeat([LAND, SURFACE, NOISE], [len(ground), len(fog), n])
    order = np.lexsort((z, x))
    return Labelled("fog", lattice(x[order], z[order]), label[order])


def half(light: float) -> Along:
    """Fog along half of each 1.5 km."""
    return lambda x: np.where(x % 1500.0 < 750.0, light, 1.0)


def fog() -> None:
    """The table of fog."""
    print(f"{'fog, light that it lets through':44}{'named':>12}{'share where not':>18}")
    for light in (0.0, 0.5, 0.7):
        for where, along in (("half", half(light)), ("all", always(light))):
            for level in (False, True):
                for sky, noise in SKIES.items():
                    named, missed = 0, [0.0]
                    for seed in range(6):
                        ground = terrain(seed, (20.0, 40.0, 60.0)[seed % 3], 2.0)
                        track = foggy(ground, along, noise, seed, level=level)
                        beam = Beam(track.photons, None)
                        kept = beam.keep(beam.score())
                        told = kept & in_mist(beam.cells, *metres(track), RATE)
                        if np.count_nonzero(told) >= 0.03 * np.count_nonzero(kept):
                            named += 1
                        else:
                            missed.append(float((track.label[kept] == SURFACE).mean()))
                    kind = "level" if level else "follows the ground"
                    text = f"{light:.0%}, {where} of the track, {kind}, {sky}"
                    print(f"{text:44}{named:7} of 6{max(missed):18.1%}", flush=True)


Heights = tuple[str, Numbers, Numbers]


def of_land() -> Iterator[Heights]:
    """Errors of ground, and those told."""
    for relief_m, falls in ((5.0, 2.0), (20.0, 2.0), (60.0, 2.0), (60.0, 1.5)):
        for trees in (0.0, 0.5):
            off, told = [], []
            for seed in range(4):
                track = dry(relief_m, falls, DAY, seed, trees)
                columns = columns_of(track)
                truth = terrain(seed, relief_m, falls)(columns["along_track"])
                off.append(columns["ground"] - truth)
                told.append(columns["ground_error"])
            name = f"land, {relief_m:g} m, {'rough' if falls < 2.0 else 'smooth'}, trees {trees:g}"
            yield name, np.concatenate(off), np.concatenate(told)


def of_water() -> Iterator[Heights]:
    """Errors of surface and floor, and those told."""
    for name, scene in {
        "water, floor at 3 to 17 m": Scene(),
        "by day": Scene(DAY),
        "lagoon, 1 to 6 m": Scene(
            surface=always(0.3), floor=always(0.8), depth_m=DEPTHS["1 to 6 m"]
        ),
        "rough floor": Scene(floor_rough_m=0.5),
    }.items():
        off: dict[str, list[Numbers]] = {"ground": [], "floor": []}
        told: dict[str, list[Numbers]] = {"ground": [], "floor": []}
        for seed in range(4):
            columns = columns_of(make(name, scene, seed))
            at = columns["along_track"]
            for kind, truth in (("ground", 0.0 * at), ("floor", -scene.depth_m(at))):
                off[kind].append(columns[kind] - truth)
                told[kind].append(columns[f"{kind}_error"])
        for kind, what in (("ground", "surface"), ("floor", "floor")):
            yield f"{name}: {what}", np.concatenate(off[kind]), np.concatenate(told[kind])


def columns_of(track: Labelled) -> dict[str, Numbers]:
    """Profile of a track, as a run makes it."""
    beam = Beam(track.photons, None)
    score = beam.score()
    kept = beam.keep(score)
    along, height = track.photons
    rows = np.flatnonzero(kept | beam.keep(score, ground=True))
    rows = rows[np.lexsort((height[rows], along[rows]))]
    cell = np.searchsorted(beam.scale.index, along[rows] // round(RATE.cell_m * QUANTA_PER_M))
    level = np.where(beam.scale.calm, beam.scale.level, NO_WATER)[cell].astype(np.int64)
    photons = along[rows], height[rows], kept[rows]
    return over_water.profile(photons, level, (-(10**9), 10**9), (PROFILE, 0.0), 0.0)


def errors() -> None:
    """The table of errors."""
    print(f"{'heights':38}{'cells':>8}{'within 1':>10}{'2':>8}{'RMSE [m]':>10}{'told':>8}")
    for name, off, told in (*of_land(), *of_water()):
        known = np.isfinite(off)
        one, two = ((np.abs(off) < k * told)[known].mean() for k in (1.0, 2.0))
        rmse, size = np.sqrt(np.mean(off[known] ** 2)), np.median(told[known])
        print(f"{name:38}{known.sum():8}{one:10.2f}{two:8.2f}{rmse:10.3f}{size:8.3f}", flush=True)


TABLES = {
    "lagoons": lagoons,
    "floors": floors,
    "hills": hills,
    "woods": woods,
    "fog": fog,
    "errors": errors,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.hard_scenes", description=__doc__
    )
    parser.add_argument("tables", nargs="*", metavar="TABLE", default=list(TABLES))
    for name in parser.parse_args(arguments).tables:
        TABLES[name]()


if __name__ == "__main__":
    main()
