"""Expected over true noise in strata, and what the filter keeps of pure noise.

A stratum is a set of voxels that geometry alone chooses (flightlines, extent, where the gate ends),
so voxels without a single point count as well.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.held.figures import Figure, Worse, figure
from benchmarks.held.surveys import Given, simulated
from benchmarks.held.truth import NOISE, Grid, Mask, share
from spl_batch import api, filter_points
from spl_batch.airborne.filter.ellipsoid.null_distribution import repeated
from spl_batch.airborne.noise import voxel_noise
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.simulate.scene.ray_trace import KINDS
from spl_batch.airborne.store.voxel_parts import read_voxels

VOXEL_M: Final = 10.0

PAD: Final = 15
"""Voxels around those that truth covers: beams lean out of the scene [count]."""

CROSSING: Final[list[dict[str, Any]]] = [
    {"heading_deg": 0, "offset_m": 300}, {"heading_deg": 90, "offset_m": -300},
]  # fmt: skip
BASE: Final[Mapping[str, Any]] = {
    "seed": 1,
    "extent_m": [240, 240],
    "terrain": {"relief_m": 10, "wavelength_m": 120},
    "reference": {"density_per_m2": 0.05},
    "flights": CROSSING,
    "sky": {"background_per_m3": 0.05},
    "acquisition": {"prf_hz": 10_000, "gate_m": 300},
}


def _uneven(zenith_deg: float = 45, **parts: Any) -> Mapping[str, Any]:
    """A scene whose background follows what each beamlet looks at."""
    sky = {"background_per_m3": 0.1, "by_albedo": True, "zenith_deg": zenith_deg}
    return {"sky": sky, "acquisition": {"prf_hz": 10_000, "gate_m": 150}, **parts}


SHADOWS: Final[Mapping[str, Any]] = _uneven(
    buildings={"count": 8, "eave_m": [10, 25]}, trees={"cover": 0.2}, zenith_deg=65
)
SCENES: Final[Mapping[str, Mapping[str, Any]]] = {
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
    "classes": _uneven(
        buildings={
            "list": [
                {
                    "centre_m": [40 + 80 * (k % 3), 40 + 80 * (k // 3)],
                    "size_m": [36, 28],
                    "reflectance": (0.8, 0.06)[k % 2],
                }
                for k in range(9)
            ]
        },
        trees={"cover": 0.2},
    ),
    "parcels": _uneven(terrain={"relief_m": 10, "wavelength_m": 120, "parcel_m": 40}),
    "fields": _uneven(terrain={"reflectance_variation": 0.6, "reflectance_m": 100}),
    "shoreline": _uneven(
        water=[{"ring_m": [[-60, -60], [110, -60], [130, 120], [100, 300], [-60, 300]]}]
    ),
    "shadows": SHADOWS,
    "shadows, even rate": {**SHADOWS, "sky": {"background_per_m3": 0.1}},
    "slopes": _uneven(terrain={"relief_m": 60, "wavelength_m": 120}, zenith_deg=70),
    "low": {
        "flights": [*CROSSING, {"heading_deg": 180, "offset_m": 320}],
        "sensor_overrides": {"pulse_energy_uj": 0.9, "dark_rate_hz": 2000.0},
        "sky": {"background_per_m3": 0.008},
        "acquisition": {"prf_hz": 60_000, "gate_m": 300},
    },
}
"""What differs from :data:`BASE`; 2.6 % of the beamlets of "low" return."""


class Voxels(NamedTuple):
    """Lattice of one survey: expected and true noise, and where each voxel lies."""

    expected: Grid
    true: Grid
    core: Mask
    gate_end: Mask
    gate_middle: Mask
    swath_edge: Mask
    bright: Mask
    dark: Mask
    covers: NDArray[np.int64]


BRIGHTER: Final = 1.2
"""Bright and dark are voxels whose noise differs from the usual by this factor."""

Region = Callable[[Voxels], Mask]
BLIND, ALIKE = "survey.trajectory=null", "survey.channel_dimension=null"
STRATA: Final[tuple[tuple[str, str, tuple[str, ...], Region], ...]] = (
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
    ("no trajectory", "edges", (BLIND,), lambda v: v.gate_middle),
    ("no trajectory, swath edge", "edges", (BLIND,),
     lambda v: v.core & v.gate_middle & v.swath_edge),
    ("no trajectory, gate end", "edges", (BLIND,), lambda v: v.gate_end),
    ("no trajectory, low occupancy", "low", (BLIND,), lambda v: v.gate_middle),
    ("no channels", "edges", (ALIKE,), lambda v: v.gate_middle),
    ("neither of them", "edges", (BLIND, ALIKE), lambda v: v.gate_middle),
    ("gate and pulse rate unknown", "edges", ("acquisition={}",), lambda v: v.gate_middle),
    *(
        row for name in ("classes", "parcels", "fields", "shoreline", "shadows", "slopes")
        for row in ((f"{name}, bright", name, (), lambda v: v.bright),
                    (f"{name}, dark", name, (), lambda v: v.dark))
    ),
)  # fmt: skip
"""Name, scene, overrides of the workflow, and which voxels."""


def strata(given: Given) -> Iterator[Figure]:
    """Expected over true noise, in strata."""
    known: dict[tuple[str, ...], Voxels] = {}
    for name, scene, overrides, region in STRATA:
        content = {"name": scene, **BASE, **SCENES[scene]}
        folder = simulated(content, given.scratch / "noise" / scene.replace(" ", "_"))
        if (scene, *overrides) not in known:
            known[scene, *overrides] = voxels(folder, overrides)
        lattice = known[scene, *overrides]
        mask = region(lattice)
        ratio = float(lattice.expected[mask].sum() / lattice.true[mask].sum())
        yield figure(f"expected / true noise, {name}", ratio, tolerance=0.01)


def voxels(folder: Path, overrides: tuple[str, ...]) -> Voxels:
    """Run the chain up to the shuffle; expected and true noise of every voxel."""
    output = "_".join(["out", *(o.split("=")[0].split(".")[-1] for o in overrides)])
    settings = (*overrides, f"output={output}")
    api.run(folder / "workflow.yaml", workers=0, until="shuffle", overrides=settings)
    corner, truth, scene, (x, y, z) = _lattice(folder)
    totals = {"amount": np.zeros(truth.shape, dtype=np.int64)}
    for part in sorted((folder / output / "store" / "voxels").glob("*/*.npz")):
        read_voxels(part).add((corner[0], corner[1], corner[2]), totals)
    noise = load_workflow(folder / "workflow.yaml", settings).noise
    density = voxel_noise.density(totals["amount"], noise)
    core = _core(x, y, scene)
    edge, covers = _swaths(x, y, z, scene)
    end, middle = _gate_ends(truth)
    true = _true_counts(folder, corner, truth.shape)
    inner = core & middle
    usual = float(np.median(truth[inner])) if inner.any() else 0.0
    bright, dark = inner & (truth > BRIGHTER * usual), inner & (truth < usual / BRIGHTER)
    return Voxels(density * VOXEL_M**3, true, core, end, middle, edge, bright, dark, covers)


def _lattice(folder: Path) -> tuple[tuple[int, ...], Grid, dict[str, Any], tuple[Grid, ...]]:
    """First voxel, true noise of all, the scene, and centres of voxels from its corner [m]."""
    with np.load(folder / "truth" / "noise_density.npz") as stored:
        corner = tuple(int(c) - PAD for c in stored["corner"])
        truth = np.pad(stored["density"], PAD)
    scene = json.loads((folder / "truth" / "scene.json").read_text(encoding="utf-8"))["scene"]
    centre = [
        (np.arange(n) + c + 0.5) * VOXEL_M - o
        for n, c, o in zip(truth.shape, corner, scene["origin_m"], strict=True)
    ]
    return corner, truth, scene, tuple(np.meshgrid(*centre, indexing="ij"))


def _core(x: Grid, y: Grid, scene: Mapping[str, Any]) -> Mask:
    """Voxels more than 25 m within the scene."""
    east, north = scene["extent_m"]
    core: Mask = np.minimum(np.minimum(x, east - x), np.minimum(y, north - y)) > 25.0
    return core


def _true_counts(folder: Path, corner: tuple[int, ...], shape: tuple[int, ...]) -> Grid:
    """Background returns of all flightlines in each voxel."""
    counts = np.zeros(shape)
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        background = pq.read_table(truth)["kind"].to_numpy() == 0
        las = laspy.read(folder / "flightlines" / f"{truth.stem}.laz")
        index = [
            np.floor(np.asarray(las[k])[background] / VOXEL_M).astype(np.int64) - c
            for k, c in zip("xyz", corner, strict=True)
        ]
        inside = np.all([(i >= 0) & (i < n) for i, n in zip(index, shape, strict=True)], axis=0)
        np.add.at(counts, tuple(i[inside] for i in index), 1)
    return counts


def _swaths(x: Grid, y: Grid, z: Grid, scene: Mapping[str, Any]) -> tuple[Mask, NDArray[np.int64]]:
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


def _gate_ends(truth: Grid) -> tuple[Mask, Mask]:
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


SEEDS: Final = {"shadows": 3, "shadows, even rate": 3, "classes": 3, "parcels": 1, "fields": 1,
                "shoreline": 1, "slopes": 1}  # fmt: skip
"""Scenes of which the kept noise is counted, and how many seeds each has."""

MIDDLE_M, FAR_M = 65.0, 5.0
"""Half of the square in which returns count; least distance of far noise from what is true."""


def kept(given: Given) -> Iterator[Figure]:
    """Far noise and true returns that are kept: mean and standard error of seeds."""
    for scene, seeds in SEEDS.items():
        found = []
        for seed in range(1, seeds + 1):
            content = {"name": "uneven", **BASE, **SCENES[scene], "seed": seed}
            found.append(_kept(simulated(content, given.scratch / "uneven" / f"{scene} {seed}")))
        for what in found[0]:
            values = np.array([one[what] for one in found])
            moves: tuple[Worse, float] = ("more", 0.05) if "noise" in what else ("less", 0.2)
            yield figure(f"{scene}, kept: {what}", float(values.mean()), "%", *moves)
            if seeds > 1:
                error = float(values.std(ddof=1) / seeds**0.5)
                yield figure(f"{scene}, standard error: {what}", error, "%", "more", 0.1)


def _kept(folder: Path) -> dict[str, float]:
    """Kept shares of a survey, by kind, and of far noise by how bright the ground is [%]."""
    xyz, kind, shots = _returns(folder)
    workflow = load_workflow(folder / "workflow.yaml", ())
    facts = {"acquisition": workflow.acquisition.model_dump(exclude_none=True)}
    labels = filter_points(xyz, **shots, settings=facts)
    corner, rate, scene, (x, y, _) = _lattice(folder)
    inner = _core(x, y, scene) & _gate_ends(rate)[1]
    usual = float(np.median(rate[inner]))
    middle = np.array(scene["origin_m"][:2]) + np.array(scene["extent_m"]) / 2
    counted = (np.abs(xyz[:, :2] - middle) < MIDDLE_M).all(axis=1)
    xyz, kind, signal = xyz[counted], kind[counted], labels.signal[counted]
    at = np.clip(np.floor(xyz / VOXEL_M).astype(np.int64) - corner, 0, np.array(rate.shape) - 1)
    relative, known = rate[tuple(at.T)] / usual, inner[tuple(at.T)]
    true = ~np.isin(kind, NOISE)
    distance = KDTree(xyz[true]).query(xyz, distance_upper_bound=FAR_M)[0]
    far = (kind == KINDS.index("background")) & np.isinf(distance) & known
    found = {
        "far noise": far,
        "far noise, bright": far & (relative > BRIGHTER),
        "far noise, dark": far & (relative < 1.0 / BRIGHTER),
        **{name: kind == KINDS.index(name) for name in ("vegetation", "ground", "roof")},
    }
    return {name: share(signal, rows) for name, rows in found.items() if rows.any()}


def _returns(folder: Path) -> tuple[Grid, NDArray[np.uint8], dict[str, Any]]:
    """Places of a survey's returns, their kinds, and what filter_points asks of their shots."""
    time, *sensor = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1).T[:4]
    lines = sorted((folder / "truth").glob("line_*.parquet"))
    clouds = [laspy.read(folder / "flightlines" / f"{line.stem}.laz") for line in lines]
    kind = np.concatenate([pq.read_table(line)["kind"].to_numpy() for line in lines])
    x, y, z, *columns = (
        np.concatenate([np.asarray(cloud[name]) for cloud in clouds])
        for name in ("x", "y", "z", "gps_time", "channel", "return_number", "point_source_id")
    )
    names = ("gps_time", "channel", "return_number", "flightline")
    shots = dict(zip(names, columns, strict=True))
    origin = [np.interp(shots["gps_time"], time, axis) for axis in sensor]
    return np.column_stack([x, y, z]), kind, {**shots, "beam_origin": np.column_stack(origin)}


