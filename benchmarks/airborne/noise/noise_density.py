"""Expected over true background, by stratum.

Run ``python -m benchmarks.airborne.noise.noise_density [SEED ...]``.

``--only STRATUM ...`` leaves the others out. Simulates small surveys with point truth, for each
seed anew, runs the chain up to the shuffle, and compares the expected noise of voxels with the
background returns that truth counts in them. A stratum is a set of voxels chosen by geometry alone
(flightlines, extent, where the gate ends), so voxels without a single point count as well. Beside
each ratio stands what the published correction for silent beamlets, gamma = 100 n_u / n
[W18 2.2.2], makes of it. The error is that of the number of true returns, all seeds together; the
ratios of single seeds stand last.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spl_batch import api
from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.store.voxel_parts import StoredVoxels

BAR = 0.03
"""Largest relative error that is asked for."""

RETURNS = 100_000
"""True noise returns that a stratum should pool [count]."""

PAD = 15
"""Voxels around those that truth covers: beams lean out of the scene."""

CROSSING = [{"heading_deg": 0, "offset_m": 300}, {"heading_deg": 90, "offset_m": -300}]
BASE: Mapping[str, Any] = {
    "extent_m": [240, 240],
    "terrain": {"relief_m": 10, "wavelength_m": 120},
    "reference": {"density_per_m2": 0.05},
    "flights": CROSSING,
    "sky": {"background_per_m3": 0.05},
    "acquisition": {"prf_hz": 10_000, "gate_m": 300},
}
SCENES: Mapping[str, Mapping[str, Any]] = {
    "edges": {
        "flights": [{"heading_deg": 0, "offset_m": 610}, {"heading_deg": 0, "offset_m": -630}],
        "buildings": {"count": 4},
        "trees": {"cover": 0.2},
        "sky": {"background_per_m3": 0.06},
        "acquisition": {"prf_hz": 15_000, "gate_m": 300},
    },
    "gate 85 m": {
        "buildings": {"count": 6},
        "trees": {"cover": 0.3},
        "sky": {"background_per_m3": 0.06},
        "acquisition": {"prf_hz": 15_000, "gate_m": 85},
    },
    "relief 500 m": {
        "terrain": {"relief_m": 500, "wavelength_m": 500},
        "trees": {"cover": 0.2},
        "sky": {"background_per_m3": 0.025},
        "acquisition": {"prf_hz": 10_000, "gate_m": 900},
    },
    "channels": {
        "acquisition": {
            "prf_hz": 10_000,
            "gate_m": 300,
            "dead_channels": [1, 2, 3, 11, 12, 13, 53],
            "weak_channels": {17: 0.1, 40: 0.1, 60: 0.3, 77: 0.3, 78: 0.3, 79: 0.3},
            "gain_spread": 0.15,
        }
    },
    "sky": {
        "flights": [CROSSING[0], {**CROSSING[1], "sky": 2.0}],
        "sky": {"background_per_m3": 0.05, "variation": 0.7, "period_s": 1.5},
    },
    "low": {
        "flights": [*CROSSING, {"heading_deg": 180, "offset_m": 320}],
        "sensor_overrides": {"pulse_energy_uj": 0.9, "dark_rate_hz": 2000.0},
        "sky": {"background_per_m3": 0.008},
        "acquisition": {"prf_hz": 60_000, "gate_m": 300},
    },
}
"""What differs from :data:`BASE`; "low" shows how many of its beamlets return."""


class Voxels(NamedTuple):
    """Lattice of one survey: expected and true noise, and where each voxel lies."""

    expected: NDArray[np.float64]
    true: NDArray[np.float64]
    core: NDArray[np.bool_]
    gate_end: NDArray[np.bool_]
    gate_middle: NDArray[np.bool_]
    swath_edge: NDArray[np.bool_]
    covers: NDArray[np.int64]


Region = Callable[[Voxels], NDArray[np.bool_]]
STRATA: tuple[tuple[str, str, tuple[str, ...], Region], ...] = (
    ("interior", "edges", (), lambda v: v.core & v.gate_middle & ~v.swath_edge),
    ("swath edge", "edges", (), lambda v: v.core & v.gate_middle & v.swath_edge),
    ("partial overlap", "edges", (), lambda v: v.core & v.gate_middle & (v.covers > 1)),
    ("gate end", "edges", (), lambda v: v.gate_end),
    ("edge of the delivery", "edges", (), lambda v: ~v.core & v.gate_middle),
    ("gate of 85 m", "gate 85 m", (), lambda v: v.core),
    ("relief of 500 m", "relief 500 m", (), lambda v: v.core & v.gate_middle),
    ("dead and weak channels", "channels", (), lambda v: v.core & v.gate_middle),
    ("changing sky", "sky", (), lambda v: v.core & v.gate_middle),
    ("low occupancy", "low", (), lambda v: v.gate_middle),
    ("no trajectory", "edges", ("survey.trajectory=null",), lambda v: v.gate_middle),
    ("no trajectory, swath edge", "edges", ("survey.trajectory=null",),
     lambda v: v.core & v.gate_middle & v.swath_edge),
    ("no trajectory, gate end", "edges", ("survey.trajectory=null",), lambda v: v.gate_end),
    ("no trajectory, low occupancy", "low", ("survey.trajectory=null",), lambda v: v.gate_middle),
    ("no channels", "edges", ("survey.channel_dimension=null",), lambda v: v.gate_middle),
    ("neither of them", "edges", ("survey.trajectory=null", "survey.channel_dimension=null"),
     lambda v: v.gate_middle),
    ("gate and pulse rate unknown", "edges", ("acquisition={}",), lambda v: v.gate_middle),
)  # fmt: skip
"""Name, scene, overrides of the workflow, and which voxels."""


class Sums(NamedTuple):
    """Of one stratum and seed: true and expected noise, and that of the published correction."""

    true: float
    expected: float
    published: float


def main(seeds: Sequence[int], names: Sequence[str]) -> None:
    """Print the table of some strata, all seeds pooled."""
    found: dict[str, list[Sums]] = {}
    for seed in seeds:
        with tempfile.TemporaryDirectory() as temporary:
            for name, sums in strata(seed, Path(temporary), names):
                found.setdefault(name, []).append(sums)
                ratio = sums.expected / sums.true
                print(f"seed {seed}, {name}: {ratio:.4f} of {sums.true:.0f}", flush=True)
    print(
        f"{'stratum':32s}{'noise returns':>14s}{'expected/true':>15s}{'+-':>8s}{'published':>11s}"
        "   by seed"
    )
    for name, by_seed in found.items():
        true, expected, other = (sum(column) for column in zip(*by_seed, strict=True))
        ratio = expected / true
        remark = "" if abs(ratio - 1) <= BAR else "  outside 3 %"
        remark += "" if true >= RETURNS else "  few returns"
        published = f"{other / true:11.2f}" if other else 11 * " "
        single = " ".join(f"{one.expected / one.true:.4f}" for one in by_seed)
        print(f"{name:32s}{true:14.0f}{ratio:15.4f}{true**-0.5:8.4f}{published}   {single}{remark}")


def strata(seed: int, scratch: Path, names: Sequence[str]) -> Iterator[tuple[str, Sums]]:
    """Strata of one seed, whose surveys are made in a folder."""
    known: dict[tuple[str, ...], Voxels] = {}
    for name, scene, overrides, region in STRATA:
        if name not in names:
            continue
        folder = simulated(scene, seed, scratch)
        expected = [0.0, 0.0]
        for k, more in enumerate(((), ("noise.correction=published",))[: 1 if overrides else 2]):
            key = (scene, *overrides, *more)
            if key not in known:
                known[key] = voxels(folder, (*overrides, *more))
            mask = region(known[key])
            true = float(known[key].true[mask].sum())
            expected[k] = float(known[key].expected[mask].sum())
        yield name, Sums(true, *expected)


def simulated(scene: str, seed: int, scratch: Path) -> Path:
    """Folder of a survey, simulated where it is not there yet."""
    folder = scratch / scene.replace(" ", "_")
    if not folder.exists():
        content = {"name": scene, "seed": seed, **BASE, **SCENES[scene]}
        simulate(parse_scene(content, scene), folder)
    return folder


def voxels(folder: Path, overrides: tuple[str, ...]) -> Voxels:
    """Run the chain up to the shuffle; expected and true noise of every voxel."""
    output = _output(overrides)
    settings = (*overrides, f"output={output}")
    api.run(folder / "workflow.yaml", workers=0, until="shuffle", overrides=settings)
    with np.load(folder / "truth" / "noise_density.npz") as stored:
        corner = tuple(int(c) - PAD for c in stored["corner"])
        truth = np.pad(stored["density"], PAD)
    workflow = load_workflow(folder / "workflow.yaml", settings)
    totals = {k: np.zeros(truth.shape, dtype=np.int64) for k in ("amount",)}
    if workflow.noise.correction == "published":
        totals |= {k: np.zeros(truth.shape, dtype=np.int64) for k in ("shots", "beamlets")}
    for part in sorted((folder / output / "store" / "voxels").glob("*/*.zarr")):
        StoredVoxels(part).add((corner[0], corner[1], corner[2]), totals)
    density = voxel_noise.density(
        totals["amount"],
        workflow.noise,
        shots=totals.get("shots"),
        beamlets=totals.get("beamlets"),
        beamlets_per_shot=100 if workflow.survey.channel_dimension else 1,
    )
    scene = json.loads((folder / "truth" / "scene.json").read_text(encoding="utf-8"))["scene"]
    centre = [
        (np.arange(n) + c + 0.5) * 10.0 - o
        for n, c, o in zip(truth.shape, corner, scene["origin_m"], strict=True)
    ]
    x, y, z = np.meshgrid(*centre, indexing="ij")
    core = np.minimum(
        np.minimum(x, scene["extent_m"][0] - x), np.minimum(y, scene["extent_m"][1] - y)
    )
    edge, covers = _swaths(x, y, z, scene)
    end, middle = _gate_ends(truth)
    return Voxels(
        density * 1000.0, _true_counts(folder, corner, truth.shape), core > 25.0, end, middle,
        edge, covers,
    )  # fmt: skip


def _output(overrides: tuple[str, ...]) -> str:
    return "_".join(["out", *(o.split("=")[0].split(".")[-1] for o in overrides)])


def _true_counts(
    folder: Path, corner: tuple[int, ...], shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Background returns of all flightlines in each voxel."""
    counts = np.zeros(shape)
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        background = pq.read_table(truth)["kind"].to_numpy() == 0
        las = laspy.read(folder / "flightlines" / f"{truth.stem}.laz")
        index = [
            np.floor(np.asarray(las[k])[background] / 10.0).astype(np.int64) - c
            for k, c in zip("xyz", corner, strict=True)
        ]
        inside = np.all([(i >= 0) & (i < n) for i, n in zip(index, shape, strict=True)], axis=0)
        np.add.at(counts, tuple(i[inside] for i in index), 1)
    return counts


