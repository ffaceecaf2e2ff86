"""What labels of water can say of the noise among what is taken, and what they cannot.

Run ``python -m benchmarks.altimetry.label_rule FOLDER``; the folder is that of
:mod:`benchmarks.altimetry.labelled_tracks`.

Others' labels have one signal photon per shot and half a metre, and call a layer signal whatever
noise lies in it. So three parts of each track are told apart: what lies near to a labelled signal
photon of the same shot, what lies in the layers of labelled signal, and everything else. In each
stand the noise that labels give and that the filter expects, of all and of what is taken. Then the
noise told over the labelled: as labels give it, and with the noise expected in place of theirs in
the parts where they cannot tell. Places over land are left out.

What labels call noise over land is counted by its height over the land that they name: what more
than noise at other heights lies there, and how much of it lies in the shot of a photon of land,
near to it and far from it. ``--picture FILE`` draws that.

Below it the rule is put to made-up tracks whose truth is known: noise told over the true one, and
over what labels by that rule would call noise.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.labelled_tracks import (
    LAND,
    LAND_M,
    NOISE,
    SURFACE,
    Found,
    Labelled,
    ours,
    over_land,
    read_csv,
)
from benchmarks.altimetry.odd_tracks import DAY, NIGHT, SCENES, make
from benchmarks.altimetry.photon_beams import Photons
from benchmarks.altimetry.told_noise import WITHIN, near
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.report import style

HALF_SHOT_M, CLUSTER_M, PILED_M = 0.35, 0.5, 1.0
"""Half of a shot's spacing; height of a cluster, and how far second photons lie from it [m]."""

LAYER_M = (10.0, 0.5)
"""Reach of a layer along the track and in height, to each side [m]."""

FAR_M = (10.0, 20.0)
LAND_BINS_M = (-10.0, -5.0, -2.0, -0.5, 0.5, 2.0, 5.0, 10.0)
"""Heights over land where noise alone is, to either side, and bins of heights [m]."""

PARTS = ("same shot, to 0.5 m", "same shot, 0.5 to 1 m", "in layers", "elsewhere")
MADE_UP = ("plain", "waves of 0.4 m", "jumping floor", "faint surface")


class Part(NamedTuple):
    """Noise of a part of a track, of all and of what is taken."""

    labelled: int
    expected: float
    taken: int
    told: float


