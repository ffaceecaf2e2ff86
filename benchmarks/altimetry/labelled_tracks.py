"""Real tracks with others' labels.

Run ``python -m benchmarks.altimetry.labelled_tracks FOLDER [--halves]``.

FOLDER holds tracks as CSV (x along the track [m], height [m], label: 1 noise, 2 water surface,
3 floor, 4 land, 0 unknown) and, where it has them, a pair ``atl03*.h5`` and ``atl08*.h5``. Unknown
photons are left out. Signal is 2, 3 and 4; "floor" is the share of 3 that is kept. "Noise told" is
the noise that the filter itself expects among the photons that it takes, over that by the labels;
"s/M" are seconds of this process for a million photons, kernels compiled.

Other filters run as published, by scikit-learn (``pip install 'spl-batch[peers]'``); mDBSCAN is
this project's. ``--halves`` cuts each track in the middle. ``--scale KEY=FACTOR`` multiplies a
setting of ``signal``, to see what hangs on it.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from benchmarks.altimetry.photon_beams import PROFILE, SIGNAL, Beam, Mask, Photons, lattice
from spl_batch.altimetry.filter.peer_filters import PEERS
from spl_batch.altimetry.filter.peer_filters import keep as keep_peer
from spl_batch.altimetry.formats.atl08 import find_labels
from spl_batch.altimetry.formats.photons import inspect, iter_photons, read_background
from spl_batch.altimetry.ground.profile import for_layout, profile
from spl_batch.altimetry.photon_table import Background
from spl_batch.altimetry.settings import BaselineSettings, SignalSettings
from spl_batch.constants import QUANTA_PER_M

NOISE, FLOOR = 1, 3
HEADS = ("photons", "kept", "F1", "balanced", "floor", "precision", "recall", "told", "s/M")


class Labelled(NamedTuple):
    """A track and what others say of it."""

    name: str
    photons: Photons
    label: NDArray[np.int64]
    background: Background | None = None


class Found(NamedTuple):
    """What a method takes, the noise that it tells of, and its time [s]."""

    kept: Mask
    told: float
    seconds: float


def read_csv(path: Path) -> Labelled:
    """A track with labels."""
    x, z, label = np.genfromtxt(path, delimiter=",", skip_header=1).T
    return Labelled(path.stem, lattice(x, z), label.astype(np.int64))


def read_atl03(atl03: Path, atl08: Path) -> list[Labelled]:
    """Beams of ATL03 with the classes of ATL08: noise 1, signal 2, unknown 0."""
    found = []
    for facts in inspect(atl03, None).beams:
        theirs = find_labels(atl03, [atl08], facts.name)
        if theirs is None:
            continue
        parts = list(iter_photons(atl03, "atl03", facts.name, 1 << 20))
        row = np.concatenate([p.row for p in parts])
        along, height = (
            np.concatenate([getattr(p, k) for p in parts]) for k in ("along", "height")
        )
        inside = (row >= theirs.rows[0]) & (row < theirs.rows[1])
        label = inside.astype(np.int64)
        label[inside] += theirs.signal(*theirs.rows)[row[inside] - theirs.rows[0]]
        stated = read_background(atl03, "atl03", facts.name, None)
        found.append(Labelled(facts.name, (along, height), label, stated))
    return found


def ours(track: Labelled, signal: SignalSettings = SIGNAL) -> Found:
    """Our filter with its defaults."""
    start = time.perf_counter()
    beam = Beam(track.photons, track.background, signal)
    kept = beam.keep(beam.score())
    return Found(kept, beam.told, time.perf_counter() - start)


def mdbscan(track: Labelled) -> Found:
    """Photons by mDBSCAN as it stands here."""
    start = time.perf_counter()
    kept = Beam(track.photons, track.background).mdbscan(BaselineSettings())
    return Found(kept, np.nan, time.perf_counter() - start)


def peer(name: str) -> Callable[[Labelled], Found]:
    """A published filter."""

    def run(track: Labelled) -> Found:
        start = time.perf_counter()
        kept = keep_peer(name, *(values / QUANTA_PER_M for values in track.photons))
        return Found(kept, np.nan, time.perf_counter() - start)

    return run


def row(name: str, found: Found, label: NDArray[np.int64]) -> None:
    """A line of the table."""
    known = label > 0
    kept, signal = found.kept[known], label[known] > NOISE
    both, false = np.count_nonzero(kept & signal), np.count_nonzero(kept & ~signal)
    recall = both / max(np.count_nonzero(signal), 1)
    rejected = 1.0 - false / max(np.count_nonzero(~signal), 1)
    floor = label == FLOOR
    values = (
        2 * both / max(kept.sum() + signal.sum(), 1),
        (recall + rejected) / 2,
        found.kept[floor].mean() if floor.any() else np.nan,
        both / max(kept.sum(), 1),
        recall,
        found.told / max(false, 1),
        found.seconds / len(label) * 1e6,
    )
    numbers = "".join("         -" if np.isnan(v) else f"{v:10.3f}" for v in values)
    print(f"  {name:12}{len(label):10}{np.count_nonzero(found.kept):10}{numbers}", flush=True)


def ground(track: Labelled, atl03: Path, atl08: Path) -> None:
    """Our ground less ATL08's best fit of each 20 m."""
    beam = Beam(track.photons, track.background)
    score = beam.score()
    kept = beam.keep(score)
    rows = np.flatnonzero(kept | beam.keep(score, ground=True))
    along, height = track.photons
    rows = rows[np.lexsort((height[rows], along[rows]))]
    whole = (-(10**9), 10**9)
    settings = for_layout(PROFILE, "atl03")
    columns = profile(along[rows], height[rows], kept[rows], whole, settings).columns
    at, theirs = reference(track.name, atl03, atl08)
    known = np.isfinite(columns["ground"])
    mine = np.interp(at, columns["along_track"][known], columns["ground"][known], np.nan, np.nan)
    off = (mine - theirs)[np.isfinite(mine)]
    low = quantiles(along[kept], height[kept], at)[np.isfinite(mine)] - theirs[np.isfinite(mine)]
    for name, values in (("ours", off), ("10 % quantile of what is kept", low)):
        rmse = np.sqrt(np.mean(values**2))
        print(f"  ground less ATL08, {name}: median {np.median(values):+.2f} m, RMSE {rmse:.2f} m")


