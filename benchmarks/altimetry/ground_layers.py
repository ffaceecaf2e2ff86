"""How thick the layer is that ground is sought in: fixed, or by pulse and slope.

Run ``python -m benchmarks.altimetry.ground_layers [ATL03 ATL08]``. "By slope" is what a run does
with ATL03, by the slope of the kilometre around a cell; "by slope of the cell" takes each cell's
ground from the profile whose thickness its own slope asks for. Printed are the median error and
RMSE of the ground: against ATL08's fit of 20 m pieces, on simulated tracks, and on rough land that
no line of 60 m follows.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from benchmarks.altimetry.labelled_tracks import read_atl03, reference
from benchmarks.altimetry.photon_beams import PROFILE, Beam, lattice
from benchmarks.altimetry.profiles import SEEDS, tracks
from spl_batch.altimetry.ground.profile import ATL03_LAYER_M, profile, spread_m

Numbers = NDArray[np.float64]

THICK_M = (0.45, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0)
SHOWN_M = (0.45, 0.75, 1.5, 3.0)

ROUGH = {
    "rough land, strong beam": (8.0, 0.002, 0.0),
    "rough land, weak beam": (1.5, 0.01, 0.0),
    "rough land, half of it wooded": (2.0, 0.005, 0.6),
}
"""Photons of the surface [1/m], noise [1/m2] and share of photons that crowns give, by scene."""

ROUGH_M = 3000.0
"""Length of a rough track [m]."""


def profiles(beam: Beam) -> dict[str, tuple[Numbers, Numbers]]:
    """Places and ground of a beam by each rule of thickness."""
    score = beam.score()
    kept = beam.keep(score)
    rows = np.flatnonzero(kept | beam.keep(score, ground=True))
    along, height = beam.along[rows], beam.height[rows]
    order = np.lexsort((height, along))
    photons, sure = (along[order], height[order]), kept[rows][order]

    def columns(thick: float, spread: float = 0.0) -> dict[str, NDArray[Any]]:
        settings = PROFILE.model_copy(update={"layer_m": thick})
        return profile(*photons, sure, (-(10**9), 10**9), settings, spread).columns

    spread = spread_m(PROFILE, "atl03")
    found = {thick: columns(thick) for thick in THICK_M}
    rules = {f"{thick:g} m": found[thick] for thick in SHOWN_M}
    rules["by slope"] = columns(ATL03_LAYER_M, spread)
    usual = found[ATL03_LAYER_M]
    wanted = np.maximum(np.abs(np.nan_to_num(usual["slope"])) * spread, ATL03_LAYER_M)
    at = np.abs(np.log(np.array(THICK_M)[:, None] / wanted)).argmin(axis=0)
    ground = np.stack([one["ground"] for one in found.values()])
    rules["by slope of the cell"] = {**usual, "ground": ground[at, np.arange(len(at))]}
    return {name: (one["along_track"], one["ground"]) for name, one in rules.items()}


def errors(found: tuple[Numbers, Numbers], truth: Numbers) -> Numbers:
    """Ground less truth where both are known [m]."""
    at, ground = found
    off: Numbers = ground - np.interp(at, *truth.T)
    return off[np.isfinite(off)]


def show(name: str, off: dict[str, list[Numbers]]) -> None:
    """A line for each rule."""
    print(name)
    for rule, parts in off.items():
        every = np.concatenate(parts)
        rmse = float(np.sqrt(np.mean(every**2)))
        print(f"  {rule:22}{len(every):7}{np.median(every):+9.2f}{rmse:9.2f}", flush=True)


def rough(per_m: float, noise: float, leaves: float) -> Iterator[tuple[Beam, Numbers]]:
    """Tracks over hollows and ridges 20 m wide, 1.5 m deep (one sigma), and their ground."""
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        x = np.arange(-200.0, ROUGH_M + 200.0)
        short, long = (gaussian_filter1d(rng.normal(size=len(x)), wide) for wide in (8, 80))
        ground = 1.5 * short / short.std() + 60.0 * long
        along = rng.uniform(0.0, ROUGH_M, int(per_m * ROUGH_M))
        height = np.interp(along, x, ground) + rng.normal(0.0, 0.15, len(along))
        wood = (np.sin(along / 150.0) > 0.0) & (rng.uniform(size=len(along)) < leaves)
        height += np.where(wood, rng.gamma(4.0, 2.5, len(along)), 0.0)
        sky = rng.uniform((0.0, -50.0), (ROUGH_M, 70.0), (int(noise * ROUGH_M * 120.0), 2))
        photons = np.vstack([np.column_stack([along, height]), sky])
        yield Beam(lattice(*photons.T), None), np.column_stack([x, ground])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.ground_layers", description=__doc__
    )
    parser.add_argument("files", nargs="*", type=Path)
    options = parser.parse_args(arguments)
    print(f"  {'thickness':22}{'cells':>7}{'median':>9}{'RMSE':>9}")
    if len(options.files) == 2:
        for track in read_atl03(*options.files):
            at, theirs, _ = reference(track.name, *options.files)
            off: dict[str, list[Numbers]] = {}
            for rule, (x, ground) in profiles(Beam(track.photons, track.background)).items():
                known = np.isfinite(ground)
                mine = np.interp(at, x[known], ground[known], np.nan, np.nan)
                off[rule] = [(mine - theirs)[np.isfinite(mine)]]
            show(f"{track.name}, less ATL08", off)
    for kind, colour, canopy in (
        ("mountain", "infrared", 0.0),
        ("mountain", "infrared", 0.4),
        ("mountain", "infrared", 1.0),
        ("flat", "infrared", 0.4),
        ("flat", "infrared", 1.0),
        ("flat", "green", 1.0),
    ):
        off = {}
        for scene in tracks(kind, colour, canopy):
            beam = Beam(lattice(scene.along_m, scene.height_m), scene.background)
            for rule, one in profiles(beam).items():
                off.setdefault(rule, []).append(errors(one, scene.reference_m))
        show(f"{kind}, {colour}, {canopy:.0%} wooded", off)
    for name, scene_of in ROUGH.items():
        off = {}
        for beam, truth in rough(*scene_of):
            for rule, one in profiles(beam).items():
                off.setdefault(rule, []).append(errors(one, truth))
        show(name, off)


if __name__ == "__main__":
    main()
