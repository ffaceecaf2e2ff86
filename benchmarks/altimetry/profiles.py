"""Photon profiles: ``python -m benchmarks.altimetry.profiles filters|pdf|levels|atl08 A B|speed``.

filters  simulated mountain and flat ground, green and infrared, bare and 40 % wooded, four
         seeds each of 3 km: precision, recall and F1 of signal, RMSE of the kept photons
         against the ground below them, RMSE of the ground profile, the share of cells that have
         one, and of those whose error is within ground_error and twice that.
         Ours, ours without scaling, mDBSCAN with and without scaling, and mDBSCAN with whichever
         of six ellipses gives the least RMSE of photons on that scene.
pdf      the same photons by the choices that the source leaves open: density of the signal
         unknown, or fixed contrasts; neighbourhoods as long as high, or longer; as many photons
         as the noise rate leaves over, or up to the best F1 to be expected.
levels   a wooded mountain of 2 km from no noise to 0.3 photons per square metre.
atl08    agreement with ATL08 on real photons, by where the noise rate comes from, and the noise
         by the product's rate over that by the window's; A an ATL03, B an ATL08 file.
speed    one million photons: the stages in this process, and a whole run with its memory.

Seeds are 11 to 14; the filter's settings were chosen on 1 to 4, those of profiles on 1 to 14.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.altimetry.photon_beams import MEASURES, SIGNAL, Beam, Mask, fixed, lattice, measures
from spl_batch import api
from spl_batch.altimetry.filter.likelihood import Ratios
from spl_batch.altimetry.formats.atl08 import find_labels
from spl_batch.altimetry.formats.photons import iter_photons, read_background
from spl_batch.altimetry.settings import BaselineSettings, SignalSettings
from spl_batch.altimetry.simulate import (
    Light,
    SceneFile,
    Track,
    TrackScene,
    scene,
    simulate,
    simulate_track,
)

SEEDS = range(11, 15)
ELLIPSES = ((10, 5), (12, 4), (15, 3), (20, 6), (30, 4), (10, 10))
SCENES = tuple(
    (kind, colour, canopy)
    for canopy in (0.0, 0.4)
    for kind in ("mountain", "flat")
    for colour in ("green", "infrared")
)


def show(rows: Mapping[str, Sequence[Sequence[float]]]) -> None:
    """Means over seeds."""
    print(f"  {'':34}" + "".join(f"{h:>14}" for h in MEASURES))
    for name, values in rows.items():
        mean = np.nanmean(np.array(values), axis=0)
        print(f"  {name:34}" + "".join(f"{v:14.3f}" for v in mean))


def tracks(kind: Any, colour: Any, canopy: float) -> Iterator[Track]:
    """The scene of each seed."""
    for seed in SEEDS:
        yield simulate_track(scene(kind, colour, seed, length_m=3000.0, canopy=canopy))


def ours(track: Track, signal: SignalSettings = SIGNAL, table: Ratios | None = None) -> list[float]:
    """Measures of our filter."""
    beam = Beam(lattice(track.along_m, track.height_m), track.background, signal)
    score = beam.score(table)
    some = beam.keep(score, table, ground=True)
    return measures(track, beam.keep(score, table), some)


def filters() -> None:
    """Ours beside mDBSCAN, scaled and not."""
    for kind, colour, canopy in SCENES:
        rows: dict[str, list[list[float]]] = {}
        ellipses: dict[str, list[list[float]]] = {}
        for track in tracks(kind, colour, canopy):
            beam = Beam(lattice(track.along_m, track.height_m), track.background)
            rows.setdefault("ours", []).append(ours(track))
            without = SIGNAL.model_copy(update={"scaling": False})
            rows.setdefault("ours, not scaled", []).append(ours(track, without))
            for scaled, word in ((True, "scaled"), (False, "not scaled")):
                for along, height in ELLIPSES:
                    chosen = BaselineSettings(scaled=scaled, along_m=along, height_m=height)
                    found = measures(track, beam.mdbscan(chosen))
                    ellipses.setdefault(f"{word} {along} x {height} m", []).append(found)
        default = BaselineSettings()
        for word in ("scaled", "not scaled"):
            name = f"{word} {default.along_m:g} x {default.height_m:g} m"
            rows[f"mDBSCAN, {name}"] = ellipses[name]
            best = min(
                (k for k in ellipses if k.startswith(word)),
                key=lambda k: np.nanmean([v[3] for v in ellipses[k]]),
            )
            rows[f"  its best: {best}"] = ellipses[best]
        print(f"{kind}, {colour}, {canopy:.0%} wooded")
        show(rows)


def choices() -> None:
    """What the source leaves open, on all scenes together."""
    kinds: dict[str, Callable[[Track], list[float]]] = {
        "density unknown, aspect 3": ours,
        "as many as the noise rate leaves": lambda t: ours(
            t, SIGNAL.model_copy(update={"selection": "number"})
        ),
        "density unknown, aspect 1": lambda t: ours(t, SIGNAL.model_copy(update={"aspect": 1.0})),
        "density unknown, aspect 6": lambda t: ours(t, SIGNAL.model_copy(update={"aspect": 6.0})),
        "12 neighbours": lambda t: ours(t, SIGNAL.model_copy(update={"neighbours": 12})),
        "no limit on far photons": lambda t: ours(
            t, SIGNAL.model_copy(update={"false_share": 0.999})
        ),
        **{f"contrast {c}": partial(ours, table=fixed(float(c))) for c in (2, 5, 20, 100)},
    }
    for canopy in (0.0, 0.4):
        rows: dict[str, list[list[float]]] = {name: [] for name in kinds}
        for kind, colour, wooded in SCENES:
            if wooded == canopy:
                for track in tracks(kind, colour, canopy):
                    for name, measure in kinds.items():
                        rows[name].append(measure(track))
        print(f"all four scenes, {canopy:.0%} wooded")
        show(rows)


def levels() -> None:
    """F1 and RMSE of photons, ours and mDBSCAN's on the scaled axis, by noise and signal."""
    heads = ("ours F1", "mDBSCAN F1", "ours RMSE", "mDBSCAN RMSE")
    print(f"  {'noise [1/m2]':>14}{'signal [1/m]':>14}" + "".join(f"{h:>14}" for h in heads))
    for noise in (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.3):
        for signal in (0.5, 5.0):
            track = simulate_track(
                scene(
                    "mountain", "green", SEEDS[0], length_m=2000.0, canopy=0.2, above_m=200.0,
                    below_m=200.0, noise_per_m2=noise, signal_per_m=signal,
                )
            )  # fmt: skip
            beam = Beam(lattice(track.along_m, track.height_m), track.background)
            theirs = measures(track, beam.mdbscan(BaselineSettings()))
            mine = ours(track)
            values = (mine[2], theirs[2], mine[3], theirs[3])
            print(f"  {noise:14g}{signal:14g}" + "".join(f"{v:14.3f}" for v in values))