def quantiles(
    along: NDArray[np.int64], height: NDArray[np.int32], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The tenth part of photons within 10 m lies below this, (n,) [m]."""
    near = [np.abs(along / QUANTA_PER_M - x) <= 10.0 for x in at]
    return np.array([np.quantile(height[n], 0.1) / 1e3 if n.any() else np.nan for n in near])


def reference(
    beam: str, atl03: Path, atl08: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where ATL08 fits the terrain in pieces of 20 m, and how high it is [m]."""
    with h5py.File(atl08) as theirs, h5py.File(atl03) as file:
        land = theirs[f"{beam}/land_segments"]
        height = land["terrain/h_te_best_fit_20m"][()].astype(np.float64)
        number = land["segment_id_beg"][()][:, None] + np.arange(height.shape[1])
        place = file[f"{beam}/geolocation"]
        known = place["segment_id"][()].astype(np.int64)
        start = place["segment_dist_x"][()] + place["segment_length"][()] / 2.0
    inside = np.isin(number, known) & (np.abs(height) < 1e5)
    return start[np.searchsorted(known, number[inside])], height[inside]


def halves(track: Labelled) -> list[Labelled]:
    """The track cut in the middle."""
    middle = np.median(track.photons[0])
    parts = []
    for name, some in (
        ("first", track.photons[0] < middle),
        ("second", track.photons[0] >= middle),
    ):
        photons = track.photons[0][some], track.photons[1][some]
        parts.append(Labelled(f"{track.name}, {name} half", photons, track.label[some]))
    return parts


def measure(tracks: Sequence[Labelled], signal: SignalSettings) -> None:
    """The table: each track, and all photons of those with water together."""
    methods: dict[str, Callable[[Labelled], Found]] = {
        "ours": lambda track: ours(track, signal),
        "mdbscan": mdbscan,
        **{name: peer(name) for name in PEERS},
    }
    ours(tracks[0], signal)
    pooled: dict[str, list[Found]] = {name: [] for name in methods}
    print(f"  {'':12}" + "".join(f"{head:>10}" for head in HEADS))
    for track in tracks:
        print(track.name)
        for name, method in methods.items():
            found = method(track)
            pooled[name].append(found)
            row(name, found, track.label)
    if len(tracks) > 1:
        print("pooled")
        label = np.concatenate([track.label for track in tracks])
        for name, parts in pooled.items():
            kept, told, seconds = zip(*parts, strict=True)
            row(name, Found(np.concatenate(kept), sum(told), sum(seconds)), label)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables of a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.labelled_tracks", description=__doc__
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--halves", action="store_true", help="cut each track in the middle")
    parser.add_argument("--scale", action="append", default=[], metavar="KEY=FACTOR")
    options = parser.parse_args(arguments)
    changed = {}
    for text in options.scale:
        key, factor = text.split("=")
        value = getattr(SIGNAL, key)
        changed[key] = type(value)(round(value * float(factor), 6))
    signal = SIGNAL.model_copy(update=changed)
    water = [read_csv(path) for path in sorted(options.folder.glob("*.csv"))]
    if options.halves:
        water = [part for track in water for part in halves(track)]
    if water:
        measure(water, signal)
    for atl03 in sorted(options.folder.glob("atl03*.h5")):
        atl08 = atl03.with_name(atl03.name.replace("atl03", "atl08"))
        for track in read_atl03(atl03, atl08) if atl08.exists() else []:
            measure([track], signal)
            ground(track, atl03, atl08)


if __name__ == "__main__":
    main()
