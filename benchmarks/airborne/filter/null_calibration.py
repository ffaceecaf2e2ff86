"""Calibration of alpha, the share of pure noise that is kept.

Run ``python -m benchmarks.airborne.filter.null_calibration``.

Options: ``--points N`` noise points per draw, ``--draws N``, ``--seeds N ...`` of the draws if not
0, 1, ..., ``--few N`` of them at all alphas, ``--densities X ...`` [1/m3], ``--only interior gate
swath overlap ridge`` some parts, ``--survey FOLDER``.

Prints kept share over alpha of the whole filter as shipped, with its links and the scan for
conductors, and the standard error over independent draws; all draws are made at the least alpha,
the first :data:`FEW` at the others. By density of the noise, with what the scan alone keeps at the
least alpha; along a gate whose ends cut voxels; at the upright edge of a flightline beyond which
is nothing; across that of a second one, where the density doubles. At edges the test is handed what
the chain makes of a perfect voxel model: the true amount in the sphere of each voxel, and from it
the density around the points (:mod:`~spl_batch.airborne.noise.local_noise`). Across a ridge as
turning
scans make them along the edges of swaths it is handed the true density at each point: what is off
alpha there is what the ellipsoid's size does.
``--survey`` adds the noise far from everything in a simulated survey that ``spl-batch run`` has
processed with ``outputs.diagnostics: true``, where the density is estimated: what is kept at its
alpha, and the shares of p <= alpha, without links.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.airborne.filter.methods import BACKGROUND, flightlines, is_noise, load_truth
from spl_batch.airborne.filter.ellipsoid.ellipsoid_test import judge
from spl_batch.airborne.filter.ellipsoid.null_distribution import repeated
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.wires import wire_null
from spl_batch.airborne.filter.wires.wire_scan import scan
from spl_batch.airborne.noise.beamlet_counts import SQUARES
from spl_batch.airborne.noise.local_noise import Listened, around, listened
from spl_batch.airborne.noise.voxel_noise import sphere_radius_m
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import NOISE_SIGNAL
from spl_batch.lattice.tables import VOXEL_FIXED_POINT

ALPHAS = (0.05, 0.01, 0.001)
DENSITIES = (0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
FEW = 4
"""Draws at the alphas beyond the least: their shares are better known [count]."""
VOXEL_M, CELLS = 10.0, 8
"""Edge of a voxel, and how many lie on either side of an edge."""
HEIGHT_M = 60.0
AROUND_M, ABOVE_M = 28.0, 20.0
"""Box of uniform noise, and as far as it is repeated around itself: beyond the reach of the test
and its links, and two tubes of the scan [m]."""
RIDGE, RISE_M = 3.0, 5.0
"""A ridge's height over what lies behind it [ratio], and from where noise begins to its top [m]."""
GATE_M = 60.0
GATE_BINS_M = (0.0, 2.0, 5.0, 10.0, 30.0)
OVERLAP_BINS_M = (-30.0, -10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0, 30.0)
BEAMLETS = 125
"""Of one flightline over a square of 2.5 m [count]."""
HIGH_M = 15.0
"""Noise this far above everything else is pure [m]; reaches of test and links add up."""

Floats = NDArray[np.float64]


class Kept(NamedTuple):
    """What the filter keeps of the points asked for: (n,) bool, by all of it and by the scan."""

    whole: NDArray[np.bool_]
    scan: NDArray[np.bool_]


class Draw(NamedTuple):
    """Noise, and the bin of each point that is asked for."""

    cloud: Cloud
    place: NDArray[np.int64]


def keeps(cloud: Cloud, settings: FilterSettings) -> Kept:
    """Decide as the chain does: by the test, its links and the scan, which share alpha."""
    alone = judge(cloud, settings, spent=lambda density: wire_null.spent(density, settings)).signal
    found = scan(cloud, wire_null.fitted(settings)).signal
    return Kept(alone | found, found)


def uniform(
    rng: np.random.Generator, density: float, size_m: Sequence[float], around_m: Sequence[float]
) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.bool_]]:
    """Uniform noise that repeats itself; see :func:`~.null_distribution.repeated`."""
    size, around = (np.rint(1000 * np.array(v)).astype(np.int64) for v in (size_m, around_m))
    return repeated(rng, density, size, np.minimum(size, around))


def measure(
    title: str,
    make: Callable[[int], Draw],
    seeds: Sequence[int],
    names: Sequence[str] = ("",),
    few: int = FEW,
) -> None:
    """Print share kept over alpha, a row for each bin, a column for each alpha and the scan."""
    label = f"{title}; kept / alpha"
    print(f"{label:40s}" + "".join(f"{f'alpha {a:g}':18s}" for a in ALPHAS) + "scan alone")
    with ThreadPoolExecutor(2) as pool:
        found = list(
            pool.map(lambda k: _shares(make(seeds[k]), k < few, len(names)), range(len(seeds)))
        )
    for row, name in enumerate(names):
        columns = [[f[row][k] for f in found if k < len(f[row])] for k in range(len(ALPHAS) + 1)]
        order = [*range(2, len(ALPHAS) + 1), 0, 1]  # the least alpha and the scan come first
        line(f"  {name}", [columns[k] for k in order], (*ALPHAS, ALPHAS[-1]))