def agreement(atl03: Path, atl08: Path) -> None:
    """Precision, recall and F1 against ATL08, of every beam."""
    for beam_name in ("gt1l", "gt1r", "gt2l", "gt2r", "gt3l", "gt3r"):
        theirs = find_labels(atl03, [atl08], beam_name) if _has(atl03, beam_name) else None
        if theirs is None:
            continue
        parts = list(iter_photons(atl03, "atl03", beam_name, 1 << 20))
        row = np.concatenate([p.row for p in parts])
        photons = tuple(np.concatenate([getattr(p, k) for p in parts]) for k in ("along", "height"))
        stated = read_background(atl03, "atl03", beam_name, None)
        inside = (row >= theirs.rows[0]) & (row < theirs.rows[1])
        signal = np.zeros(len(row), np.bool_)
        signal[inside] = theirs.signal(*theirs.rows)[row[inside] - theirs.rows[0]]
        print(f"{beam_name}: {len(row)} photons, {np.count_nonzero(signal)} signal in ATL08")
        print(f"  {'':34}{'kept':>8}{'precision':>11}{'recall':>9}{'F1':>8}")
        noise: dict[str, float] = {}
        for source in ("auto", "window", "product"):
            beam = Beam(photons, stated, source=source)
            kept = beam.keep(beam.score()) & inside
            _agree(f"ours, rate from {source}", kept, signal)
            noise[source] = float(beam.scale.noise.sum())
        print(f"  noise by product over by window: {noise['product'] / noise['window']:.3f}")
        beam = Beam(photons, stated)
        for along, height in ELLIPSES:
            for scaled, word in ((True, "scaled"), (False, "not scaled")):
                chosen = BaselineSettings(scaled=scaled, along_m=along, height_m=height)
                name = f"mDBSCAN {along} x {height} m, {word}"
                _agree(name, beam.mdbscan(chosen) & inside, signal)


