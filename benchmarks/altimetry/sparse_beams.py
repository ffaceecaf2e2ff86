"""Weak beams by day: few photons of signal a shot under a bright sky, beside published filters.

Run ``python -m benchmarks.altimetry.sparse_beams``; ``--seed N`` draws others, ``--every`` prints
each track and not the means over skies alone.

Tracks of 4 km are drawn as of :mod:`benchmarks.altimetry.unseen_tracks`: a plain, hills of slopes
up to 0.18, mountains of slopes up to 0.5, hills under trees, a lake, and a shelf whose floor
sinks from 3 to 20 m. A shot has 0.1 to 0.7 photons of signal in the mean; the sky counts 1, 2, 4
and 8 MHz. Printed are balanced accuracy and F1 of ours, DBSCAN and kNN + Otsu, the noise told over
the true one, and on how many of the skies a warning says that the signal cannot be told from noise.
"""

import argparse
from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.altimetry.labelled_tracks import NOISE, measured, ours, peer
from benchmarks.altimetry.unseen_tracks import AHEAD, SHOT_M, THEIRS, Country
from spl_batch.constants import SPEED_OF_LIGHT_M_S

PHOTONS = (0.1, 0.2, 0.4, 0.7)
"""Signal of a shot in the mean [count]."""

SKIES_MHZ = (1.0, 2.0, 4.0, 8.0)


def plain(c: Country, photons: float) -> None:
    """A plain that rises by 3 m in a kilometre."""
    c.ground(photons, 0.003 * c.x + 1.2 * np.sin(c.x / 210.0), 0.12)


def hills(c: Country, photons: float) -> None:
    """Bare hills."""
    c.ground(photons, 25.0 * np.sin(c.x / 260.0) + 6.0 * np.sin(c.x / 70.0), 0.2)


def mountains(c: Country, photons: float) -> None:
    """Bare mountains."""
    c.ground(photons, 150.0 * np.sin(c.x / 400.0) + 8.0 * np.sin(c.x / 60.0), 0.3)


def trees(c: Country, photons: float) -> None:
    """Low hills, half of the photons from trees of 15 m."""
    hill = 12.0 * np.sin(c.x / 300.0)
    c.ground(0.5 * photons, hill, 0.2)
    c.trees(0.5 * photons, hill, 15.0)


def lake(c: Country, photons: float) -> None:
    """Water alone."""
    c.water(photons, 0.0, 0.1)


def shelf(c: Country, photons: float) -> None:
    """Water over a floor that sinks."""
    c.water(photons, 0.0, 0.1)
    c.floor(0.3 * photons, -3.0 - 17.0 * c.x / 4000.0 - 0.4 * np.sin(c.x / 60.0), 0.2)


KINDS: tuple[tuple[Callable[[Country, float], None], tuple[float, float]], ...] = (
    (plain, (-80.0, 100.0)), (hills, (-100.0, 150.0)), (mountains, (-250.0, 250.0)),
    (trees, (-80.0, 100.0)), (lake, (-50.0, 50.0)), (shelf, (-60.0, 40.0)),
)  # fmt: skip
"""Landscapes, and ends of their gates [m]."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.altimetry.sparse_beams", description=__doc__
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", action="store_true", help="a line for each track too")
    options = parser.parse_args(arguments)
    heads = "".join(f"{name:>14}" for name in THEIRS)
    print(f"{'balanced, F1':24}{'ours':>14}{heads}   told  said")
    behind = every = 0
    for kind, gate_m in KINDS:
        for photons in PHOTONS:
            rows = []
            for sky in SKIES_MHZ:
                country = Country(options.seed)
                kind(country, photons)
                # A photon of 1 MHz comes in 150 m of height, once a shot.
                country.sky(sky * 1e6 * 2.0 / SPEED_OF_LIGHT_M_S / SHOT_M, gate_m)
                track = country.labelled(kind.__name__)
                mine = ours(track)
                kept = [mine.kept, *(peer(other)(track).kept for other in THEIRS)]
                found = [measured(one, track.label)[:2] for one in kept]
                false = np.count_nonzero(mine.kept & (track.label == NOISE))
                unsure = mine.beam is not None and mine.beam.doubtful > 0
                rows.append([*np.ravel(found), mine.told / max(false, 1), unsure])
                if options.every:
                    line(f"{kind.__name__}, {photons}, {sky:g} MHz", rows[-1])
            values = np.array(rows)
            behind += np.count_nonzero(
                (values[:, 2:6].reshape(-1, 2, 2) > values[:, None, :2] + AHEAD).any(axis=(1, 2))
            )
            every += len(rows)
            total = [*values[:, :6].mean(axis=0), np.median(values[:, 6]), values[:, 7].sum()]
            line(f"{kind.__name__}, {photons}", total)
    print(f"{every} tracks, {behind} behind a published filter by more than {AHEAD}")


def line(name: str, values: Sequence[float]) -> None:
    """A line of the table."""
    numbers = "".join(f"{v:7.3f}" for v in values[:6])
    print(f"{name:24}{numbers}{values[6]:7.2f}{values[7]:6.0f}", flush=True)


if __name__ == "__main__":
    main()
