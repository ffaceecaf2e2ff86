"""Is alpha the share of pure noise that is kept? ``python -m benchmarks.null_calibration``.

Options: ``--points N`` noise points per draw, ``--draws N``, ``--only density`` for the first
part, ``--survey FOLDER``.

Prints kept share over alpha, with the standard error over independent draws: of the whole default
filter, with its links and the scan for conductors, by density of the noise, and what the scan
alone keeps at the least alpha; of the point-wise test with its links along a gate whose ends cut
voxels, and across the edge of a flightline, where the density doubles. There the density handed
to the test is that of a perfect voxel model: the true mean of each 10 m cube, and at the gate's
ends what the chain makes of it
(:func:`~spl_batch.stages.voxel_noise.within_gate`).
``--survey`` adds the noise far from everything in a simulated survey that ``spl-batch run`` has
processed with ``outputs.diagnostics: true``, where the density is estimated: what is kept at its
alpha, and the shares of p <= alpha, without links.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods import AFTERPULSE, BACKGROUND, flightlines, load_truth
from spl_batch.constants import NOISE_SIGNAL
from spl_batch.settings import FilterSettings
from spl_batch.stages import wire_null
from spl_batch.stages.cloud import Cloud
from spl_batch.stages.ellipsoid_test import judge, reach_m
from spl_batch.stages.null_distribution import repeated
from spl_batch.stages.voxel_noise import within_gate
from spl_batch.stages.wire_scan import scan

ALPHAS = (0.05, 0.01, 0.001)
DENSITIES = (0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
VOXEL_M = 10.0
HEIGHT_M = 60.0
AROUND_M, ABOVE_M = 28.0, 20.0
"""Box of uniform noise, and as far as it is repeated around itself: beyond the reach of the test
and its links, and two tubes of the scan [m]."""
HIGH_M = 15.0
"""Noise this far above everything else is pure [m]; reaches of test and links add up."""

Places = NDArray[np.float64]


def draw(rng: np.random.Generator, density: float, low: Places, high: Places) -> Places:
    """Uniform points of a box [m], sorted: (n, 3)."""
    n = rng.poisson(density * np.prod(high - low))
    points = rng.uniform(low, high, (n, 3))
    return points[np.lexsort(points.T[::-1])]


def decide(
    points: Places, density: Places, asked: NDArray[np.bool_], settings: FilterSettings
) -> NDArray[np.bool_]:
    """Kept or not, of the points asked for."""
    quanta = np.rint(points * 1000).astype(np.int64)
    anchor = quanta.min(axis=0)
    nothing = np.zeros(len(points), dtype=np.bool_)
    place = (int(anchor[0]), int(anchor[1]), int(anchor[2]))
    cloud = Cloud((quanta - anchor).astype(np.int32), place, density, asked, nothing)
    return judge(cloud, settings).signal


def line(label: str, shares: Sequence[Sequence[float]], alphas: Sequence[float] = ALPHAS) -> None:
    """Mean and standard error over draws, divided by alpha; one column for each alpha."""
    text = []
    for alpha, values in zip(alphas, shares, strict=True):
        value = np.array(values) / alpha
        error = value.std(ddof=1) / np.sqrt(len(value)) if len(value) > 1 else np.nan
        text.append(f"{value.mean():7.3f} +- {error:5.3f}")
    print(f"{label:28s}" + "".join(text), flush=True)


def by_density(points: int, draws: int) -> None:
    """Whole default filter in the interior of uniform noise."""
    columns = "".join(f"{alpha:<18g}" for alpha in ALPHAS)
    print(f"kept / alpha in uniform noise    {columns}scan alone")
    for density in DENSITIES:
        with ThreadPoolExecutor(2) as pool:
            shares = list(pool.map(lambda k: whole(k, density, points), range(draws)))  # noqa: B023
        line(f"{density:g} per m3", list(zip(*shares, strict=True)), (*ALPHAS, ALPHAS[-1]))


def whole(seed: int, density: float, points: int) -> list[float]:
    """Share of one draw of noise that is kept, by alpha, and by the scan alone."""
    rng = np.random.default_rng([1, seed, round(1000 * density)])
    side = (points / density / HEIGHT_M) ** 0.5
    size, margin = (side, side, HEIGHT_M), (min(AROUND_M, side), min(AROUND_M, side), ABOVE_M)
    xyz, _, core = repeated(rng, density, *(np.rint(1000 * np.array(v)).astype(int)
                                            for v in (size, margin)))  # fmt: skip
    rho, nothing = np.full(len(xyz), density), np.zeros(len(xyz), dtype=np.bool_)
    cloud = Cloud(xyz, (0, 0, 0), rho, core, nothing)
    shares = []
    for alpha in ALPHAS:
        settings = FilterSettings(alpha=alpha)
        alone = judge(cloud, settings, spent=wire_null.spent(rho, settings)).signal
        found = scan(cloud, wire_null.fitted(settings)).signal
        shares.append(float((alone | found).mean()))
    return [*shares, float(found.mean())]


def cubed(points: Places, values: Places, *, gate: bool, cells: int = 40) -> Places:
    """Mean of a step function along the last axis over the cubes: density at each point.

    Parameters
    ----------
    points : (n,) float64
        Coordinate across the edges [m].
    values : (2, k) float64
        Where a step starts [m], and its value from there on [1/m3].
    gate : bool
        Whether the axis is the vertical one.
    cells : int
        Cubes on either side of zero.
    """
    fine = (np.arange(-cells * 100, cells * 100) + 0.5) * (VOXEL_M / 100)
    step = values[1][np.maximum(np.searchsorted(values[0], fine, side="right") - 1, 0)]
    mean = step.reshape(-1, 100).mean(axis=1)
    if gate:
        mean = within_gate(mean[None, None])[0, 0]
    found: Places = mean[np.floor(points / VOXEL_M).astype(int) + cells]
    return found


def along_gate(points: int, draws: int, density: float) -> None:
    """Noise between the ends of a gate that cut cubes anywhere."""
    length, names = 90.0, ("0-2 m", "2-5 m", "5-10 m", "10-45 m")
    edges = (0.0, 2.0, 5.0, 10.0, 45.0)
    print(f"\nalong a gate, {density:g} per m3, by distance from its nearer end")
    tally: list[list[list[float]]] = [[[] for _ in ALPHAS] for _ in names]
    for k in range(draws):
        rng = np.random.default_rng([2, k])
        margin, start = reach_m(FilterSettings()), rng.uniform(0, VOXEL_M)
        side = np.sqrt(points / density / length)
        low = np.array([-margin, -margin, start])
        cloud = draw(rng, density, low, np.array([side + margin, side + margin, start + length]))
        steps = np.array([[-1e9, start, start + length], [0.0, density, 0.0]])
        rho = cubed(cloud[:, 2], steps, gate=True)
        asked = np.all((cloud[:, :2] >= 0) & (cloud[:, :2] < side), axis=1)
        end = np.minimum(cloud[asked, 2] - start, start + length - cloud[asked, 2])
        _by_bins(cloud, rho, asked, np.digitize(end, edges) - 1, tally)
    for name, shares in zip(names, tally, strict=True):
        line(name, shares)


def across_overlap(points: int, draws: int, density: float) -> None:
    """Noise of twice the density from a plane on."""
    names = ("single, 10-30 m", "single, 3-10 m", "single, 0-3 m", "overlap, 0-3 m",
             "overlap, 3-10 m", "overlap, 10-30 m")  # fmt: skip
    edges = (-30.0, -10.0, -3.0, 0.0, 3.0, 10.0, 30.0)
    print(f"\nacross an overlap's edge, {density:g} and {2 * density:g} per m3")
    tally: list[list[list[float]]] = [[[] for _ in ALPHAS] for _ in names]
    for k in range(draws):
        rng = np.random.default_rng([3, k])
        margin, start = reach_m(FilterSettings()), rng.uniform(0, VOXEL_M)
        side = np.sqrt(points / density / 90.0)
        low = np.array([-margin, -margin, start - 30.0 - margin])
        high = np.array([side + margin, side + margin, start])
        cloud = draw(rng, density, low, high)
        low[2], high[2] = start, start + 30.0 + margin
        cloud = np.concatenate([cloud, draw(rng, 2 * density, low, high)])
        cloud = cloud[np.lexsort(cloud.T[::-1])]
        rho = cubed(cloud[:, 2], np.array([[-1e9, start], [density, 2 * density]]), gate=False)
        asked = np.all((cloud[:, :2] >= 0) & (cloud[:, :2] < side), axis=1)
        asked &= np.abs(cloud[:, 2] - start) < 30.0
        place = np.digitize(cloud[asked, 2] - start, edges) - 1
        _by_bins(cloud, rho, asked, place, tally)
    for name, shares in zip(names, tally, strict=True):
        line(name, shares)


def _by_bins(
    cloud: Places,
    rho: Places,
    asked: NDArray[np.bool_],
    place: NDArray[np.int64],
    tally: list[list[list[float]]],
) -> None:
    for column, alpha in enumerate(ALPHAS):
        kept = decide(cloud, rho, asked, FilterSettings(alpha=alpha))
        for row, cell in enumerate(tally):
            cell[column].append(float(kept[place == row].mean()))


def high_gate(folder: Path) -> None:
    """Noise high above everything in a processed survey: kept, and share with p <= alpha."""
    import laspy  # noqa: PLC0415 - only this part reads files

    truth = load_truth(folder)
    name = folder / "out" / "laz" / "flightlines"
    files = [laspy.read(name / f"{path.stem}.laz") for path in flightlines(folder)]
    p_value, label = (
        np.concatenate([np.asarray(las[key]) for las in files])
        for key in ("p_value", "noise_class")
    )
    noise = np.isin(truth["kind"], (BACKGROUND, AFTERPULSE))
    cell = [np.floor(truth[a] / VOXEL_M).astype(int) for a in "xy"]
    cell = [c - c.min() + 2 for c in cell]
    top = np.full([c.max() + 3 for c in cell], -np.inf)
    np.maximum.at(top, (cell[0][~noise], cell[1][~noise]), truth["z"][~noise])
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(top, 2, constant_values=-np.inf), (5, 5)
    )
    highest = around.max(axis=(2, 3))[cell[0], cell[1]]
    above = truth["z"] - highest
    default = FilterSettings().alpha
    print("\nsimulated survey, by height above everything within 20 m: p <= alpha / alpha,")
    print(f"and kept / alpha of the whole filter at alpha {default:g}")
    for low, high in ((HIGH_M, 30), (30, 60), (60, 90), (90, 400)):
        mine = (truth["kind"] == BACKGROUND) & (above >= low) & (above < high) & ~np.isnan(p_value)
        shares = [[float((p_value[mine] <= alpha).mean())] for alpha in ALPHAS]
        if mine.any():
            shares.append([float((label[mine] == NOISE_SIGNAL).mean())])
            line(f"{low:g}-{high:g} m, n = {mine.sum()}", shares, (*ALPHAS, default))


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--only", choices=("density",))
    parser.add_argument("--survey", type=Path)
    options = parser.parse_args()
    by_density(options.points, options.draws)
    if options.only is None:
        along_gate(options.points, options.draws, 0.1)
        across_overlap(options.points, options.draws, 0.1)
    if options.survey:
        high_gate(options.survey)


if __name__ == "__main__":
    main()
