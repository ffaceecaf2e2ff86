"""Real tracks with others' labels.

Run ``python -m benchmarks.altimetry.labelled_tracks FOLDER``.

FOLDER holds tracks as CSV (x along the track [m], height [m], label: 1 noise, 2 water surface,
3 floor, 4 land, 0 unknown) and, where it has them, a pair ``atl03*.h5`` and ``atl08*.h5``. Unknown
photons are left out. Signal is 2, 3 and 4; "floor" is the share of 3 that is kept. "Noise" is what
the filter itself expects among the photons that it takes, over that by the labels; "away" is the
same farther than 10 m from a photon of land, since labels with one signal photon per shot call the
others of the land, and its trees, noise. "s/M" are seconds for a million photons.

Other filters run as published, by scikit-learn (``pip install 'spl-batch[peers]'``); mDBSCAN and
the posterior as published are this project's.
"""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry import photon_beams
from benchmarks.altimetry.peer_filters import PEERS
from benchmarks.altimetry.peer_filters import keep as keep_peer
from benchmarks.altimetry.photon_beams import Mask, Photons, lattice, workflow
from spl_batch.altimetry.formats.atl08 import find_labels
from spl_batch.altimetry.formats.photons import inspect, iter_photons
from spl_batch.constants import QUANTA_PER_M

NOISE, SURFACE, FLOOR, LAND = 1, 2, 3, 4
LAND_M: Final = 10.0
"""Reach of a photon of land along the track [m]."""

HEADS: Final = (
    "photons", "kept", "F1", "balanced", "floor", "precision", "recall", "noise", "away", "s/M"
)  # fmt: skip


class Labelled(NamedTuple):
    """A track and its labels by others."""

    name: str
    photons: Photons
    label: NDArray[np.int64]


class Found(NamedTuple):
    """What a method takes, its time [s], and the beam if it is this project's."""

    kept: Mask
    seconds: float
    beam: photon_beams.Labelled | None = None


def read_csv(path: Path) -> Labelled:
    """A track with labels."""
    x, z, label = np.genfromtxt(path, delimiter=",", skip_header=1).T
    return Labelled(path.stem, lattice(x, z), label.astype(np.int64))


def read_atl03(atl03: Path, atl08: Path) -> list[Labelled]:
    """Beams of ATL03 with the classes of ATL08: noise 1, signal 2, unknown 0."""
    found = []
    for facts in inspect(atl03).beams:
        theirs = find_labels(atl03, [atl08], facts.name)
        if theirs is None:
            continue
        parts = list(iter_photons(atl03, "atl03", facts.name, 1 << 20))
        row = np.concatenate([p.row for p in parts])
        along, height = (
            np.concatenate([getattr(p, k) for p in parts]) for k in ("along", "height")
        )
        inside = (row >= theirs.first) & (row < theirs.first + len(theirs.signal))
        label = inside.astype(np.int64)
        label[inside] += theirs.signal[row[inside] - theirs.first]
        found.append(Labelled(facts.name, (along, height), label))
    return found


def ours(track: Labelled, method: str = "likelihood") -> Found:
    """Our filter with its defaults, or one of the source's."""
    start = time.process_time()
    beam = photon_beams.labelled(track.photons, workflow(signal={"method": method}))
    return Found(beam.kept, time.process_time() - start, beam)


def peer(name: str) -> Callable[[Labelled], Found]:
    """A published filter."""

    def run(track: Labelled) -> Found:
        start = time.process_time()
        kept = keep_peer(name, *(values / QUANTA_PER_M for values in track.photons))
        return Found(kept, time.process_time() - start)

    return run


METHODS: Final[Mapping[str, Callable[[Labelled], Found]]] = {
    "ours": ours,
    "published": lambda track: ours(track, "published"),
    "mdbscan": lambda track: ours(track, "mdbscan"),
    **{name: peer(name) for name in PEERS},
}


def measured(kept: Mask, label: NDArray[np.int64]) -> tuple[float, float, float]:
    """Balanced accuracy, F1 and recall of the floor."""
    known = label > 0
    kept, signal, floor = kept[known], label[known] > NOISE, label[known] == FLOOR
    both = np.count_nonzero(kept & signal)
    recall = both / np.count_nonzero(signal) if signal.any() else np.nan
    rejected = 1.0 - kept[~signal].mean() if (~signal).any() else np.nan
    f1 = 2 * both / (kept.sum() + signal.sum()) if signal.any() else np.nan
    return (recall + rejected) / 2.0, f1, kept[floor].mean() if floor.any() else np.nan


