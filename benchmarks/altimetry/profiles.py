"""Photon profiles: ``python -m benchmarks.altimetry.profiles filters|speed``.

filters  simulated mountain and flat ground, green and infrared, bare and 40 % wooded, four
         seeds each of 3 km: precision, recall and F1 of signal, RMSE of the kept photons
         against the ground below them, RMSE of the ground profile, the share of cells that have
         one, and of those whose error is within ground_error and twice that; by ours, by the
         posterior as published, and by mDBSCAN.
speed    one million photons: labels and profile in this process, and a whole run.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.altimetry.photon_beams import (
    MEASURES,
    labelled,
    lattice,
    measures,
    profile,
    scene,
    workflow,
)
from spl_batch import api
from spl_batch.altimetry.simulate import (
    Light,
    SceneFile,
    Track,
    TrackScene,
    simulate,
    simulate_track,
)

SEEDS: Final = range(11, 15)
SCENES: Final = tuple(
    (kind, colour, canopy)
    for canopy in (0.0, 0.4)
    for kind in ("mountain", "flat")
    for colour in ("green", "infrared")
)


def tracks(kind: Any, colour: Any, canopy: float) -> Iterator[Track]:
    """The scene of each seed."""
    for seed in SEEDS:
        yield simulate_track(scene(kind, colour, seed, length_m=3000.0, canopy=canopy))


def ours(track: Track) -> list[float]:
    """Measures of our filter."""
    return measures(track, workflow())


def filters() -> None:
    """Ours beside the filters of the source."""
    for kind, colour, canopy in SCENES:
        print(f"{kind}, {colour}, {canopy:.0%} wooded")
        print(f"  {'':12}" + "".join(f"{h:>14}" for h in MEASURES))
        for method in ("likelihood", "published", "mdbscan"):
            settings = workflow(signal={"method": method})
            rows = [measures(track, settings) for track in tracks(kind, colour, canopy)]
            print(f"  {method:12}" + "".join(f"{v:14.3f}" for v in np.nanmean(rows, axis=0)))


def speed() -> None:
    """One million photons: stages here, then a whole run with one process."""
    wanted = TrackScene(length_m=24_000.0, seed=11)
    light = Light(signal_per_m=4.0, noise_per_m2=0.024)
    track = simulate_track(wanted.model_copy(update=light.model_dump()))
    photons = lattice(track.along_m, track.height_m)
    settings = workflow()
    for some in (slice(5000), slice(None)):
        start = time.process_time()
        beam = labelled((photons[0][some], photons[1][some]), settings)
        busy = time.process_time() - start
        profile(beam, settings)
        print(f"{len(beam.kept):,} photons: {busy:.1f} s, {time.process_time() - start:.1f} s")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = simulate(SceneFile(kind="altimetry", track=wanted, channels={"c1": light}), folder)
        start = time.process_time()
        done = api.run(made.workflow, workers=0, fresh=True, overrides=["reference.baseline=false"])
        memory = done.report.performance.peak_rss_mb
        print(f"whole run: {time.process_time() - start:.1f} s of one core, {memory:.0f} MB")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.profiles", description=__doc__
    )
    parser.add_argument("what", choices=["filters", "speed"])
    options = parser.parse_args(arguments)
    {"filters": filters, "speed": speed}[options.what]()


if __name__ == "__main__":
    main()
