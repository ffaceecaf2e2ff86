"""Pure noise that is kept along gates and edges.

Run ``python -m benchmarks.airborne.filter.null_edges [SEED ...]``.

Options: ``--scenes parallel crossing``, both of them without it; ``--true``. Simulates two
flightlines that overlap in part, or that cross in a short gate under a changing sky; runs the chain
up to the shuffle, and decides about the true background that is far from every true signal by the
whole filter as shipped, its links and the scan for conductors: by layer along the gate, from its
upper end and from its lower one; by the number of flightlines over it, away from edges; by distance
from the edge of what is covered, and from the edge of the other flightline. Printed is the share
kept over alpha with its standard error, with the density that the test is given
(:mod:`~spl_batch.airborne.filter.expected_noise`), and for comparison, without error, with the mean
of the whole
voxel [W18 Eq. 2]. With ``--true`` there stands what would be kept with the true density at each
point, from the simulated beamlets (:mod:`benchmarks.airborne.noise.true_density`), in place of the
voxels' mean,
and before it the density used over the true one. Noise is kept in groups, strong points and what is
linked to them, so the error is that of cubes of 25 m: the root of the sum of squares of what each
keeps more or less than the mean.
"""

import argparse
import itertools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.airborne.beams.trajectories import read_trajectory
from benchmarks.airborne.filter.methods import AFTERPULSE, BACKGROUND, is_noise, load_truth
from benchmarks.airborne.filter.null_calibration import keeps
from benchmarks.airborne.noise.true_density import true_density
from spl_batch import api
from spl_batch.airborne.filter.expected_noise import expected_noise
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.settings import FilterSettings
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.engine.store.working_store import Store

ALPHAS = (0.05, 0.01, 0.001)
BINS_M = (0.0, 2.0, 5.0, 10.0, 50.0)
LAYERS_M = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 80.0)
AWAY_M = BINS_M[-2]
"""No edge is nearer than this to what is counted along another one [m]."""
PURE_M = 15.0
"""Noise this far from every true signal is pure [m]; reaches of test and links add up."""
WINDOW_S = 0.004
"""The ends of a gate are the extreme ranges of the noise of so long [s]."""
CUBE_M = 25.0
"""Edge of the cubes whose differences tell the error [m]."""
CELL_M, LAYER_M = 2.0, 10.0
"""Lattice on which a flightline's own noise shows what it covers."""

BASE: Mapping[str, Any] = {
    "terrain": {"relief_m": 5, "wavelength_m": 120},
    "reference": {"density_per_m2": 0.05},
}
SCENES: Mapping[str, Mapping[str, Any]] = {
    "parallel": {
        "extent_m": [160, 140],
        "flights": [{"heading_deg": 0, "offset_m": 560}, {"heading_deg": 0, "offset_m": -590}],
        "sky": {"background_per_m3": 0.08},
        "acquisition": {"prf_hz": 60_000, "gate_m": 150},
    },
    "crossing": {
        "extent_m": [120, 120],
        "flights": [{"heading_deg": 20, "offset_m": 250}, {"heading_deg": 110, "offset_m": -250}],
        "sky": {"background_per_m3": 0.1, "variation": 0.3},
        "acquisition": {
            "prf_hz": 60_000,
            "gate_m": 100,
            "dead_channels": [12, 77],
            "weak_channels": {5: 0.2},
        },
    },
}

Floats = NDArray[np.float64]


class Noise(NamedTuple):
    """Pure noise: kept at each alpha, by density used; that; distances [m]; cube's number."""

    kept: dict[str, list[NDArray[np.bool_]]]
    density: dict[str, Floats]
    distance: dict[str, Floats]
    cube: NDArray[np.int64]


