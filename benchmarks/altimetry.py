"""Photon profiles: ``python -m benchmarks.altimetry filters|pdf|levels|atl08 A B|speed``.

filters  simulated mountain and flat ground, green and infrared, bare and 40 % wooded, four
         seeds each of 3 km: precision, recall and F1 of signal, RMSE of the kept photons
         against the ground below them, RMSE of the ground profile and the share of cells that
         have one. Ours, ours without scaling, mDBSCAN with and without scaling, and mDBSCAN
         with whichever of six ellipses gives the least RMSE of photons on that scene.
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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from spl_batch import api
from spl_batch.altimetry.io.atl08 import find_labels
from spl_batch.altimetry.io.photons import iter_photons, read_background
from spl_batch.altimetry.kernels.posterior import noise_posterior
from spl_batch.altimetry.model import Background
from spl_batch.altimetry.settings import (
    BaselineSettings,
    ProfileSettings,
    RateSettings,
    SignalSettings,
)
from spl_batch.altimetry.simulate import (
    Light,
    SceneFile,
    Track,
    TrackScene,
    scene,
    simulate,
    simulate_track,
)
from spl_batch.altimetry.stages import chance
from spl_batch.altimetry.stages import rate as rates
from spl_batch.altimetry.stages import signal as signals
from spl_batch.altimetry.stages.likelihood import Ratios, ratios
from spl_batch.altimetry.stages.profile import profile
from spl_batch.constants import QUANTA_PER_M

SEEDS = range(11, 15)
RATE, SIGNAL, PROFILE = RateSettings(), SignalSettings(), ProfileSettings()
ELLIPSES = ((10, 5), (12, 4), (15, 3), (20, 6), (30, 4), (10, 10))
SCENES = tuple(
    (kind, colour, canopy)
    for canopy in (0.0, 0.4)
    for kind in ("mountain", "flat")
    for colour in ("green", "infrared")
)

Photons = tuple[NDArray[np.int64], NDArray[np.int32]]
Mask = NDArray[np.bool_]


class Beam:
    """A beam in memory: cells, rate and scaled axis, as the tasks of a run make them."""

    def __init__(
        self,
        photons: Photons,
        background: Background | None,
        signal: SignalSettings = SIGNAL,
        source: str = "auto",
    ) -> None:
        self.along, self.height = photons
        self.signal = signal
        self.cells = rates.observe(self.along, self.height, RATE)
        if background is None or source == "window":
            density = rates.density_from_window(self.cells, RATE)
        elif source == "product":
            density = rates.density_from_product(self.cells, background, RATE)
        else:
            density = rates.density_from_both(self.cells, background, RATE, signal.window_m)
        self.scale = rates.scale(self.cells, density, RATE, signal)

    def keep(
        self, score: NDArray[np.float32], table: Ratios | None = None, *, ground: bool = False
    ) -> Mask:
        """Photons that are signal, or those that the ground is sought among, as in a run."""
        window_m, settings = self.signal.window_m, self.signal
        index = rates.window_of(self.scale.index, RATE, window_m)
        values = np.stack(
            [
                self.cells.count.astype(float),
                self.scale.noise,
                self.cells.gate_m,
                rates.far_length_m(self.cells, RATE),
            ]
        )
        _, sums = rates.of_window(self.scale.index, values, RATE, window_m)
        window = np.unique(index)

        def counted(along: Any, score: Any, value: Any) -> NDArray[np.float64]:
            one = np.zeros((len(window), signals.SCORE_BINS))
            of = rates.window_of(along // round(RATE.cell_m * 1000), RATE, window_m)
            np.add.at(one, (np.searchsorted(window, of), signals.score_bins(score)), value)
            return rates.running(window, one.T).T

        far = rates.far(self.along, self.height, self.cells, RATE)
        counts, away = (counted(self.along, score, value) for value in (1, far))
        wanted, share = np.maximum(sums[0] - sums[1], 0.0), sums[2] / np.maximum(sums[3], 1)
        least = signals.thresholds(counts, away, wanted, share, settings.false_share)
        if settings.selection == "f1":
            every = np.ones(len(self.cells.index), np.bool_)
            along, height, noise = chance.places(self.cells, self.scale, every, RATE)
            prior = signals.log_prior(self.cells, self.scale, RATE, window_m)
            likelihoods = table or ratios(settings.neighbours, settings.contrast_max)
            at, photons = (along, height), (self.along, self.height)
            found = chance.score_places(at, photons, self.scale, prior, RATE, likelihoods)
            expected = counted(along, found, noise / chance.SHARE_QUANTA)
            limits = (wanted, share, settings.false_share)
            least = chance.best_thresholds(counts, expected, away, *limits)
        if ground:
            wanted = PROFILE.photons_factor * wanted
            more = signals.thresholds(counts, away, wanted, share, PROFILE.false_share)
            least = np.minimum(least, more)
        of = rates.window_of(self.along // round(RATE.cell_m * 1000), RATE, window_m)
        kept: Mask = signals.score_bins(score) >= least[np.searchsorted(window, of)]
        return kept

    def score(self, table: Ratios | None = None) -> NDArray[np.float32]:
        """Scores of all photons; by another table of likelihoods where one is given."""
        prior = signals.log_prior(self.cells, self.scale, RATE, self.signal.window_m)
        every = np.ones(len(self.along), np.bool_)
        if table is None:
            return signals.score(
                self.along, self.height, every, self.scale, prior, RATE, self.signal
            )
        u, v, cell = signals.scaled(self.along, self.height, self.scale, RATE)
        uv = np.stack([u - u.min(), v - v.min()], axis=1).astype(np.int32)
        result = noise_posterior(
            uv, every, round(rates.CAP_UNITS * signals.UNIT_QUANTA),
            np.pi * self.scale.alpha[cell] / signals.UNIT_QUANTA**2, prior[cell],
            table.within, table.beyond, (table.first, table.step),
        )  # fmt: skip
        return result.astype(np.float32)

    def mdbscan(self, settings: BaselineSettings) -> Mask:
        """Signal by mDBSCAN."""
        chosen = self.signal.model_copy(update={"mdbscan": settings})
        mean = signals.mean_density(self.cells, self.scale, RATE, chosen)
        return signals.mdbscan(self.along, self.height, self.scale, mean, RATE, settings)


def lattice(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> Photons:
    """Photons on the lattice."""
    whole = [np.rint(v * QUANTA_PER_M) for v in (along_m, height_m)]
    return whole[0].astype(np.int64), whole[1].astype(np.int32)


def fixed(contrast: float) -> Ratios:
    """Likelihoods of signal that is always this many times as dense as noise."""
    first, last, columns = np.log(1e-7), np.log(400.0), 1024
    x = np.exp(np.linspace(first, last, columns))
    k = np.arange(1, SIGNAL.neighbours + 1)[:, None]
    within = k * np.log(contrast) - (contrast - 1.0) * x
    beyond = np.log(np.maximum(special.gammaincc(k, contrast * x), 1e-300)) - np.log(
        np.maximum(special.gammaincc(k, x), 1e-300)
    )
    return Ratios(within, beyond, float(first), (columns - 1) / float(last - first))


def measures(track: Track, kept: Mask, some: Mask | None = None) -> list[float]:
    """Precision, recall, F1; RMSE of photons and of the profile [m]; cells with a ground."""
    signal = track.truth > 0
    both = np.count_nonzero(kept & signal)
    precision = both / max(np.count_nonzero(kept), 1)
    recall = both / np.count_nonzero(signal)
    off = (track.height_m - track.ground_m)[kept]
    along, height = lattice(track.along_m, track.height_m)
    rows = np.flatnonzero(kept if some is None else some | kept)
    rows = rows[np.lexsort((height[rows], along[rows]))]
    columns = profile(along[rows], height[rows], kept[rows], (-(10**9), 10**9), PROFILE).columns
    error = columns["ground"] - np.interp(columns["along_track"], *track.reference_m.T)
    known = np.isfinite(error)
    cells = track.along_m.max() / PROFILE.cell_m
    return [
        precision,
        recall,
        2 * both / max(np.count_nonzero(kept) + np.count_nonzero(signal), 1),
        float(np.sqrt(np.mean(off**2))) if len(off) else np.nan,
        float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else np.nan,
        np.count_nonzero(known) / cells,
    ]


def show(rows: Mapping[str, Sequence[Sequence[float]]]) -> None:
    """Means over seeds."""
    heads = ("precision", "recall", "F1", "photons RMSE", "profile RMSE", "cells")
    print(f"  {'':34}" + "".join(f"{h:>14}" for h in heads))
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
        **{
            f"contrast {c}": lambda t, c=c: ours(t, table=fixed(float(c)))  # type: ignore[misc]
            for c in (2, 5, 20, 100)
        },
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
            beam = Beam(photons, stated, source=source)  # type: ignore[arg-type]
            kept = beam.keep(beam.score()) & inside
            _agree(f"ours, rate from {source}", kept, signal)
            noise[source] = float(beam.scale.noise.sum())
        print(f"  noise by product over by window: {noise['product'] / noise['window']:.3f}")
        beam = Beam(photons, stated)  # type: ignore[arg-type]
        for along, height in ELLIPSES:
            for scaled, word in ((True, "scaled"), (False, "not scaled")):
                chosen = BaselineSettings(scaled=scaled, along_m=along, height_m=height)
                name = f"mDBSCAN {along} x {height} m, {word}"
                _agree(name, beam.mdbscan(chosen) & inside, signal)


def _has(path: Path, beam: str) -> bool:
    from spl_batch.altimetry.io.photons import inspect  # noqa: PLC0415

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
    warm = Beam(small, None)  # type: ignore[arg-type]
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
    parser = argparse.ArgumentParser(prog="python -m benchmarks.altimetry", description=__doc__)
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
