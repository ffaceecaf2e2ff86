"""Calibration of p, the share of pure noise with as much evidence.

Run ``python -m benchmarks.airborne.filter.p_values``.

Options: ``--points N`` noise points per draw, ``--draws N``, ``--densities X ...`` [1/m3],
``--alpha``.

Uniform noise is judged by the whole filter as shipped, test, links and scan. Prints, by density,
the share of it whose p is at most x, over x, with the standard error over draws: 1 is exact, less
is on the safe side. The last column is the share that is kept, over alpha.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from benchmarks.airborne.filter.null_calibration import DENSITIES, interior
from spl_batch.airborne.filter.denoise import verdict_on
from spl_batch.airborne.settings import FilterSettings

LEVELS = (1e-4, 2e-4, 3e-4, 5e-4, 7e-4, 1e-3, 2e-3, 5e-3, 1e-2, 3e-2, 0.1, 0.2, 0.3, 0.5)
"""Values x of p."""


def shares(seed: int, density: float, points: int, alpha: float) -> list[float]:
    """Share of noise with p <= x, for each x, and the share that is kept."""
    settings = FilterSettings(alpha=alpha)
    verdict, _ = verdict_on(interior(seed, density, points).cloud, settings)
    return [*(float((verdict.p_value <= x).mean()) for x in LEVELS), float(verdict.signal.mean())]


def main(points: int, draws: int, densities: list[float], alpha: float) -> None:
    """Print the curves."""
    print(f"share of noise with p <= x, over x; alpha {alpha:g}, {draws} draws of {points} points")
    print(f"{'per m3':>7s}" + "".join(f"{x:>14g}" for x in LEVELS) + f"{'kept / alpha':>14s}")
    levels = np.array([*LEVELS, alpha])
    for density in densities:
        with ThreadPoolExecutor(2) as pool:
            drawn = list(pool.map(lambda k: shares(k, density, points, alpha), range(draws)))  # noqa: B023 - at once
        ratio = np.array(drawn) / levels
        error = ratio.std(axis=0, ddof=1) / np.sqrt(draws) if draws > 1 else np.full(len(levels), 0)
        found = zip(ratio.mean(axis=0), error, strict=True)
        print(f"{density:7g}" + "".join(f"{r:8.2f}+-{e:4.2f}" for r, e in found), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--densities", type=float, nargs="+", default=list(DENSITIES))
    parser.add_argument("--alpha", type=float, default=0.001)
    given = parser.parse_args()
    main(given.points, given.draws, given.densities, given.alpha)