def main() -> None:
    """Print a table for each scene, all its seeds pooled."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--true", action="store_true", help="beside the true density's share")
    options = parser.parse_args()
    for name in options.scenes:
        found = []
        for seed in options.seeds:
            with tempfile.TemporaryDirectory() as temporary:
                folder = Path(temporary)
                content = {**BASE, **SCENES[name], "name": name, "seed": seed}
                scene = parse_scene(content, name)
                simulate(scene, folder)
                found.append(survey(folder, scene if options.true else None))
        _print(f"{name}, kept / alpha", found)


def _print(title: str, found: list[Noise]) -> None:
    columns = "".join(f"{f'alpha {alpha:g}':>18s}" for alpha in ALPHAS)
    if "true" in found[0].kept:
        beside = f"{'density / true':>16s}" + columns.replace("alpha", " true")
    else:
        beside = "".join(f"{f'mean, {alpha:g}':>14s}" for alpha in ALPHAS)
    print(f"{title:36s}{'noise':>9s}{columns}{beside}")
    for name in found[0].distance:
        distance = np.concatenate([f.distance[name] for f in found])
        for text, low, high in _bins(name):
            mine = (distance >= low) & (distance < high)
            if mine.any():
                print(f"{text:36s}{mine.sum():9d}{_row(found, mine)}", flush=True)


def _bins(name: str) -> list[tuple[str, float, float]]:
    """Label and limits of each row."""
    if name == "flightlines":
        return [(f"{n} {name}", n, n + 1) for n in (1, 2)]
    edges = LAYERS_M if "gate end" in name else BINS_M
    bins = list(itertools.pairwise(edges))
    if name == "edge of the overlap":
        bins = [(-high, -low) for low, high in reversed(bins)] + bins
    return [(f"{name}, {low:g} to {high:g} m", low, high) for low, high in bins]


def _row(found: list[Noise], mine: NDArray[np.bool_]) -> str:
    """Share kept over alpha, with its error; then with the voxels' means or the true density."""
    cube = np.concatenate([f.cube + n * 10**6 for n, f in enumerate(found)])[mine]
    text = _shares(found, "local", mine, cube)
    if "true" in found[0].kept:
        used, true = (
            np.concatenate([f.density[name] for f in found])[mine].mean()
            for name in ("local", "true")
        )
        return f"{text}{used / true:16.3f}{_shares(found, 'true', mine, cube)}"
    for k, alpha in enumerate(ALPHAS):
        kept = np.concatenate([f.kept["voxel"][k] for f in found])
        text += f"{kept[mine].mean() / alpha:14.2f}"
    return text


def _shares(found: list[Noise], name: str, mine: NDArray[np.bool_], cube: NDArray[np.int64]) -> str:
    """Share kept over alpha with a density, and its error."""
    text = ""
    for k, alpha in enumerate(ALPHAS):
        kept = np.concatenate([f.kept[name][k] for f in found])[mine]
        number, size = np.bincount(cube), np.bincount(cube, weights=kept)
        error = np.sqrt(((size - kept.mean() * number) ** 2).sum()) / len(kept)
        text += f"{kept.mean() / alpha:10.2f} +-{error / alpha:5.2f}"
    return text


def survey(folder: Path, scene: Scene | None) -> Noise:
    """Test the pure noise of one simulated survey; of a scene beside the true density."""
    workflow = folder / "workflow.yaml"
    api.run(workflow, workers=0, until="shuffle")
    truth = load_truth(folder)
    settings = load_workflow(workflow)
    store = Store(folder / settings.output)
    mm = [np.rint(truth[axis] * 1000).astype(np.int64) for axis in "xyz"]
    parts = [
        f"{path.parent.name}/{path.stem}" for path in store.path("voxels", "").glob("*/*.zarr")
    ]
    expected = expected_noise(mm, np.ones(len(mm[0]), np.bool_), parts, 100, store, settings.noise)
    xyz = np.stack([truth[axis] for axis in "xyz"], axis=1)
    background = truth["kind"] == BACKGROUND
    signal = ~is_noise(truth["kind"])
    afar = cKDTree(xyz[signal]).query(xyz, distance_upper_bound=PURE_M)[0] > PURE_M
    pure = background & afar
    order = np.lexsort((mm[2], mm[1], mm[0]))
    # afterpulses, of noise as well, are another stage's: they would be company
    order = order[truth["kind"][order] != AFTERPULSE]
    density = {"local": expected.local}
    density |= {"voxel": expected.mean} if scene is None else {"true": true_density(scene, xyz)}
    kept = {
        name: [_kept(mm, values, pure, order, alpha) for alpha in ALPHAS]
        for name, values in density.items()
    }
    distance = _distances(folder, truth, xyz, background)
    rows = np.flatnonzero(pure)
    cell = np.floor(xyz[rows] / CUBE_M).astype(np.int64)
    cube = np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
    return Noise(
        kept,
        {name: values[rows] for name, values in density.items()},
        {name: values[rows] for name, values in distance.items()},
        cube,
    )