def _shares(draw: Draw, more: bool, bins: int) -> list[list[float]]:  # noqa: FBT001
    """By bin: share kept at the least alpha, by the scan alone, and, if so, at other alphas."""
    least = keeps(draw.cloud, FilterSettings(alpha=ALPHAS[-1]))
    masks = [least.whole, least.scan]
    if more:
        masks += [keeps(draw.cloud, FilterSettings(alpha=alpha)).whole for alpha in ALPHAS[:-1]]
    share = np.array([np.bincount(draw.place[mask], minlength=bins) for mask in masks])
    number = np.bincount(draw.place, minlength=bins)
    return [[float(n) for n in share[:, k] / max(number[k], 1)] for k in range(bins)]


def line(label: str, shares: Sequence[Sequence[float]], alphas: Sequence[float] = ALPHAS) -> None:
    """Mean and standard error over draws, divided by alpha; one column for each alpha."""
    text = []
    for alpha, values in zip(alphas, shares, strict=True):
        value = np.array(values) / alpha
        error = value.std(ddof=1) / np.sqrt(len(value)) if len(value) > 1 else np.nan
        text.append(f"{value.mean():7.3f} +- {error:5.3f}  ")
    print(f"{label:40s}" + "".join(text), flush=True)


def interior(seed: int, density: float, points: int) -> Draw:
    """Uniform noise."""
    rng = np.random.default_rng([1, seed, round(1000 * density)])
    side = (points / density / HEIGHT_M) ** 0.5
    xyz, _, core = uniform(
        rng, density, (side, side, HEIGHT_M), (AROUND_M, AROUND_M, ABOVE_M)
    )  # fmt: skip
    return _draw(xyz, np.full(len(xyz), density), core, np.zeros(core.sum(), np.int64))


def along_gate(seed: int, density: float, points: int) -> Draw:
    """Noise between the ends of a gate that cut voxels anywhere, by distance from the nearer."""
    rng = np.random.default_rng([2, seed])
    side, start = (points / density / GATE_M) ** 0.5, rng.uniform(0, VOXEL_M)
    xyz, _, core = uniform(rng, density, (side, side, GATE_M), (AROUND_M, AROUND_M, 0.0))
    layers = (np.arange(-CELLS, CELLS) + 0.5) * VOXEL_M
    amount = density * (spheres_beyond(layers - start) - spheres_beyond(layers - start - GATE_M))
    height = xyz[:, 2] / 1000
    rho = heard([perfect(amount, 2)], height + start, axis=2)
    end = np.minimum(height, GATE_M - height)[core]
    return _draw(xyz, rho, core, np.digitize(end, GATE_BINS_M) - 1)


def across_overlap(seed: int, density: float, points: int) -> Draw:
    """Noise of twice the density where a second flightline begins, by distance from there."""
    return _across(seed, density, points, 2, OVERLAP_BINS_M)


def swath_edge(seed: int, density: float, points: int) -> Draw:
    """Noise of one flightline alone, by distance from its edge."""
    return _across(seed, density, points, 1, GATE_BINS_M)


def along_ridge(seed: int, density: float, points: int) -> Draw:
    """Noise that rises to three times its density along an edge, by distance from there."""
    rng, ends = np.random.default_rng([4, seed]), GATE_BINS_M[-1]
    side, wide = points / density / (ends * HEIGHT_M), ends + 2 * AROUND_M
    xyz, source, core = uniform(
        rng, RIDGE * density, (wide, side, HEIGHT_M), (0, AROUND_M, ABOVE_M)
    )  # fmt: skip
    across = xyz[:, 0] / 1000 - AROUND_M
    top = np.exp(-(((across - RISE_M) / RISE_M) ** 2))
    rate = density * np.clip(across / RISE_M, 0, 1) * (1 + (RIDGE - 1) * top)
    chance = rng.uniform(size=source.max() + 1)[source]
    there = chance * RIDGE * density < rate
    xyz, rate, across = xyz[there], rate[there], across[there]
    core = core[there] & (across < ends)
    return _draw(xyz, rate, core, np.digitize(across[core], GATE_BINS_M) - 1)


