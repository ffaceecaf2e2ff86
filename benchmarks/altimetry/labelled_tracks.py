"""Real tracks with others' labels.

Run ``python -m benchmarks.altimetry.labelled_tracks FOLDER``; options are below.

FOLDER holds tracks as CSV (x along the track [m], height [m], label: 1 noise, 2 water surface,
3 floor, 4 land, 0 unknown) and, where it has them, a pair ``atl03*.h5`` and ``atl08*.h5``. Unknown
photons are left out. Signal is 2, 3 and 4; "floor" is the share of 3 that is kept. "Noise told" is
the noise that the filter itself expects among the photons that it takes, over that by the labels;
"s/M" are seconds of this process for a million photons, kernels compiled.

Other filters run as published, by scikit-learn (``pip install 'spl-batch[peers]'``); mDBSCAN is
this project's. "ours, no land" leaves out what lies within 10 m of a photon of land: labels with
one signal photon per shot call the others of the land, and its trees, noise. How much they call
noise there is printed beside what it would be at the density elsewhere, and what is told over what
is labelled farther from land than some distances. Below it stands what the
filter tells and the labels call noise by part of the track; what labels cannot say of it is
measured by :mod:`benchmarks.altimetry.label_rule`.

``--picture FOLDER`` draws labels and ours of each track. ``--halves`` cuts each track in the
middle. ``--scale KEY=FACTOR`` multiplies a setting of ``signal``, to see what hangs on it.
:mod:`benchmarks.altimetry.varied_tracks` measures what is made of the tracks.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.altimetry.photon_beams import PROFILE, SIGNAL, Beam, Mask, Photons, lattice
from benchmarks.altimetry.told_noise import by_part, in_words
from spl_batch.altimetry.filter.peer_filters import PEERS
from spl_batch.altimetry.filter.peer_filters import keep as keep_peer
from spl_batch.altimetry.formats.atl08 import find_labels
from spl_batch.altimetry.formats.photons import inspect, iter_photons, read_background
from spl_batch.altimetry.ground.profile import for_layout, profile, spread_m
from spl_batch.altimetry.photon_table import Background
from spl_batch.altimetry.settings import BaselineSettings, SignalSettings
from spl_batch.constants import QUANTA_PER_M

NOISE, SURFACE, FLOOR, LAND = 1, 2, 3, 4
LAND_M, BAND_M = 10.0, 2.0
"""Reach of a photon of land along the track; half-height of what is looked at around it [m]."""

REACHES_M = (2.0, 5.0, 10.0, 20.0, 50.0)
"""Distances from land beyond which the noise that is told is put beside the labels' [m]."""

HEADS = ("photons", "kept", "F1", "balanced", "floor", "precision", "recall", "told", "s/M")


class Labelled(NamedTuple):
    """A track and what others say of it."""

    name: str
    photons: Photons
    label: NDArray[np.int64]
    background: Background | None = None


class Found(NamedTuple):
    """What a method takes, the noise that it tells of, its time [s], and the beam if it is ours."""

    kept: Mask
    told: float
    seconds: float
    beam: Beam | None = None


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
    start = time.process_time()
    beam = Beam(track.photons, track.background, signal)
    kept = beam.keep(beam.score())
    return Found(kept, beam.told, time.process_time() - start, beam)


def mdbscan(track: Labelled) -> Found:
    """Photons by mDBSCAN as it stands here."""
    start = time.process_time()
    kept = Beam(track.photons, track.background).mdbscan(BaselineSettings())
    return Found(kept, np.nan, time.process_time() - start)


def peer(name: str) -> Callable[[Labelled], Found]:
    """A published filter."""

    def run(track: Labelled) -> Found:
        start = time.process_time()
        kept = keep_peer(name, *(values / QUANTA_PER_M for values in track.photons))
        return Found(kept, np.nan, time.process_time() - start)

    return run