def _swaths(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], scene: dict[str, Any]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Voxels within 20 m of a swath's edge, and the number of swaths over each."""
    cone = np.tan(np.radians(load_preset("spl100").half_cone_deg))
    edge, covers = np.zeros(x.shape, dtype=np.bool_), np.zeros(x.shape, dtype=np.int64)
    for flight in scene["flights"]:
        heading = np.radians(flight["heading_deg"])
        across = (x - scene["extent_m"][0] / 2) * np.cos(heading)
        across -= (y - scene["extent_m"][1] / 2) * np.sin(heading) + flight["offset_m"]
        half = (flight["altitude_agl_m"] - z) * cone
        edge |= np.abs(np.abs(across) - half) < 20.0
        covers += np.abs(across) < half
    return edge, covers


def _gate_ends(truth: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Voxels around the ends of each column's gate, and those well between them.

    An end is where the expected density falls to half of the column's usual one; the two
    layers on either side of it are the stratum.
    """
    end, middle = np.zeros(truth.shape, dtype=np.bool_), np.zeros(truth.shape, dtype=np.bool_)
    for i, j in np.ndindex(truth.shape[:2]):
        column = truth[i, j]
        if column.max() <= 0:
            continue
        usual = np.median(column[column > 0.3 * column.max()])
        inside = np.flatnonzero(column > 0.5 * usual)
        low, high = int(inside[0]), int(inside[-1])
        end[i, j, low - 2 : low + 2] = True
        end[i, j, high - 1 : high + 3] = True
        middle[i, j, low + 3 : high - 2] = True
    return end, middle


if __name__ == "__main__":
    known = [name for name, *_ in STRATA]
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--only", nargs="+", choices=known, default=known)
    given = parser.parse_args()
    main(given.seeds, given.only)