def noise_ratios(track: Labelled, found: Found) -> tuple[float, float]:
    """Noise expected over labelled among what is taken: anywhere, and away from land."""
    if found.beam is None:
        return np.nan, np.nan
    size = round(workflow().rate.cell_m * QUANTA_PER_M)
    cells = found.beam.cells
    middle = cells["index"] * size + size // 2
    taken = found.kept & (track.label == NOISE)
    each = cells["false"]
    away, dry = ~over_land(track, middle), ~over_land(track, track.photons[0])
    return (
        float(each.sum()) / max(int(np.count_nonzero(taken)), 1),
        float(each[away].sum()) / max(int(np.count_nonzero(taken & dry)), 1),
    )


def over_land(track: Labelled, along: NDArray[np.int64]) -> Mask:
    """Points within reach of a photon of land, (n,) bool."""
    land = np.sort(track.photons[0][track.label == LAND])
    reach = round(LAND_M * QUANTA_PER_M)
    near: Mask = np.searchsorted(land, along - reach) < np.searchsorted(land, along + reach)
    return near


def row(name: str, track: Labelled, found: Found) -> None:
    """A line of the table."""
    balanced, f1, floor = measured(found.kept, track.label)
    known = track.label > 0
    kept, signal = found.kept[known], track.label[known] > NOISE
    both = np.count_nonzero(kept & signal)
    values = (
        f1,
        balanced,
        floor,
        both / max(int(kept.sum()), 1),
        both / max(int(np.count_nonzero(signal)), 1),
        *(noise_ratios(track, found) if name == "ours" else (np.nan, np.nan)),
        found.seconds / len(track.label) * 1e6,
    )
    numbers = "".join("         -" if np.isnan(v) else f"{v:10.3f}" for v in values)
    print(f"  {name:14}{len(track.label):10}{np.count_nonzero(found.kept):10}{numbers}", flush=True)


def ground(track: Labelled, atl03: Path, atl08: Path) -> tuple[float, float]:
    """Median and RMSE of our ground less ATL08's best fit of each 20 m [m]."""
    settings = workflow()
    beam = photon_beams.labelled(track.photons, settings)
    columns = photon_beams.profile(beam, settings, "atl03")
    at, theirs = reference(track.name, atl03, atl08)
    known = np.isfinite(columns["ground"])
    mine = np.interp(at, columns["along_track"][known], columns["ground"][known], np.nan, np.nan)
    off = (mine - theirs)[np.isfinite(mine)]
    return float(np.median(off)), float(np.sqrt(np.mean(off**2)))


def reference(
    beam: str, atl03: Path, atl08: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where ATL08 fits the terrain in pieces of 20 m, and its height [m]."""
    with h5py.File(atl08) as theirs, h5py.File(atl03) as file:
        land = theirs[f"{beam}/land_segments"]
        height = land["terrain/h_te_best_fit_20m"][()].astype(np.float64)
        number = land["segment_id_beg"][()][:, None] + np.arange(height.shape[1])
        segments = file[f"{beam}/geolocation"]
        known = segments["segment_id"][()].astype(np.int64)
        start = segments["segment_dist_x"][()] + segments["segment_length"][()] / 2.0
    inside = np.isin(number, known) & (np.abs(height) < 1e5)
    return start[np.searchsorted(known, number[inside])], height[inside]


def measure(tracks: Sequence[Labelled]) -> None:
    """The table: each track, and all photons of those with water together."""
    ours(tracks[0])
    pooled: dict[str, list[Found]] = {name: [] for name in METHODS}
    print(f"  {'':14}" + "".join(f"{head:>10}" for head in HEADS))
    for track in tracks:
        print(track.name)
        for name, method in METHODS.items():
            found = method(track)
            pooled[name].append(found)
            row(name, track, found)
    if len(tracks) > 1:
        print("pooled")
        label = np.concatenate([track.label for track in tracks])
        every = Labelled("pooled", tracks[0].photons, label)
        for name, parts in pooled.items():
            kept, seconds, _ = zip(*parts, strict=True)
            row(name, every, Found(np.concatenate(kept), sum(seconds)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables of a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.labelled_tracks", description=__doc__
    )
    parser.add_argument("folder", type=Path)
    options = parser.parse_args(arguments)
    water = [read_csv(path) for path in sorted(options.folder.glob("*.csv"))]
    if water:
        measure(water)
    for atl03 in sorted(options.folder.glob("atl03*.h5")):
        atl08 = atl03.with_name(atl03.name.replace("atl03", "atl08"))
        for track in read_atl03(atl03, atl08) if atl08.exists() else []:
            measure([track])
            median, rmse = ground(track, atl03, atl08)
            print(f"  ground less ATL08: median {median:+.2f} m, RMSE {rmse:.2f} m")


if __name__ == "__main__":
    main()