def measured(kept: Mask, label: NDArray[np.int64]) -> tuple[float, float, float]:
    """Balanced accuracy, F1 and recall of the floor."""
    known = label > 0
    kept, signal, floor = kept[known], label[known] > NOISE, label[known] == FLOOR
    both = np.count_nonzero(kept & signal)
    recall = both / np.count_nonzero(signal) if signal.any() else np.nan
    rejected = 1.0 - kept[~signal].mean() if (~signal).any() else np.nan
    f1 = 2 * both / (kept.sum() + signal.sum()) if signal.any() else np.nan
    return (recall + rejected) / 2.0, f1, kept[floor].mean() if floor.any() else np.nan


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
    print(f"  {name:14}{len(label):10}{np.count_nonzero(found.kept):10}{numbers}", flush=True)


def over_land(track: Labelled, along: NDArray[np.int64], reach_m: float = LAND_M) -> Mask:
    """Places within reach of a photon of land, (n,) bool."""
    land = np.sort(track.photons[0][track.label == LAND])
    reach = round(reach_m * QUANTA_PER_M)
    near: Mask = np.searchsorted(land, along - reach) < np.searchsorted(land, along + reach)
    return near


def where_labels_tell(track: Labelled, found: Found) -> None:
    """Noise told and labelled among what is taken, by part."""
    beam, noise = found.beam, track.label == NOISE
    if beam is None:
        return
    parts = by_part(beam, found.kept, noise, lambda along: over_land(track, along))
    print(f"  noise told / labelled: {in_words(parts)}")