DENSITIES: Final = (0.02, 0.1, 0.4, 1.0)
"""Of pure noise [1/m3]."""

POINTS, DRAWS, ALPHA = 60_000, 2, 0.001
"""Noise points of a draw, draws [count], and the filter's alpha."""

HEIGHT_M: Final = 60.0
AROUND_M: Final = (28.0, 28.0, 20.0)
"""Height of a box of noise, and as far as it is repeated around itself: beyond the reach of the
test and its links, and two tubes of the scan for conductors [m]."""

UNIFORM: Final = (0.01, 0.1, 0.5)
"""Values x at which the share of p <= x is looked at."""


def alpha(given: Given) -> Iterator[Figure]:
    """Pure noise that is kept over alpha, and share of p <= x over x, by density."""
    del given
    for density in DENSITIES:
        drawn = [_pure_noise(k, density) for k in range(DRAWS)]
        kept = np.mean([signal.mean() for _, signal in drawn])
        yield figure(f"kept / alpha, {density:g} per m3", kept / ALPHA, tolerance=0.1)
        for level in UNIFORM:
            share = np.mean([(p <= level).mean() for p, _ in drawn])
            name = f"p <= {level:g} / {level:g}, {density:g} per m3"
            yield figure(name, share / level, tolerance=0.03)


def _pure_noise(seed: int, density: float) -> tuple[NDArray[np.float32], Mask]:
    """P-value of uniform noise that repeats itself, and whether the whole filter keeps it."""
    rng = np.random.default_rng([1, seed, round(1000 * density)])
    side = (POINTS / density / HEIGHT_M) ** 0.5
    size, around = (
        np.rint(1000 * np.array(v)).astype(np.int64) for v in ((side, side, HEIGHT_M), AROUND_M)
    )
    xyz, _, core = repeated(rng, density, size, np.minimum(size, around))
    found = filter_points(xyz / 1000.0, density, alpha=ALPHA)
    return found.p_value[core], found.signal[core]