def _kept(
    mm: list[NDArray[np.int64]],
    density: Floats,
    pure: NDArray[np.bool_],
    order: NDArray[np.int64],
    alpha: float,
) -> NDArray[np.bool_]:
    """Of the pure noise, in the order of the files: what the filter keeps."""
    points = np.stack(mm, axis=1)[order]
    low = points.min(axis=0)
    cloud = Cloud(
        (points - low).astype(np.int32), (int(low[0]), int(low[1]), int(low[2])),
        density[order], pure[order], np.zeros(len(points), dtype=np.bool_),
    )  # fmt: skip
    out = np.zeros(len(pure), dtype=np.bool_)
    out[order[pure[order]]] = keeps(cloud, FilterSettings(alpha=alpha)).whole
    return out[pure]


def _distances(
    folder: Path, truth: Mapping[str, NDArray[Any]], xyz: Floats, background: NDArray[np.bool_]
) -> dict[str, Floats]:
    """Distance of every return from the edges [m]; from an overlap's, < 0 outside of it."""
    trajectory = read_trajectory(
        [folder / "trajectory.csv"], survey_crs=None, trajectory_crs=None
    ).trajectory
    time = np.asarray(truth["gps_time"], np.float64)
    at = [np.interp(time, trajectory.time_s, trajectory.xyz_m[:, k]) for k in range(3)]
    reach = np.linalg.norm(xyz - np.stack(at, axis=1), axis=1)
    window = np.floor((time - time.min()) / WINDOW_S).astype(np.int64)
    low = np.full(window.max() + 1, np.inf)
    high = np.full(window.max() + 1, -np.inf)
    np.minimum.at(low, window[background], reach[background])
    np.maximum.at(high, window[background], reach[background])
    upper, lower = reach - low[window], high[window] - reach
    gate = np.minimum(upper, lower)
    index = np.floor(xyz / (CELL_M, CELL_M, LAYER_M)).astype(np.int64)
    index -= index.min(axis=0) - (10, 10, 0)
    shape = tuple(index.max(axis=0) + np.array([11, 11, 1]))
    covered = {}
    for name in np.unique(truth["line"]):
        seen = np.zeros(shape, dtype=np.bool_)
        seen[tuple(index[background & (truth["line"] == name)].T)] = True
        covered[name] = ndimage.binary_closing(seen, np.ones((5, 5, 1), np.bool_))
    union = np.any(list(covered.values()), axis=0)
    edge = _signed(union)[tuple(index.T)]
    overlap = np.full(len(xyz), np.nan)
    for name, mask in covered.items():
        mine = truth["line"] != name
        overlap[mine] = _signed(mask)[tuple(index[mine].T)]
    covers = np.sum([mask[tuple(index.T)] for mask in covered.values()], axis=0, dtype=np.float64)
    beside = np.nan_to_num(np.abs(overlap), nan=np.inf)
    # near the edge of the survey the two cannot be told apart
    overlap[edge < AWAY_M] = np.nan
    inside, between = edge >= AWAY_M, gate >= AWAY_M
    return {
        "upper gate end": np.where(inside & (upper <= lower), upper, np.nan),
        "lower gate end": np.where(inside & (lower < upper), lower, np.nan),
        "flightlines": np.where(inside & between & (beside >= AWAY_M), covers, np.nan),
        "coverage edge": np.where(between, edge, np.nan),
        "edge of the overlap": np.where(between, overlap, np.nan),
    }


def _signed(mask: NDArray[np.bool_]) -> Floats:
    """Distance from the edge of a mask within each layer [m], > 0 inside."""
    out = np.empty(mask.shape)
    for k in range(mask.shape[2]):
        inside = ndimage.distance_transform_edt(mask[:, :, k])
        outside = ndimage.distance_transform_edt(~mask[:, :, k])
        out[:, :, k] = (np.maximum(inside - 0.5, 0) - np.maximum(outside - 0.5, 0)) * CELL_M
    return out


if __name__ == "__main__":
    main()
