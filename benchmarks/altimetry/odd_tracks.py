"""Tracks unlike those that the filter was made on.

Run ``python -m benchmarks.altimetry.odd_tracks``; ``--seeds N`` takes N of each, ``--real FOLDER``
takes pieces and mixtures of labelled tracks instead, as of
:mod:`benchmarks.altimetry.labelled_tracks`, and ``--picture FOLDER`` draws each.

Nothing here uses the product's simulator: photons come by shots of 0.7 m, several of one shot from
one surface; floors are steep, bright, faint or lacking; the water adds what light and detector
leave below a surface (scattering, dead time, afterpulses at fixed depths, as X. Lu et al., Earth
Space Sci. 8, 2021, show them); clouds take stretches away, waves and swell bend the surface.
Printed are the balanced accuracy, F1 and recall of the floor, ours beside DBSCAN and kNN + Otsu as
published, and the noise that ours tells over the true one. The last column is true where ours keeps
everything or nothing. At the end stands how often that noise is told within 30 %, by part.

``--null N`` draws N tracks of noise alone instead, of 0.3 to 10 km and gates of 30 to 300 m. It
tells of how many that keep photons a run says that noise alone gives as much, and on how many of
the tracks above, one of each, it says so.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
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
    over_land,
    peer,
    read_csv,
)
from benchmarks.altimetry.photon_beams import Beam, Mask, lattice
from benchmarks.altimetry.told_noise import LEAST, Told, by_part, judged
from spl_batch.altimetry.filter.chance import LEAST_PHOTONS
from spl_batch.altimetry.water.level_water import SURFACE_M
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.report import style

SHOT_M = 0.7
NIGHT, DAY, BRIGHT = 2e-4, 0.015, 0.05
PEERS = ("dbscan", "knn_otsu")

Numbers = NDArray[np.float64]
Along = Callable[[Numbers], Numbers]


def always(value: float) -> Along:
    """The same all along the track."""
    return lambda x: np.full(len(x), value)


CLEAR, LEVEL, SURFACE_RATE, FLOOR_RATE = always(1.0), always(0.0), always(0.9), always(0.25)


@dataclass(frozen=True)
class Scene:
    """What a track looks like; rates are photons of a shot, heights from the mean surface [m]."""

    noise_per_m2: float = NIGHT
    length_m: float = 4000.0
    gate_m: tuple[float, float] = (-70.0, 30.0)
    surface: Along = SURFACE_RATE
    rough_m: float = 0.12
    level_m: Along = LEVEL
    floor: Along = FLOOR_RATE
    depth_m: Along = lambda x: 10.0 + 7.0 * np.sin(x / 400.0)
    floor_rough_m: float = 0.2
    column: float = 0.07
    fades_m: float = 4.0
    echoes: tuple[tuple[float, float, float], ...] = ()
    """Depth, thickness [m] and share of the surface's photons of what the detector adds."""
    land: tuple[tuple[float, float], ...] = ()
    land_m: Along = lambda x: 20.0 * np.sin(x / 150.0) ** 2
    trees: float = 0.0
    """Share of the land's photons that stand up to 15 m above it."""
    clear: Along = CLEAR
    """Share of the light that clouds let through."""
    fog: tuple[float, float, float] = (0.0, 10.0, 25.0)
    """Photons of a shot that a cloud in the gate gives back, and its lower and upper end [m]."""


def make(name: str, scene: Scene, seed: int) -> Labelled:
    """Draw the photons of a track."""
    rng = np.random.default_rng([seed, *name.encode()])
    shot = np.arange(0.0, scene.length_m, SHOT_M)
    ashore = np.zeros(len(shot), np.bool_)
    for low, high in scene.land:
        ashore |= (shot >= low) & (shot < high)
    clear, level = scene.clear(shot), scene.level_m(shot)
    parts: list[tuple[Numbers, Numbers, int]] = []

    def add(rate: Numbers, height: Callable[[NDArray[np.intp]], Numbers], kind: int) -> None:
        at = np.repeat(np.arange(len(shot)), rng.poisson(rate))
        parts.append((shot[at], height(at), kind))

    wet = scene.surface(shot) * clear * ~ashore
    depth = scene.depth_m(shot)
    add(wet, lambda at: level[at] + rng.normal(0.0, scene.rough_m, len(at)), SURFACE)
    add(
        scene.floor(shot) * clear * ~ashore,
        lambda at: level[at] - depth[at] + rng.normal(0.0, scene.floor_rough_m, len(at)),
        FLOOR,
    )
    add(
        scene.column * clear * ~ashore,
        lambda at: level[at] - rng.exponential(scene.fades_m, len(at)),
        NOISE,
    )
    for deep, thick, share in scene.echoes:
        add(
            share * wet,
            lambda at, deep=deep, thick=thick: level[at] - deep + rng.normal(0.0, thick, len(at)),  # type: ignore[misc]
            NOISE,
        )
    foot = scene.land_m(shot)
    add(
        1.2 * clear * ashore,
        lambda at: (
            foot[at]
            + rng.normal(0.0, 0.3, len(at))
            + 15.0 * rng.beta(4.0, 2.0, len(at)) * (rng.uniform(size=len(at)) < scene.trees)
        ),
        LAND,
    )
    add(scene.fog[0] * (1.0 - clear), lambda at: rng.uniform(*scene.fog[1:], len(at)), NOISE)
    sky = scene.noise_per_m2 * SHOT_M * (scene.gate_m[1] - scene.gate_m[0])
    add(np.full(len(shot), sky), lambda at: rng.uniform(*scene.gate_m, len(at)), NOISE)
    x, z = (np.concatenate([part[i] for part in parts]) for i in range(2))
    label = np.concatenate([np.full(len(part[0]), part[2]) for part in parts])
    order = np.lexsort((z, x))
    return Labelled(name, lattice(x[order], z[order]), label[order].astype(np.int64))