def without_land(track: Labelled, found: Found) -> None:
    """A line of the table without what lies over land, and how dense its noise is said to be."""
    along, height = track.photons
    away = ~over_land(track, along)
    if found.beam is None or away.all():
        return
    at, _, each = found.beam.told_at
    told = float(each[~over_land(track, at)].sum())
    row("ours, no land", Found(found.kept[away], told, found.seconds), track.label[away])
    noise, land = track.label == NOISE, track.label == LAND
    ratios = []
    for reach_m in REACHES_M:
        far = ~over_land(track, along, reach_m)
        labelled = np.count_nonzero(found.kept & noise & far)
        ratios.append(each[~over_land(track, at, reach_m)].sum() / max(labelled, 1))
    told_over = ", ".join(f"{m:g} m {v:.2f}" for m, v in zip(REACHES_M, ratios, strict=True))
    print(f"  noise told / labelled farther from land than: {told_over}")
    order = np.argsort(along[land], kind="stable")
    line = np.interp(along, along[land][order], height[land][order].astype(float))
    band = np.abs(height - line) <= BAND_M * QUANTA_PER_M
    cells = len(np.unique(along[~away] // QUANTA_PER_M))
    there = np.count_nonzero(noise & ~away & band)
    expected = np.count_nonzero(noise & ~away & ~band)
    gate_m = (height.max() - height.min()) / QUANTA_PER_M
    expected *= 2.0 * BAND_M / (gate_m - 2.0 * BAND_M)
    print(
        f"  over {cells} m of land the labels call {there} photons within {BAND_M:g} m of it "
        f"noise; as dense as elsewhere in the gate they would be {expected:.0f}"
    )


def draw(track: Labelled, found: Found, folder: Path) -> None:
    """Labels above, ours below, in one picture."""
    figure = Figure(figsize=(16.0, 11.0), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True, sharey=True)
    x, z = (values / QUANTA_PER_M for values in track.photons)
    for axes, kind in ((panels[0], track.label), (panels[1], np.where(found.kept, SURFACE, NOISE))):
        for value, colour in (
            (NOISE, "0.6"),
            (SURFACE, "tab:blue"),
            (FLOOR, "tab:red"),
            (LAND, "g"),
        ):
            axes.plot(x[kind == value], z[kind == value], ".", ms=1.5, color=colour)
    only = found.kept & (track.label == NOISE)
    panels[1].plot(x[only], z[only], ".", ms=2.5, color="tab:orange")
    panels[0].set_title("labels: grey noise, blue surface, red floor, green land")
    panels[1].set_title("ours: blue kept; orange kept and noise by the labels")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{track.name}.png", dpi=80)


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
    spread = spread_m(PROFILE, "atl03")
    columns = profile(along[rows], height[rows], kept[rows], whole, settings, spread).columns
    at, theirs, photons = reference(track.name, atl03, atl08)
    known = np.isfinite(columns["ground"])
    mine = np.interp(at, columns["along_track"][known], columns["ground"][known], np.nan, np.nan)
    off = (mine - theirs)[np.isfinite(mine)]
    low = quantiles(along[kept], height[kept], at)[np.isfinite(mine)] - theirs[np.isfinite(mine)]
    for name, values in (("ours", off), ("10 % quantile of what is kept", low)):
        rmse = np.sqrt(np.mean(values**2))
        print(f"  ground less ATL08, {name}: median {np.median(values):+.2f} m, RMSE {rmse:.2f} m")
    many = photons[np.isfinite(mine)] >= 5
    rmse = np.sqrt(np.mean(off[many] ** 2))
    print(
        f"  ours where ATL08 has 5 photons of ground or more, {many.sum()} of {len(many)}: "
        f"RMSE {rmse:.2f} m"
    )


def quantiles(
    along: NDArray[np.int64], height: NDArray[np.int32], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The tenth part of photons within 10 m lies below this, (n,) [m]."""
    near = [np.abs(along / QUANTA_PER_M - x) <= 10.0 for x in at]
    return np.array([np.quantile(height[n], 0.1) / 1e3 if n.any() else np.nan for n in near])


def reference(
    beam: str, atl03: Path, atl08: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Where ATL08 fits the terrain in pieces of 20 m, its height [m] and ground photons."""
    with h5py.File(atl08) as theirs, h5py.File(atl03) as file:
        land = theirs[f"{beam}/land_segments"]
        height = land["terrain/h_te_best_fit_20m"][()].astype(np.float64)
        number = land["segment_id_beg"][()][:, None] + np.arange(height.shape[1])
        place = file[f"{beam}/geolocation"]
        known = place["segment_id"][()].astype(np.int64)
        start = place["segment_dist_x"][()] + place["segment_length"][()] / 2.0
        listed = theirs[f"{beam}/signal_photons"]
        ground = listed["ph_segment_id"][()][listed["classed_pc_flag"][()] == 1].astype(np.int64)
    inside = np.isin(number, known) & (np.abs(height) < 1e5)
    photons = np.array([np.count_nonzero(ground == one) for one in number[inside]])
    return start[np.searchsorted(known, number[inside])], height[inside], photons


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


def measure(
    tracks: Sequence[Labelled], signal: SignalSettings, picture: Path | None = None
) -> None:
    """The table: each track, and all photons of those with water together."""
    methods: dict[str, Callable[[Labelled], Found]] = {
        "ours": lambda track: ours(track, signal),
        "mdbscan": mdbscan,
        **{name: peer(name) for name in PEERS},
    }
    ours(tracks[0], signal)
    pooled: dict[str, list[Found]] = {name: [] for name in methods}
    print(f"  {'':14}" + "".join(f"{head:>10}" for head in HEADS))
    for track in tracks:
        print(track.name)
        for name, method in methods.items():
            found = method(track)
            pooled[name].append(found)
            row(name, found, track.label)
            if name == "ours":
                without_land(track, found)
                where_labels_tell(track, found)
                if picture is not None:
                    draw(track, found, picture)
    if len(tracks) > 1:
        print("pooled")
        label = np.concatenate([track.label for track in tracks])
        for name, parts in pooled.items():
            kept, told, seconds, _ = zip(*parts, strict=True)
            row(name, Found(np.concatenate(kept), sum(told), sum(seconds)), label)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables of a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.labelled_tracks", description=__doc__
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--halves", action="store_true", help="cut each track in the middle")
    parser.add_argument("--picture", type=Path, metavar="FOLDER", help="draw each track there")
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
        measure(water, signal, options.picture)
    for atl03 in sorted(options.folder.glob("atl03*.h5")):
        atl08 = atl03.with_name(atl03.name.replace("atl03", "atl08"))
        for track in read_atl03(atl03, atl08) if atl08.exists() else []:
            measure([track], signal)
            ground(track, atl03, atl08)


if __name__ == "__main__":
    main()
