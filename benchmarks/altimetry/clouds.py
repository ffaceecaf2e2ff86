"""Clouds and fog of all heights, and woods that look like them.

Run ``python -m benchmarks.altimetry.clouds``; ``--seeds N`` draws each N times. The first table has
scenes of :mod:`benchmarks.altimetry.odd_tracks` with a cloud: how much of it stays signal, how much
of that a reader is told of, and F1. The second one has woods that nearly hide the ground: how much
of their signal is taken for a cloud, the mean and the most of the draws, and how much is told of.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.labelled_tracks import LAND, NOISE, Labelled, measured
from benchmarks.altimetry.odd_tracks import BRIGHT, DAY, NIGHT, Scene, make, thin
from benchmarks.altimetry.photon_beams import RATE, Beam, lattice
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.fog import fog_at
from spl_batch.altimetry.noise.mist import in_mist

Numbers = NDArray[np.float64]
SKIES = {"night": NIGHT, "day": DAY, "bright": BRIGHT}

HILLS = Scene(
    land=((0.0, 4000.0),), land_m=lambda x: 20.0 * np.sin(x / 150.0), gate_m=(-120.0, 180.0)
)
CLOUDS = {
    "at 90 to 130 m": replace(HILLS, clear=thin(1500.0, 0.6), fog=(1.0, 90.0, 130.0)),
    "the same, hides 2.7 km": replace(
        HILLS,
        clear=lambda x: np.where((x > 700.0) & (x < 3400.0), 0.0, 1.0),
        fog=(1.0, 90.0, 130.0),
    ),
    "at 40 to 60 m": replace(HILLS, clear=thin(1500.0, 0.6), fog=(1.0, 40.0, 60.0)),
    "at 22 to 45 m, hides 600 m": replace(
        HILLS,
        clear=lambda x: np.where((x / 1500.0) % 1.0 < 0.4, 0.0, 1.0),
        fog=(1.0, 22.0, 45.0),
    ),
    "on a plain, 30 m thick": replace(
        HILLS, land_m=lambda x: 0.0 * x, clear=thin(1500.0, 0.5), fog=(1.0, 0.0, 30.0)
    ),
    "over water, 8 to 25 m": Scene(clear=thin(1500.0, 0.2), fog=(0.5, 8.0, 25.0)),
}


def rise(height_m: float, long_m: float) -> Callable[[Numbers], Numbers]:
    """A level lake, a slope from 1500 m on, and a plateau."""
    return lambda x: np.clip((x - 1500.0) / long_m, 0.0, 1.0) * height_m


WOODED: dict[str, Callable[[Numbers], Numbers]] = {
    "slope of 17 degrees by a lake": rise(150.0, 500.0),
    "slope of 34 degrees by a lake": rise(200.0, 300.0),
    "slope of 45 degrees by a lake": rise(300.0, 300.0),
    "mountains": lambda x: 150.0 + 150.0 * np.sin(x / 450.0),
    "ridge between fields": lambda x: 150.0 * np.exp(-(((x - 2000.0) / 250.0) ** 2)),
}


def woods(
    land_m: Callable[[Numbers], Numbers], ground_per_shot: float, noise: float, seed: int
) -> Labelled:
    """Woods of 0.8 photons a shot from 2 to 30 m above the ground, with little of that."""
    rng = np.random.default_rng(seed)
    shot = np.arange(0.0, 4000.0, 0.7)
    foot = land_m(shot)
    bare = (np.abs(shot - 2000.0) > 450.0) & (foot < 1.0)
    per_shot = np.where(bare, 0.9, ground_per_shot)
    ground = np.repeat(np.arange(len(shot)), rng.poisson(per_shot))
    trees = np.repeat(np.arange(len(shot)), rng.poisson(np.where(bare, 0.0, 0.8)))
    n = rng.poisson(noise * 4000.0 * 440.0)
    x = np.concatenate([shot[ground], shot[trees], rng.uniform(0.0, 4000.0, n)])
    z = np.concatenate(
        [
            foot[ground] + rng.normal(0.0, 0.15, len(ground)),
            foot[trees] + rng.uniform(2.0, 30.0, len(trees)),
            rng.uniform(-60.0, 380.0, n),
        ]
    )
    label = np.repeat([LAND, NOISE], [len(ground) + len(trees), n])
    order = np.argsort(x, kind="stable")
    return Labelled("woods", lattice(x[order], z[order]), label[order])


def metres(track: Labelled) -> tuple[Numbers, Numbers]:
    """Photons along the track and in height."""
    along, height = track.photons
    return along / 1000.0, height / 1000.0


def clouds(seeds: int) -> None:
    """The table of clouds."""
    print(f"{'cloud':36}{'photons':>9}{'signal':>9}{'told of':>9}{'F1':>8}")
    for name, scene in CLOUDS.items():
        for sky, noise in SKIES.items():
            found = np.zeros(4)
            for seed in range(seeds):
                track = make(name, replace(scene, noise_per_m2=noise), seed)
                x, z = metres(track)
                low, high = scene.fog[1:]
                cloud = (track.label == NOISE) & (z >= low) & (z < high) & (scene.clear(x) < 1.0)
                beam = Beam(track.photons, None)
                kept = beam.keep(beam.score())
                misty = in_mist(beam.cells, x, z, RATE)
                parts = (cloud, kept & cloud, kept & cloud & misty)
                found += [*map(np.count_nonzero, parts), measured(kept, track.label)[1]]
            photons, signal, told, f1 = found / seeds
            shares = signal / photons, told / max(signal, 1.0)
            print(f"{name + ', ' + sky:36}{photons:9.0f}{shares[0]:9.1%}{shares[1]:9.1%}{f1:8.3f}")


def wooded(seeds: int) -> None:
    """The table of woods."""
    print(f"{'woods, ground photons':42}{'cloud':>9}{'most':>9}{'told of':>9}")
    for name, land_m in WOODED.items():
        for ground in (0.04, 0.2):
            for sky, noise in SKIES.items():
                lost, told = [], []
                for seed in range(seeds):
                    track = woods(land_m, ground, noise, seed)
                    cells = rates.observe(*track.photons, RATE)
                    signal = track.label != NOISE
                    cell = np.searchsorted(cells.index, track.photons[0] // 20_000)
                    fog = fog_at(cell, track.photons[1], cells.fog_low, cells.fog) > 0.0
                    lost.append(fog[signal].mean())
                    told.append(in_mist(cells, *metres(track), RATE)[signal].mean())
                text = f"{name}, {ground / (ground + 0.8):.0%}, {sky}"
                print(f"{text:42}{np.mean(lost):9.1%}{max(lost):9.1%}{np.mean(told):9.1%}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.clouds", description=__doc__
    )
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args(arguments)
    clouds(options.seeds)
    wooded(options.seeds)


if __name__ == "__main__":
    main()