def gaps(period_m: float, share: float) -> Along:
    """Clouds over this share of each period, and half of the light beside them."""
    return lambda x: np.where((x / period_m) % 1.0 < share, 0.0, np.where(x % 900 < 300, 0.4, 1.0))


def thin(period_m: float, light: float) -> Along:
    """Clouds over half of each period, which let this share of the light through."""
    return lambda x: np.where((x / period_m) % 1.0 < 0.5, light, 1.0)


def reef(x: Numbers) -> Numbers:
    """Depths that jump between 2 and 20 m."""
    return np.where((x / 350.0) % 2.0 < 1.0, 2.0 + x % 7.0 / 7.0, 20.0)


def waves(height_m: float, long_m: float) -> Along:
    """Swell of this amplitude and length [m]."""
    return lambda x: height_m * np.sin(2.0 * np.pi * x / long_m)


ECHOES = ((0.45, 0.15, 0.08), (0.9, 0.15, 0.03), (2.3, 0.15, 0.01), (4.2, 0.2, 0.006))
"""Second detections after the dead time, and afterpulses."""

SCENES: dict[str, Scene] = {
    "plain": Scene(),
    "dead time, afterpulses": Scene(surface=always(3.0), echoes=ECHOES),
    "the same, no floor": Scene(surface=always(3.0), echoes=ECHOES, floor=always(0.0)),
    "turbid, no floor": Scene(column=0.5, fades_m=1.5, floor=always(0.0)),
    "turbid, floor at 3 to 6 m": Scene(
        column=0.5, fades_m=1.5, depth_m=lambda x: 4.5 + 1.5 * np.sin(x / 300.0), floor=always(0.15)
    ),
    "floor at 0.3 to 0.9 m": Scene(depth_m=lambda x: 0.6 + 0.3 * np.sin(x / 200.0)),
    "floor at 1 to 2 m, bright": Scene(
        depth_m=lambda x: 1.5 + 0.5 * np.sin(x / 200.0), floor=always(1.5), surface=always(0.6)
    ),
    "floor at 25 m, faint": Scene(depth_m=lambda x: 25.0 + np.sin(x / 500.0), floor=always(0.06)),
    "no floor": Scene(floor=always(0.0)),
    "jumping floor": Scene(depth_m=reef),
    "cloud gaps": Scene(clear=gaps(1000.0, 0.5)),
    "cloud in the gate": Scene(clear=gaps(1500.0, 0.3), fog=(0.15, 8.0, 25.0)),
    "cloud above 70 m": Scene(
        clear=gaps(1500.0, 0.3), fog=(0.15, 70.0, 95.0), gate_m=(-70.0, 120.0)
    ),
    "cloud over hills": Scene(
        land=((0.0, 4000.0),),
        clear=thin(1500.0, 0.6),
        fog=(1.0, 90.0, 130.0),
        gate_m=(-120.0, 180.0),
    ),
    "cloud over woods": Scene(
        land=((0.0, 4000.0),),
        land_m=lambda x: 20.0 * np.sin(x / 150.0),
        trees=0.6,
        clear=thin(1500.0, 0.05),
        fog=(1.0, 90.0, 130.0),
        gate_m=(-120.0, 180.0),
    ),
    "waves of 0.4 m": Scene(rough_m=0.4),
    "swell of 1 m": Scene(level_m=waves(1.0, 90.0)),
    "swell of 2 m": Scene(level_m=waves(2.0, 150.0)),
    "level falls by 1 m": Scene(level_m=lambda x: -x / 4000.0),
    "faint surface": Scene(surface=always(0.25), floor=always(0.06)),
    "bright surface": Scene(surface=always(8.0), floor=always(0.5), column=0.3),
    "steep island": Scene(land=((1200.0, 2400.0),), gate_m=(-70.0, 60.0)),
    "wooded island": Scene(
        land=((1200.0, 2400.0),), gate_m=(-70.0, 60.0), trees=0.6, land_m=lambda x: x / 400.0
    ),
    "many islets": Scene(land=tuple((a, a + 120.0) for a in np.arange(100.0, 4000.0, 400.0))),
    "land alone, slope 0.5": Scene(
        land=((0.0, 4000.0),), land_m=lambda x: 50.0 * np.sin(x / 100.0), gate_m=(-120.0, 120.0)
    ),
    "plain with trees": Scene(land=((0.0, 4000.0),), land_m=lambda x: x / 500.0, trees=0.5),
    "gate of 30 m": Scene(gate_m=(-22.0, 8.0)),
    "gate of 30 m over land": Scene(
        gate_m=(-12.0, 18.0), land=((0.0, 4000.0),), land_m=lambda x: 4.0 * np.sin(x / 300.0)
    ),
    "gate of 30 m over trees": Scene(
        gate_m=(-12.0, 18.0), land=((0.0, 4000.0),), land_m=lambda x: -x / 2000.0, trees=0.5
    ),
    "200 m": Scene(length_m=200.0),
    "60 m": Scene(length_m=60.0),
    "nothing but noise": Scene(surface=always(0.0), floor=always(0.0), column=0.0),
}