def _across(seed: int, density: float, points: int, lines: int, edges_m: tuple[float, ...]) -> Draw:
    rng = np.random.default_rng([3, lines, seed])
    ends, start = edges_m[-1], rng.uniform(0, VOXEL_M)
    side = points / density / ((2 * lines - 1) * ends * HEIGHT_M)
    wide = 2 * (ends + AROUND_M)
    xyz, source, core = uniform(
        rng, lines * density, (wide, side, HEIGHT_M), (0, AROUND_M, ABOVE_M)
    )  # fmt: skip
    across = xyz[:, 0] / 1000 - wide / 2
    first = rng.uniform(size=source.max() + 1) < (lines - 1) / 2  # else of the second flightline
    there = first[source] | (across > 0)
    xyz, core, across = xyz[there], core[there], across[there]
    core &= np.abs(across) < ends
    columns = (np.arange(-CELLS, CELLS) + 0.5) * VOXEL_M
    squares = np.arange(-CELLS * SQUARES, CELLS * SQUARES) * (VOXEL_M / SQUARES) - start
    share = np.clip(squares * (SQUARES / VOXEL_M) + 1.0, 0, 1)
    whole = perfect(np.full(2 * CELLS, density), 0)
    cut = perfect(density * spheres_beyond(columns - start), 0, share)
    rho = heard([cut, whole][:lines], across + start, axis=0)
    return _draw(xyz, rho, core, np.digitize(across[core], edges_m) - 1)


def spheres_beyond(centre_m: Floats) -> Floats:
    """Share of a voxel's sphere on the positive side of zero, by its centre's coordinate."""
    t = np.clip(centre_m / sphere_radius_m(VOXEL_M), -1, 1)
    share: Floats = (2 + 3 * t - t**3) / 4
    return share


def heard(lines: Sequence[Listened], place_m: Floats, axis: int) -> Floats:
    """Density that the chain makes at points of flightlines that change along an axis only.

    Parameters
    ----------
    lines : sequence of Listened
        From :func:`perfect`.
    place_m : (n,) float64
        Coordinate of the points, between -CELLS and CELLS voxels [m].
    axis : int
        0 or 2.
    """
    n, parts = len(place_m), SQUARES if axis == 0 else 1
    voxel, square = [np.full(n, 2) for _ in range(3)], [np.full(n, 2 * SQUARES) for _ in range(2)]
    voxel[axis] = np.floor(place_m / VOXEL_M).astype(np.int64) + CELLS
    if axis == 0:
        square[0] = np.floor(place_m * (SQUARES / VOXEL_M)).astype(np.int64) + CELLS * SQUARES
    offset = [np.zeros(n) for _ in range(3)]
    offset[axis] = place_m * (parts / VOXEL_M) % 1.0 - 0.5
    return around(lines, tuple(voxel), tuple(square), tuple(offset))


def perfect(amount: Floats, axis: int, share: Floats | None = None) -> Listened:
    """One flightline by a perfect voxel model.

    Parameters
    ----------
    amount : (2 * CELLS,) float64
        Mean density in the sphere of each voxel along the axis [1/m3].
    axis : int
        0 or 2.
    share : (8 * CELLS,) float64, optional
        Covered part of each square along the first axis; all of it where not given.
    """
    shape, along = [5, 5, 5], [1, 1, 1]
    shape[axis] = along[axis] = 2 * CELLS
    fixed = np.rint(amount * VOXEL_M**3 * VOXEL_FIXED_POINT).astype(np.int64).reshape(along)
    counts = np.full((*shape, SQUARES, SQUARES), BEAMLETS, dtype=np.uint32)
    if share is None:
        counts *= (fixed > 0)[..., None, None]
    else:
        counts[:] = np.rint(share * BEAMLETS).reshape(2 * CELLS, 1, 1, SQUARES, 1)
    found = listened(
        np.ascontiguousarray(np.broadcast_to(fixed, shape)),
        counts.reshape(*shape, SQUARES**2), VOXEL_M,
    )  # fmt: skip
    assert found is not None
    return found


def bins(edges_m: Sequence[float]) -> list[str]:
    """Names of bins of a distance."""
    return [f"{low:g} to {high:g} m" for low, high in pairwise(edges_m)]


def _draw(
    xyz: NDArray[np.int32], rho: Floats, core: NDArray[np.bool_], place: NDArray[np.int64]
) -> Draw:
    return Draw(Cloud(xyz, (0, 0, 0), rho, core, np.zeros(len(xyz), np.bool_)), place)


PARTS: Mapping[str, tuple[Callable[[int, float, int], Draw], tuple[float, ...]]] = {
    "interior": (interior, ()),
    "gate": (along_gate, GATE_BINS_M),
    "swath": (swath_edge, GATE_BINS_M),
    "overlap": (across_overlap, OVERLAP_BINS_M),
    "ridge": (along_ridge, GATE_BINS_M),
}
"""How to draw each part, and the bins of its distance [m]."""


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
    noise = is_noise(truth["kind"])
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
    parser.add_argument("--points", type=int, default=400_000)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--seeds", type=int, nargs="+")
    parser.add_argument("--few", type=int, default=FEW)
    parser.add_argument("--densities", type=float, nargs="+", default=DENSITIES)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--survey", type=Path)
    options = parser.parse_args()
    points, seeds = options.points, options.seeds or list(range(options.draws))
    for part in options.only:
        make, edges = PARTS[part]
        for density in options.densities:
            title = f"{part}, {density:g} per m3"
            names = bins(edges) if edges else ("",)
            measure(title, lambda k: make(k, density, points), seeds, names, options.few)  # noqa: B023
    if options.survey:
        high_gate(options.survey)


if __name__ == "__main__":
    main()