def part_of(own: Photons, at: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Which of :data:`PARTS` places lie in, (n,) int64; ``own``: labelled signal."""
    in_cluster, in_pile, in_layer = (
        near(own, at, size) <= 1.0
        for size in ((HALF_SHOT_M, CLUSTER_M), (HALF_SHOT_M, PILED_M), LAYER_M)
    )
    return np.select([in_cluster, in_pile, in_layer], [0, 1, 2], 3)


def by_part(track: Labelled, found: Found) -> list[Part]:
    """Noise of each part, away from land."""
    beam, noise, signal = found.beam, track.label == NOISE, track.label > NOISE
    assert beam is not None
    own = track.photons[0][signal], track.photons[1][signal]
    *places, expected = beam.expected_at
    *passed, told = beam.told_at
    at = [
        np.where(over_land(track, some[0]), -1, part_of(own, some))
        for some in (track.photons, places, passed)
    ]
    return [
        Part(
            int(np.count_nonzero(noise & (at[0] == i))),
            float(expected[at[1] == i].sum()),
            int(np.count_nonzero(noise & found.kept & (at[0] == i))),
            float(told[at[2] == i].sum()),
        )
        for i in range(len(PARTS))
    ]


def over_the_land(track: Labelled, found: Found) -> NDArray[np.float64]:
    """Height over the labelled land of what labels call noise there, and whether it is taken.

    (n, 3) float64: height [m]; 1 for what is taken; 1 for what is of the shot of a photon of land.
    """
    along, height = track.photons
    land, noise = track.label == LAND, track.label == NOISE
    rows = np.flatnonzero(noise & over_land(track, along))
    order = np.argsort(along[land], kind="stable")
    line = np.interp(along[rows], along[land][order], height[land][order].astype(np.float64))
    shots = np.isin(along[rows], along[land])
    return np.stack([(height[rows] - line) / QUANTA_PER_M, found.kept[rows], shots], axis=1)


def print_land(name: str, at: NDArray[np.float64]) -> None:
    """How much of the noise over land lies near to it, and how much of that is no noise."""
    over_m, taken, shots = at.T
    far = np.abs(over_m) > FAR_M[0]
    far &= np.abs(over_m) <= FAR_M[1]
    per_m = np.count_nonzero(far) / (2.0 * (FAR_M[1] - FAR_M[0]))
    print(f"{name}: noise by the labels within {LAND_M:g} m of land, by height over it")
    for low, high in pairwise(LAND_BINS_M):
        own = (over_m >= low) & (over_m < high)
        print(
            f"  {low:5g} to {high:4g} m:{np.count_nonzero(own):5} of them, as dense as farther off"
            f"{per_m * (high - low):5.0f}; taken {np.count_nonzero(taken[own]):4}"
        )
    near = taken > 0
    print(
        f"  of the {np.count_nonzero(near)} that are taken {shots[near].mean():.0%} lie in the shot"
        f" of a photon of land, of those {FAR_M[0]:g} to {FAR_M[1]:g} m off {shots[far].mean():.0%}"
    )


def draw_land(at: NDArray[np.float64], path: Path) -> None:
    """Picture of the heights of the noise over land."""
    over_m, taken, _ = at.T
    edges = np.arange(-8.0, 8.01, 0.25)
    drawn = style.figure(10.5, 3.6)
    axes = drawn.subplots()
    for some, colour, name in (
        (np.ones(len(at), np.bool_), style.MUTED, "noise by the labels"),
        (taken > 0, style.NOISE, "of it taken here"),
    ):
        axes.hist(over_m[some], edges, color=colour, label=name)
    far = (np.abs(over_m) > FAR_M[0]) & (np.abs(over_m) <= FAR_M[1])
    level = np.count_nonzero(far) / (2.0 * (FAR_M[1] - FAR_M[0])) * (edges[1] - edges[0])
    axes.axhline(level, color=style.GROUND, label="as dense as 10 to 20 m off")
    axes.set(xlabel="height over the photons called land [m]", ylabel="photons")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path, dpi=110)


def summed(parts: Sequence[Part]) -> Part:
    """A part of all tracks together."""
    labelled, expected, taken, told = (sum(column) for column in zip(*parts, strict=True))
    return Part(int(labelled), expected, int(taken), told)


def verdict(told: float, labelled: float) -> str:
    """Noise told over labelled, and whether that is near enough."""
    ratio = told / max(labelled, 1.0)
    return f"{ratio:.2f}, {'' if abs(ratio - 1.0) <= WITHIN else 'not '}within {WITHIN:.0%}"


def print_parts(name: str, parts: Sequence[Part]) -> None:
    """The parts, and told over labelled with and without what labels cannot tell."""
    print(f"{name:24}{'labelled':>9}{'expected':>9}{'of all':>7}   {'taken':>6}{'told':>6}")
    for part, one in zip(PARTS, parts, strict=True):
        ratio = one.labelled / max(one.expected, 1e-9)
        print(
            f"  {part:22}{one.labelled:9}{one.expected:9.0f}{ratio:7.2f}   "
            f"{one.taken:6}{one.told:6.0f}"
        )
    told = sum(one.told for one in parts)
    put_right = sum(one.told for one in parts[:-1]) + parts[-1].taken
    print(f"  told / labelled, as labels give it:     {verdict(told, sum(p.taken for p in parts))}")
    print(f"  theirs only where labels can tell:      {verdict(told, put_right)}", flush=True)


def by_rule(track: Labelled) -> Labelled:
    """A made-up track with labels by the rule."""
    along, height = track.photons
    true = track.label > NOISE
    shots = np.split(np.arange(len(along)), np.flatnonzero(np.diff(along)) + 1)
    one_each, left = true.copy(), np.ones(len(along), np.bool_)
    for shot in shots:
        # The first signal photon stands for its cluster; a second one outside of it is noise.
        for first in shot[true[shot]]:
            beside = np.abs(height[shot] - height[first]) <= CLUSTER_M * 1000
            if left[first] and one_each[first]:
                left[shot[beside & (shot != first)]] = False
            further = shot[~beside & (np.abs(height[shot] - height[first]) <= PILED_M * 1000)]
            one_each[further[further > first]] = False
    own = along[true], height[true]
    layer = near(own, track.photons, LAYER_M) <= 1.0
    alone = near(own, track.photons, (HALF_SHOT_M, PILED_M)) > 1.0
    label = np.where(one_each, track.label, np.where(layer & alone & ~true, SURFACE, NOISE))
    photons = along[left], height[left]
    return Labelled(track.name, photons, label[left])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the parts of each track, and what the rule does to made-up ones."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.label_rule", description=__doc__
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the noise over land")
    options = parser.parse_args(arguments)
    every = []
    for path in sorted(options.folder.glob("*.csv")):
        track = read_csv(path)
        found = ours(track)
        every.append(by_part(track, found))
        print_parts(track.name, every[-1])
        if (track.label == LAND).any():
            at = over_the_land(track, found)
            print_land(track.name, at)
            if options.picture is not None:
                draw_land(at, options.picture)
    if every:
        print_parts("all", [summed(same) for same in zip(*every, strict=True)])
    print(f"{'made up':24}{'told / true':>12}{'told / by the rule':>20}")
    for name in MADE_UP:
        for sky, noise in (("night", NIGHT), ("day", DAY)):
            track = make(f"{name}, {sky}", replace(SCENES[name], noise_per_m2=noise), 1)
            ratios = []
            for one in (track, by_rule(track)):
                found = ours(one)
                taken = np.count_nonzero(found.kept & (one.label == NOISE))
                ratios.append(found.told / max(taken, 1))
            print(f"{track.name:24}{ratios[0]:12.2f}{ratios[1]:20.2f}", flush=True)


if __name__ == "__main__":
    main()