def synthetic(seeds: int) -> Iterator[Labelled]:
    """Every scene by night, by day and under a bright sky."""
    for name, scene in SCENES.items():
        for sky, noise in (("night", NIGHT), ("day", DAY), ("bright", BRIGHT)):
            for seed in range(seeds):
                yield make(f"{name}, {sky}", replace(scene, noise_per_m2=noise), seed)


def mixed(folder: Path) -> Iterator[Labelled]:
    """What is made of real tracks: short pieces, faint ones, other places, one behind another."""
    tracks = [read_csv(path) for path in sorted(folder.glob("*.csv"))]
    rng = np.random.default_rng(1)
    for track in tracks:
        along, height = track.photons
        first = along.min()

        def made(name: str, rows: NDArray[np.bool_], lift: int = 0, shift: int = 0) -> Labelled:
            photons = along[rows] + shift, (height[rows] + lift).astype(np.int32)  # noqa: B023
            return Labelled(f"{track.name}, {name}", photons, track.label[rows])  # noqa: B023

        signal = track.label != NOISE
        for share in (0.5, 0.25, 0.1):
            keep = ~signal | (rng.uniform(size=len(along)) < share)
            yield made(f"{share:g} of signal", keep)
            keep = signal | (rng.uniform(size=len(along)) < share)
            yield made(f"{share:g} of noise", keep)
        every = np.ones(len(along), np.bool_)
        for lift, shift in ((250, 0), (613, 7_300), (-100_300, -90_000_013), (0, 13_000)):
            yield made(f"moved by {shift / 1e3:g}, {lift / 1e3:g} m", every, lift, shift)
        for long_m in (1000, 500, 200):
            pieces = (along - first) // (long_m * 1000)
            for piece in range(0, int(pieces.max()) + 1, max(4 * 500 // long_m, 1)):
                rows = pieces == piece
                if min(np.count_nonzero(rows & signal), np.count_nonzero(rows & ~signal)) > 30:
                    yield made(f"{long_m} m from {piece * long_m}", rows)
        yield made("gaps", (along - first) // 150_000 % 3 > 0)
    for one, two in ((tracks), (tracks[::-1])):
        gap, step = 5_000, 9_000
        x = np.concatenate(
            [one.photons[0], two.photons[0] - two.photons[0].min() + one.photons[0].max() + gap]
        )
        z = np.concatenate([one.photons[1], two.photons[1] + step]).astype(np.int32)
        label = np.concatenate([one.label, two.label])
        yield Labelled(f"{one.name}, then {two.name}", (x, z), label)


def water_track(_: Path) -> Figure:
    """A made-up track over water by day: what its photons are, and what ours calls them."""
    scene = Scene(noise_per_m2=DAY, length_m=2500.0, gate_m=(-40.0, 20.0))
    track = make("picture", scene, 1)
    found = ours(track)
    below = found.beam is not None and found.beam.depth_m(*track.photons) > SURFACE_M
    theirs = np.where(found.kept, np.where(below, FLOOR, SURFACE), NOISE)
    balanced, f1, floor = measured(found.kept, track.label)
    print(f"water_track: balanced accuracy {balanced:.3f}, F1 {f1:.3f}, floor {floor:.3f}")
    drawn = style.figure(10.5, 5.2)
    upper, lower = drawn.subplots(2, 1, sharex=True, sharey=True)
    _photons(upper, track, track.label)
    _photons(lower, track, theirs)
    false = found.kept & (track.label == NOISE)
    _dots(lower, track, false, style.NOISE, "noise that was taken")
    upper.set(title="What the photons are", ylabel="height [m]")
    lower.set(title="What they are called", xlabel="along track [m]", ylabel="height [m]")
    lower.set(xlim=(0.0, scene.length_m), ylim=(-27.0, 9.0))
    for axes in (upper, lower):
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(loc="lower right", markerscale=4, handletextpad=0.1, ncols=4)
    return drawn


def _photons(axes: Axes, track: Labelled, kind: NDArray[np.int64]) -> None:
    for value, colour, name in (
        (NOISE, style.MUTED, "noise"),
        (SURFACE, style.SIGNAL, "surface"),
        (FLOOR, style.GROUND, "floor"),
    ):
        _dots(axes, track, kind == value, colour, name)


def _dots(axes: Axes, track: Labelled, some: Mask, colour: str, name: str) -> None:
    x, z = (values[some] / QUANTA_PER_M for values in track.photons)
    size = 3.5 if colour == style.NOISE else 2.0
    axes.plot(x, z, ".", ms=size, mew=0, color=colour, label=name)


def null(number: int, seed: int) -> None:
    """How often a run says that noise alone gives as much, by noise alone and by signal."""
    rng = np.random.default_rng(seed)
    told = kept = 0
    for _ in range(number):
        long_m, gate_m = 10.0 ** rng.uniform(2.5, 4.0), 10.0 ** rng.uniform(1.5, 2.5)
        density = rng.choice([NIGHT, 1e-3, 5e-3, DAY, BRIGHT])
        n = int(np.clip(density * long_m * gate_m, 100, 30_000))
        x = np.sort(rng.uniform(0.0, long_m, n))
        beam = Beam(lattice(x, rng.uniform(-gate_m / 2.0, gate_m / 2.0, n)), None)
        taken = np.count_nonzero(beam.keep(beam.score()))
        kept += taken > 0
        told += taken > 0 and (beam.doubtful == taken or beam.doubtful >= LEAST_PHOTONS)
    print(f"noise alone: {number} tracks, {kept} keep photons, told of {told}")
    told = kept = 0
    for track in synthetic(1):
        if (track.label > NOISE).any():
            beam = Beam(track.photons, None)
            kept += np.count_nonzero(beam.keep(beam.score())) >= LEAST_PHOTONS
            if beam.doubtful >= LEAST_PHOTONS:
                told += 1
                print(f"told of {track.name}, {beam.doubtful} photons")
    print(f"signal in noise: {kept} tracks that keep as many, told of {told}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each track, and the least of each column."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.odd_tracks", description=__doc__
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--real", type=Path, metavar="FOLDER")
    parser.add_argument("--picture", type=Path, metavar="FOLDER")
    parser.add_argument("--only", default="", help="tracks whose name has this in it")
    parser.add_argument("--quick", action="store_true", help="ours alone")
    parser.add_argument("--null", type=int, metavar="N")
    parser.add_argument("--seed", type=int, default=5, help="of the draws of noise alone")
    options = parser.parse_args(arguments)
    if options.null:
        null(options.null, options.seed)
        return
    names = () if options.quick else PEERS
    heads = "".join(f"{name:>21}" for name in ("ours", *names))
    print(f"{'balanced, F1, floor':46}{heads}     told  all or none")
    least: list[float] = []
    parts: list[Told] = []
    for track in mixed(options.real) if options.real else synthetic(options.seeds):
        if options.only not in track.name:
            continue
        found = [ours(track), *(peer(name)(track) for name in names)]
        cells = [measured(one.kept, track.label) for one in found]
        least.append(cells[0][0])
        kept = found[0].kept
        noise = track.label == NOISE
        false = np.count_nonzero(kept & noise)
        if found[0].beam is not None and not noise.all():
            land = partial(over_land, track)
            parts += by_part(found[0].beam, kept, noise, land)
        numbers = "".join("".join(f"{v:7.3f}" for v in cell) for cell in cells)
        ends = "yes" if kept.all() or not kept.any() else ""
        print(f"{track.name:46}{numbers}{found[0].told / max(false, 1):9.2f}  {ends}", flush=True)
        if options.picture:
            draw(track, found[0], options.picture)
    worst = np.sort(np.array(least)[np.isfinite(least)])
    print(
        f"{len(worst)} tracks: least balanced accuracy {worst[0]:.3f}, "
        f"median {np.median(worst):.3f}"
    )
    print(f"noise told, parts of tracks with {LEAST} photons of noise or more:\n{judged(parts)}")


if __name__ == "__main__":
    main()
