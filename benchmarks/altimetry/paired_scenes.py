"""Simulated scenes by this version and by another, on the same tracks.

Run ``python -m benchmarks.altimetry.paired_scenes CHECKOUT``; CHECKOUT is a folder with another
version of this repository, ``--tracks N`` draws N tracks of each scene (seeds 11 on).

Both versions measure the tracks of :mod:`benchmarks.altimetry.profiles`, each in a process of its
own. Printed are the means of both, and the mean difference of the pairs with its standard error,
for F1, RMSE of the photons that are kept, and RMSE of the ground. A few photons far off decide an
RMSE, so the median of the differences and the tracks on which this version is better stand beside
it. A scene is worse where the mean difference is more than twice its error on the bad side.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FIRST_SEED = 11
MEASURED = {"F1": 2, "RMSE of photons [m]": 3, "RMSE of ground [m]": 4}
"""Columns of :data:`benchmarks.altimetry.photon_beams.MEASURES`."""

_PROGRAM = """
import json, sys
try:
    from benchmarks.altimetry import profiles
except ImportError:
    from benchmarks import altimetry as profiles
first, number = int(sys.argv[1]), int(sys.argv[2])
for kind, colour, canopy in profiles.SCENES:
    rows = []
    for seed in range(first, first + number):
        wanted = profiles.scene(kind, colour, seed, length_m=3000.0, canopy=canopy)
        track = profiles.simulate_track(wanted)
        rows.append([float(track.height_m.sum()), *profiles.ours(track)[:5]])
    print(json.dumps([f"{kind}, {colour}, {canopy:.0%} wooded", rows]), flush=True)
"""


def measured(checkout: Path, tracks: int) -> dict[str, NDArray[np.float64]]:
    """Sum of heights and measures of each track of each scene, (tracks, 6) float64."""
    command = [sys.executable, "-c", _PROGRAM, str(FIRST_SEED), str(tracks)]
    ended = subprocess.run(  # noqa: S603
        command,
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    found: list[Any] = [json.loads(line) for line in ended.stdout.splitlines()]
    return {name: np.array(rows) for name, rows in found}


def compared(here: NDArray[np.float64], there: NDArray[np.float64], *, more: bool) -> str:
    """Means, mean difference with its error, median and share of better tracks, and a verdict."""
    off = here - there
    error = off.std(ddof=1) / np.sqrt(len(off))
    good = off if more else -off
    worse = good.mean() < -2.0 * error
    better = np.count_nonzero(good > 0)
    return (
        f"{there.mean():9.3f}{here.mean():9.3f}{off.mean():+9.3f} +- {error:5.3f}"
        f"{np.median(off):+9.3f}{better:6} of {len(off)}  {'worse' if worse else ''}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.paired_scenes", description=__doc__
    )
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--tracks", type=int, default=32)
    options = parser.parse_args(arguments)
    there = measured(options.checkout.resolve(), options.tracks)
    here = measured(Path(__file__).resolve().parents[2], options.tracks)
    for what, column in MEASURED.items():
        print(f"{what:32}{'there':>9}{'here':>9}{'difference':>18}{'median':>9}    better")
        for name, rows in here.items():
            if not np.allclose(rows[:, 0], there[name][:, 0], rtol=0.0, atol=1e-3):
                raise SystemExit(f"{name}: both versions draw other tracks")
            pair = rows[:, 1 + column], there[name][:, 1 + column]
            print(f"  {name:30}{compared(*pair, more=what == 'F1')}")


if __name__ == "__main__":
    main()
