"""Tracks made of labelled ones, to see what breaks the filter.

Run ``python -m benchmarks.altimetry.varied_tracks FOLDER``; the folder is that of
:mod:`benchmarks.altimetry.labelled_tracks`. ``--only NAME`` takes variants whose name has this in
it, ``--quick`` leaves the published filters out.

Each track is thinned, brightened, moved, cut, stretched and turned. Water gets another gate,
another floor, floors that roll and are steeper, turbid water, fewer photons of noise, and land at
both ends. The land clip keeps the labels and, where the variant leaves its noise alone, the rate of
its product.

A line has F1, balanced accuracy and recall of the floor of ours, the published filter with the
largest F1, the share of the track along which no noise is seen, how many profile cells have a floor
and how many of these lie more than 4 m off all labelled floor within 60 m, and what is wrong: a
balanced
accuracy below 0.75, an F1 more than 0.01 below that of the best published filter, or everything
kept. A run warns of the last, and where no noise is seen along more than a tenth of the track.

At the end stands each variant over all tracks with water together, with the least balanced accuracy
of one, and over land. That table is what is told of tracks that nothing was chosen on.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.hard_scenes import columns_of
from benchmarks.altimetry.labelled_tracks import (
    FLOOR,
    LAND,
    NOISE,
    SURFACE,
    Labelled,
    measured,
    read_atl03,
    read_csv,
)
from benchmarks.altimetry.photon_beams import RATE, Beam, Mask
from spl_batch.altimetry.filter.peer_filters import PEERS, keep
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.photon_table import Background
from spl_batch.constants import QUANTA_PER_M

BALANCED_LEAST, F1_BEHIND = 0.75, 0.01
"""Least balanced accuracy, and most that F1 may be below that of the best published filter."""

BANDS_M = ((-75.0, 6.0), (-40.0, 12.0), (-30.0, 5.0), (-60.0, 14.0), (-35.0, 8.0), (-50.0, 6.0))
"""Gates of six blocks of track, from the mean surface [m]."""

ROLLS_M = ((1.0, 100.0), (2.0, 100.0), (2.0, 60.0), (3.0, 150.0))
"""Amplitudes and lengths of the waves that floors get [m]."""

OFF_M, AROUND_M = 4.0, 60.0
"""A floor is false that is farther off all labelled floor so near along the track [m]."""

DRAWS = 3
"""Times that photons are thinned out."""

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Points:
    """A track in metres."""

    x: Numbers
    z: Numbers
    label: NDArray[np.int64]
    background: Background | None = None

    def some(self, rows: Mask) -> "Points":
        """These photons of it."""
        return Points(self.x[rows], self.z[rows], self.label[rows], self.background)

    def and_(self, x: Numbers, z: Numbers, label: int | NDArray[np.int64]) -> "Points":
        """It and other photons; a stated rate no longer holds."""
        more = np.broadcast_to(np.asarray(label, np.int64), x.shape)
        return Points(
            np.concatenate([self.x, x]),
            np.concatenate([self.z, z]),
            np.concatenate([self.label, more]),
        )

    def labelled(self, name: str) -> Labelled:
        """On the lattice, in order."""
        x, z = (np.rint(v * QUANTA_PER_M) for v in (self.x, self.z))
        order = np.argsort(x, kind="stable")
        photons = x[order].astype(np.int64), z[order].astype(np.int32)
        return Labelled(name, photons, self.label[order], self.background)


def points(track: Labelled) -> Points:
    """A track in metres."""
    x, z = (values / QUANTA_PER_M for values in track.photons)
    return Points(x, z, track.label, track.background)


def sky(rng: np.random.Generator, one: Points, density: float) -> Points:
    """More noise all over the gate [1/m2]."""
    n = rng.poisson(density * np.ptp(one.x) * np.ptp(one.z))
    return one.and_(
        rng.uniform(one.x.min(), one.x.max(), n), rng.uniform(one.z.min(), one.z.max(), n), NOISE
    )


def general(one: Points) -> Iterator[tuple[str, Points]]:
    """Variants of any track."""
    rng = np.random.default_rng(7)
    n, noise = len(one.x), one.label == NOISE
    for share in (0.7, 0.5, 0.3, 0.25):
        for draw in range(DRAWS):
            yield f"{share:g} of all photons #{draw + 1}", one.some(rng.uniform(size=n) < share)
    for share in (0.5, 0.25):
        yield f"{share:g} of signal", one.some(noise | (rng.uniform(size=n) < share))
    yield "0.3 of noise", one.some(~noise | (rng.uniform(size=n) < 0.3))
    area = np.ptp(one.x) * np.ptp(one.z)
    for times in (2, 5):
        yield f"noise x {times}", sky(rng, one, (times - 1) * np.count_nonzero(noise) / area)
    yield "noise +0.03/m2", sky(rng, one, 0.03)
    for share in (0.5, 0.3):
        fewer = one.some(rng.uniform(size=n) < share)
        yield f"{share:g} of all, noise +0.02/m2", sky(rng, fewer, 0.02)
    yield "turned", Points(one.x.max() - one.x, one.z, one.label)
    for pace in (0.7, 1.5):
        yield f"pace x {pace:g}", Points(one.x * pace, one.z, one.label)
    third = np.minimum((one.x - one.x.min()) / np.ptp(one.x) * 3.0, 2.9).astype(np.int64)
    for i in range(3):
        yield f"thirds #{i + 1}", one.some(third == i)
    yield "613.3 m up", Points(one.x, one.z + 613.3, one.label, one.background)
    yield "90 km on, 100.3 m down", Points(one.x + 90_007.3, one.z - 100.3, one.label)
    gap = (one.x - one.x.min()) % 450.0 < 150.0
    yield "clouds, 150 of 450 m", one.some(~gap)


def pieces(one: Points, long_m: float) -> Iterator[tuple[str, Points]]:
    """First and last piece of a track."""
    low, high = one.x.min(), one.x.max()
    yield f"first {long_m:g} m", one.some(one.x < low + long_m)
    yield f"last {long_m:g} m", one.some(one.x > high - long_m)


def gated(one: Points, level: float, ends: tuple[float, float]) -> Points:
    """Photons of a gate, from the mean surface [m]."""
    return one.some((one.z > level + ends[0]) & (one.z < level + ends[1]))


def watery(one: Points, shore: Points) -> Iterator[tuple[str, Points]]:
    """Variants of a track over water; ``shore`` is an island with its noise."""
    rng = np.random.default_rng(8)
    level = float(np.median(one.z[one.label == SURFACE]))
    yield "gate 40 m", gated(one, level, (-25.0, 15.0))
    yield "gate 30 m", gated(one, level, (-22.0, 8.0))
    yield "gate ends 4 m above", gated(one, level, (-90.0, 4.0))
    block = np.clip((one.x - one.x.min()) / np.ptp(one.x) * len(BANDS_M), 0, len(BANDS_M) - 1)
    low, high = level + np.array(BANDS_M)[block.astype(np.int64)].T
    yield "gates in 6 blocks", one.some((one.z > low) & (one.z < high))
    noise, off = one.label == NOISE, np.abs(one.z - level) > 5.0
    few = told_apart(one)
    yield "empty windows", few.some(~noise | ~off | (rng.uniform(size=len(off)) < 0.02))
    yield "no noise off water", few.some(~noise | ~off)
    yield "floor at 25 to 30 m", deepened(one, level)
    for high_m, long_m in ROLLS_M:
        yield f"floor rolls {high_m:g} m in {long_m:g}", rolled(one, high_m, long_m)
    yield "depth x 3", steepened(one, level, 3.0)
    turbid = one.some(
        (one.label != FLOOR) | (rng.uniform(size=len(off)) < np.exp((one.z - level) / 6))
    )
    wet = np.flatnonzero((turbid.label == SURFACE) & (rng.uniform(size=len(turbid.x)) < 0.3))
    down = rng.exponential(2.0, len(wet))
    yield "turbid, fades in 2 m", turbid.and_(turbid.x[wet], level - down, NOISE)
    yield "no floor", one.some(one.label != FLOOR)
    yield "land at both ends", ashore(rng, one, shore, level)


def deepened(one: Points, level: float) -> Points:
    """The floor 27.5 m below the surface in the mean of 100 m, as rough as it is."""
    z, floor = one.z.copy(), one.label == FLOOR
    piece = (one.x // 100.0).astype(np.int64)
    for at in np.unique(piece[floor]):
        own = floor & (piece == at)
        z[own] += level - 27.5 + 2.5 * np.sin(at / 3.0) - np.median(z[own])
    return Points(one.x, z, one.label)


def rolled(one: Points, high_m: float, long_m: float) -> Points:
    """The floor lowered by waves of an amplitude and a length."""
    down = high_m * (1.0 + np.sin(2.0 * np.pi * one.x / long_m))
    return Points(one.x, np.where(one.label == FLOOR, one.z - down, one.z), one.label)


def steepened(one: Points, level: float, times: float) -> Points:
    """Depths, floor and noise alike, that many times as large, as far as 60 m."""
    z = np.where(one.z < level, level + times * (one.z - level), one.z)
    return Points(one.x, z, one.label).some(z > level - 60.0)


def ashore(rng: np.random.Generator, one: Points, shore: Points, level: float) -> Points:
    """Half an island before the track and its other half behind it, as much noise as its own."""
    middle = float(np.median(shore.x))
    left, right = shore.some(shore.x >= middle), shore.some(shore.x < middle)
    foot = level - float(np.quantile(shore.z[shore.label == LAND], 0.02))
    noise = np.count_nonzero(one.label == NOISE) / np.ptp(one.x) / np.ptp(one.z)
    low, high = one.x.min(), one.x.max()
    found = one
    for part, start in ((left, low - np.ptp(left.x) - 1.0), (right, high + 1.0)):
        x = part.x - part.x.min() + start
        found = found.and_(x, part.z + foot, part.label)
        n = rng.poisson(noise * np.ptp(x) * np.ptp(one.z))
        places = rng.uniform(x.min(), x.max(), n), rng.uniform(one.z.min(), one.z.max(), n)
        found = found.and_(*places, NOISE)
    return found


def beside_land(one: Points) -> Mask:
    """Photons within 2 m of land that labels call noise: what they are is not known."""
    land = one.label == LAND
    if not land.any():
        return land
    order = np.argsort(one.x[land], kind="stable")
    line = np.interp(one.x, one.x[land][order], one.z[land][order], np.nan, np.nan)
    near: Mask = (np.abs(one.z - line) < 2.0) & (one.label == NOISE)
    return near


def told_apart(one: Points) -> Points:
    """The track with such photons as unknown."""
    return Points(one.x, one.z, np.where(beside_land(one), 0, one.label), one.background)


def island(one: Points) -> Points:
    """Land, and what lies within 2 m of it."""
    return told_apart(one).some(beside_land(one) | (one.label == LAND))


def variants(track: Labelled, shore: Points | None) -> Iterator[Labelled]:
    """All of a track, itself first."""
    one = points(track)
    yield track
    made = [*general(one), *pieces(one, 400.0 if shore is None else 3000.0)]
    if shore is None:
        level = float(np.median(one.z[one.label > NOISE]))
        half = np.ptp(one.z[one.label > NOISE]) / 2.0 + 15.0
        made.append(("gate 15 m beyond signal", gated(one, level, (-half, half))))
        made.append(("no rate of the product", Points(one.x, one.z, one.label)))
    else:
        made += [*pieces(one, 1000.0), *watery(one, shore)]
    for name, some in made:
        yield some.labelled(name)


def best_peer(track: Labelled) -> tuple[str, float]:
    """The published filter with the largest F1, and that."""
    photons = [values / QUANTA_PER_M for values in track.photons]
    found = {name: measured(keep(name, *photons), track.label)[1] for name in PEERS}
    best = max(found, key=lambda name: found[name])
    return best, found[best]


class Tried(NamedTuple):
    """What is kept of a variant, its labels, and what is wrong."""

    kept: Mask
    label: NDArray[np.int64]
    wrong: list[str]
    floors: int  #: Profile cells with a floor.
    false_floors: int


def floors_of(track: Labelled) -> tuple[int, int]:
    """Profile cells that have a floor, and those whose floor is far from all that is labelled."""
    deep = track.label == FLOOR
    if not deep.any():
        return 0, 0
    x, z = (values[deep] / QUANTA_PER_M for values in track.photons)
    columns = columns_of(track)
    has = np.isfinite(columns["floor"])
    places = zip(columns["along_track"][has], columns["floor"][has], strict=True)
    false = [np.all((np.abs(x - at) > AROUND_M) | (np.abs(z - floor) > OFF_M))
             for at, floor in places]  # fmt: skip
    return len(false), int(np.sum(false))


def line(track: Labelled, *, quick: bool) -> Tried:
    """Print the measures of a variant."""
    beam = Beam(track.photons, track.background)
    kept = beam.keep(beam.score())
    balanced, f1, floor = measured(kept, track.label)
    name, theirs = ("", np.nan) if quick else best_peer(track)
    unseen, floors = rates.unseen(beam.cells, RATE), floors_of(track)
    wrong: list[str] = []
    if balanced < BALANCED_LEAST:
        wrong.append("balanced")
    if f1 < theirs - F1_BEHIND:
        wrong.append("behind")
    if kept.all() or not kept.any():
        wrong.append("all or none")
    print(
        f"  {track.name:24}{len(kept):8}{f1:8.3f}{balanced:8.3f}{floor:8.3f}{theirs:8.3f} "
        f"{name:10}{unseen:8.2f}{floors[0]:8}{floors[1]:6}  {', '.join(wrong)}",
        flush=True,
    )
    return Tried(kept, track.label, wrong, *floors)


def table(tried: dict[str, list[Tried]], land: dict[str, list[Tried]]) -> None:
    """Print each variant over all tracks with water, and over land."""
    heads = ("F1", "bal.", "floor", "least", "false %", "land F1", "bal.")
    print(f"{'':26}" + "".join(f"{head:>9}" for head in heads))
    for name, parts in {**tried, **{k: v for k, v in land.items() if k not in tried}}.items():
        cells = [np.nan] * 7
        if name in tried:
            kept, label = (np.concatenate([part[i] for part in parts]) for i in range(2))
            balanced, f1, floor = measured(kept, label)
            least = min(measured(part.kept, part.label)[0] for part in parts)
            floors = sum(part.floors for part in parts)
            false = sum(part.false_floors for part in parts)
            cells[:5] = f1, balanced, floor, least, 100.0 * false / max(floors, 1)
        if name in land:
            kept, label = (np.concatenate([part[i] for part in land[name]]) for i in range(2))
            balanced, f1, _ = measured(kept, label)
            cells[5:] = f1, balanced
        print(f"{name:26}" + "".join("        -" if np.isnan(v) else f"{v:9.3f}" for v in cells))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each variant, and how many have something wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.varied_tracks", description=__doc__
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="variants whose name has this in it")
    parser.add_argument("--quick", action="store_true", help="ours alone")
    options = parser.parse_args(arguments)
    water = [read_csv(path) for path in sorted(options.folder.glob("*.csv"))]
    shore = next((island(points(t)) for t in water if (t.label == LAND).any()), None)
    tracks = [(track, shore) for track in water]
    for atl03 in sorted(options.folder.glob("atl03*.h5")):
        atl08 = atl03.with_name(atl03.name.replace("atl03", "atl08"))
        tracks += [(t, None) for t in (read_atl03(atl03, atl08) if atl08.exists() else [])]
    wet: dict[str, list[Tried]] = {}
    dry: dict[str, list[Tried]] = {}
    for track, land in tracks:
        print(
            f"{track.name:26}{'photons':>8}{'F1':>8}{'bal.':>8}{'floor':>8}{'peers':>8} "
            f"{'best':10}{'unseen':>8}{'floors':>8}{'false':>6}  wrong"
        )
        for part in variants(track, land):
            if options.only in part.name:
                name = "as it is" if part.name == track.name else part.name.partition(" #")[0]
                found = wet if land is not None else dry
                found.setdefault(name, []).append(line(part, quick=options.quick))
    every = [one for found in (wet, dry) for parts in found.values() for one in parts]
    table(wet, dry)
    wrong = sum(bool(one.wrong) for one in every)
    print(f"{len(every)} variants, {wrong} with something wrong")


if __name__ == "__main__":
    main()
