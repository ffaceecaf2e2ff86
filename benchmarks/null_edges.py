"""Is pure noise kept evenly along edges? ``python -m benchmarks.null_edges [SEED ...]``.

Simulates two flightlines that overlap in part, runs the chain up to the shuffle, and decides about
the true background that is far from every true signal by the whole filter as shipped, its links
and the scan for conductors, by distance from the gate's ends, from the edge of what is covered,
and from the edge of the other flightline. Printed is the share kept over alpha with its standard
error, with the density that the test is given (:mod:`~spl_batch.runner.expected`), and for
comparison, without error, with the mean of the whole voxel [W18 Eq. 2]. Noise is kept in groups,
strong points and what is linked to them, so the error is that of cubes of 25 m: the root of the
sum of squares of what each keeps more or less than the mean.
"""

import itertools
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from benchmarks.methods import AFTERPULSE, BACKGROUND, is_noise, load_truth
from benchmarks.null_calibration import keeps
from spl_batch import api
from spl_batch.io.store import Store
from spl_batch.io.trajectory import read_trajectory
from spl_batch.runner.expected import expected_noise
from spl_batch.simulate import simulate
from spl_batch.simulate.scene import parse_scene
from spl_batch.stages.cloud import Cloud
from spl_batch.workflow import FilterSettings, load_workflow

ALPHAS = (0.05, 0.01, 0.001)
BINS_M = (0.0, 2.0, 5.0, 10.0, 50.0)
PURE_M = 15.0
"""Noise this far from every true signal is pure [m]; reaches of test and links add up."""
WINDOW_S = 0.004
"""The ends of a gate are the extreme ranges of the noise of so long [s]."""
CUBE_M = 25.0
"""Edge of the cubes whose differences tell the error [m]."""
CELL_M, LAYER_M = 2.0, 10.0
"""Lattice on which a flightline's own noise shows what it covers."""

SCENE: Mapping[str, Any] = {
    "name": "edges",
    "extent_m": [160, 140],
    "terrain": {"relief_m": 5, "wavelength_m": 120},
    "reference": {"density_per_m2": 0.05},
    "flights": [{"heading_deg": 0, "offset_m": 560}, {"heading_deg": 0, "offset_m": -590}],
    "sky": {"background_per_m3": 0.08},
    "acquisition": {"prf_hz": 60_000, "gate_m": 150},
}

Floats = NDArray[np.float64]


class Noise(NamedTuple):
    """Pure noise: kept at each alpha, by density used; distances [m]; number of the cube."""

    kept: dict[str, list[NDArray[np.bool_]]]
    distance: dict[str, Floats]
    cube: NDArray[np.int64]


def main(seeds: list[int]) -> None:
    """Print the table of all seeds pooled."""
    found = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            simulate(parse_scene({**SCENE, "seed": seed}, "edges"), folder)
            found.append(survey(folder))
    columns = "".join(f"{f'alpha {alpha:g}':>18s}" for alpha in ALPHAS)
    means = "".join(f"{f'mean, {alpha:g}':>14s}" for alpha in ALPHAS)
    print(f"{'kept / alpha':36s}{'noise':>9s}{columns}{means}")
    for name in found[0].distance:
        distance = np.concatenate([f.distance[name] for f in found])
        for low, high in _bins(name):
            mine = (distance >= low) & (distance < high)
            text = f"{name}, {low:g} to {high:g} m"
            if mine.any():
                print(f"{text:36s}{mine.sum():9d}{_row(found, mine)}")


def _bins(name: str) -> list[tuple[float, float]]:
    bins = list(itertools.pairwise(BINS_M))
    if name != "edge of the overlap":
        return bins
    return [(-high, -low) for low, high in reversed(bins)] + bins


def _row(found: list[Noise], mine: NDArray[np.bool_]) -> str:
    """Share kept over alpha, with its error; then with the voxels' means."""
    text = ""
    cube = np.concatenate([f.cube + n * 10**6 for n, f in enumerate(found)])[mine]
    for k, alpha in enumerate(ALPHAS):
        kept = np.concatenate([f.kept["local"][k] for f in found])[mine]
        number, size = np.bincount(cube), np.bincount(cube, weights=kept)
        error = np.sqrt(((size - kept.mean() * number) ** 2).sum()) / len(kept)
        text += f"{kept.mean() / alpha:10.2f} +-{error / alpha:5.2f}"
    for k, alpha in enumerate(ALPHAS):
        kept = np.concatenate([f.kept["voxel"][k] for f in found])
        text += f"{kept[mine].mean() / alpha:14.2f}"
    return text


def survey(folder: Path) -> Noise:
    """Test the pure noise of one simulated survey."""
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
    kept: dict[str, list[NDArray[np.bool_]]] = {"voxel": [], "local": []}
    for name, density in (("voxel", expected.mean), ("local", expected.local)):
        for alpha in ALPHAS:
            kept[name].append(_kept(mm, density, pure, order, alpha))
    distance = _distances(folder, truth, xyz, background)
    rows = np.flatnonzero(pure)
    cell = np.floor(xyz[rows] / CUBE_M).astype(np.int64)
    cube = np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
    return Noise(kept, {name: values[rows] for name, values in distance.items()}, cube)


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
    gate = np.minimum(reach - low[window], high[window] - reach)
    index = np.floor(xyz / (CELL_M, CELL_M, LAYER_M)).astype(np.int64)
    index -= index.min(axis=0) - (10, 10, 0)
    shape = tuple(index.max(axis=0) + np.array([11, 11, 1]))
    covered = {}
    for name in np.unique(truth["line"]):
        seen = np.zeros(shape, dtype=np.bool_)
        seen[tuple(index[background & (truth["line"] == name)].T)] = True
        covered[name] = ndimage.binary_closing(seen, np.ones((5, 5, 1)))
    union = np.any(list(covered.values()), axis=0)
    edge = _signed(union)[tuple(index.T)]
    overlap = np.full(len(xyz), np.nan)
    for name, mask in covered.items():
        mine = truth["line"] != name
        overlap[mine] = _signed(mask)[tuple(index[mine].T)]
    # near the edge of the survey the two cannot be told apart
    overlap[edge < BINS_M[-2]] = np.nan
    inner = np.where(edge < BINS_M[-2], np.nan, gate)
    return {
        "gate end": inner,
        "coverage edge": np.where(gate < BINS_M[-2], np.nan, edge),
        "edge of the overlap": np.where(gate < BINS_M[-2], np.nan, overlap),
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
    main([int(seed) for seed in sys.argv[1:]] or [1, 2])