def _has(path: Path, beam: str) -> bool:
    from spl_batch.altimetry.formats.photons import inspect  # noqa: PLC0415

    return any(facts.name == beam for facts in inspect(path, None).beams)


def _agree(name: str, kept: Mask, signal: Mask) -> None:
    both = np.count_nonzero(kept & signal)
    precision, recall = both / max(kept.sum(), 1), both / max(signal.sum(), 1)
    f1 = 2 * both / (kept.sum() + signal.sum())
    print(f"  {name:34}{kept.sum():8}{precision:11.3f}{recall:9.3f}{f1:8.3f}")


def speed() -> None:
    """One million photons: stages here, then a whole run with one process."""
    wanted = TrackScene(length_m=24_000.0, seed=11)
    light = Light(signal_per_m=4.0, noise_per_m2=0.024)
    track = simulate_track(wanted.model_copy(update=light.model_dump()))
    photons = lattice(track.along_m, track.height_m)
    small = tuple(values[:5000] for values in photons)
    warm = Beam(small, None)
    warm.keep(warm.score())
    short = simulate_track(wanted.model_copy(update={"length_m": 400.0}))
    measures(short, short.truth > 0)
    n = len(track.along_m)
    start = (time.perf_counter(), time.process_time())
    beam = Beam(photons, track.background)
    score = beam.score()
    kept = beam.keep(score)
    some = beam.keep(score, ground=True)
    found = measures(track, kept, some)
    wall, busy = time.perf_counter() - start[0], time.process_time() - start[1]
    print(f"{n:,} photons, {np.count_nonzero(track.truth):,} of signal, F1 {found[2]:.3f}")
    print(f"stages: {busy:.1f} s of one core, {wall:.1f} s wall")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = simulate(SceneFile(kind="altimetry", track=wanted, channels={"c1": light}), folder)
        for words, override in (("", []), (", mDBSCAN beside it", ["reference.baseline=true"])):
            start = (time.perf_counter(), time.process_time())
            done = api.run(
                made.workflow,
                workers=0,
                fresh=True,
                overrides=override or ["reference.baseline=false"],
            )
            wall, busy = time.perf_counter() - start[0], time.process_time() - start[1]
            memory = done.report.performance.peak_rss_mb
            print(
                f"whole run with report{words}: {busy:.1f} s of one core, {wall:.1f} s wall, "
                f"{memory:.0f} MB"
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.profiles", description=__doc__
    )
    parser.add_argument("what", choices=["filters", "pdf", "levels", "atl08", "speed"])
    parser.add_argument("files", nargs="*", type=Path)
    options = parser.parse_args(arguments)
    if options.what == "filters":
        filters()
    elif options.what == "pdf":
        choices()
    elif options.what == "levels":
        levels()
    elif options.what == "speed":
        speed()
    elif len(options.files) == 2:
        agreement(*options.files)
    else:
        parser.error("atl08 takes two files: one of ATL03, and one of ATL08")


if __name__ == "__main__":
    main()
