"""Terrain and surface models against truth: ``python -m benchmarks.airborne.ground.terrain``.

Takes ``[FOLDER] [--scenes hill dense town mountain] [--seeds 11 12] [--method ptd]``.

Simulates four surveys (a wooded hill of 90 m relief under 60 % canopy, dense forest of
80 %, a town with a hall and a lake, a mountain of slopes up to 60 degrees under dense trees with
shrubs) for each of two seeds into FOLDER, a temporary one by
default, and runs the chain with ground cells as configured, with one cell for the whole scene,
and with a short reach of the terrain, so that halls, lakes and crowns leave voids. Prints what
the terrain models are off, pits and spikes of the surface model, what the cuts between ground
cells do, and whether voids keep the rule. Beside the figures stand the bars: USGS QL0 asks 5 cm
RMSE on open ground; [W17] 7.4 reports 0.23 m mean |difference| to linear-mode lidar. Finished
runs in FOLDER are used again.
"""

import argparse
import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.airborne.filter.methods import is_noise
from benchmarks.airborne.quality import KINDS
from spl_batch import api
from spl_batch.airborne.settings import GroundSettings, ProductSettings
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.constants import CLASS_GROUND, CLASS_HIGH_NOISE, CLASS_LOW_NOISE, CLASS_WATER

EDGE_M = 200
SEEDS = (11, 12)
COMMON: Mapping[str, Any] = {
    # The corner of four ground cells stands in the middle of the scene.
    "origin_m": (272_100.0, 3_290_100.0, 140.0),
    "extent_m": (EDGE_M, EDGE_M),
    "flights": [
        {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
        {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
        {"heading_deg": 200, "offset_m": 350, "speed_m_s": 110, "sky": 1.3},
    ],
    "sky": {"background_per_m3": 0.08},
    "acquisition": {"prf_hz": 30_000, "gate_m": 300, "dead_channels": [53]},
}
HALL = {"centre_m": (95, 105), "size_m": (60, 36), "heading_deg": 20, "eave_m": 7.0}
LAKE = {"ring_m": [(150, 20), (185, 15), (190, 50), (160, 55)]}
SCENES: Mapping[str, Mapping[str, Any]] = {
    "hill": {
        "terrain": {"relief_m": 90, "wavelength_m": 200},
        "buildings": {"count": 8},
        "trees": {"cover": 0.6},
    },
    "dense": {
        "terrain": {"relief_m": 40, "wavelength_m": 150},
        "buildings": {"count": 6},
        "trees": {"cover": 0.8, "gaps": 0.0},
    },
    "town": {
        "terrain": {"relief_m": 12, "wavelength_m": 120},
        "buildings": {"count": 14, "list": [HALL]},
        "trees": {"cover": 0.25},
        "water": [LAKE],
    },
    "mountain": {
        "terrain": {"relief_m": 220, "wavelength_m": 260, "roughness_m": 0.1},
        "buildings": {"count": 2},
        "trees": {
            "cover": 0.6,
            "height_m": (15, 35),
            "radius_m": (1.5, 4.0),
            "extinction_per_m": 0.6,
            "understory": 0.5,
        },
        "flights": [
            {"heading_deg": 45, "altitude_agl_m": 2200, "speed_m_s": 110},
            {"heading_deg": 135, "altitude_agl_m": 2200, "speed_m_s": 110, "offset_m": 200},
        ],
        "acquisition": {"prf_hz": 50_000, "gate_m": 400, "dead_channels": [53]},
    },
}
BARS = {
    "DTM RMSE on open ground cm": "<= 5 (USGS QL0)",
    "DTM mean |d| but on water cm": "<= 10",
    "DSM pits in roofs per 10 000": "0",
    "DSM pits in canopy per 10 000": "0",
    "DSM spikes per 10 000": "<= 1",
    "seams RMSE cm": "< 1",
    "seams largest beside cuts cm": "<= 10",
    "void cells near ground": "0",
    "filled cells far from ground": "0",
}
BESIDE_M = 10.0
"""A seam is a step between ground cells: it shows this near to their cut [m]."""

GAP_M = 4.0
"""Reach of the terrain in the run whose voids are looked at; 20 by default [m]."""

SPIKE_M = 0.5
"""A DSM cell this much above every true return of it and its neighbours is a spike [m]."""

VARIANTS = {
    "dtm_gaps.tif": f"products.void_max_m={GAP_M}",
    "dtm_whole.tif": "ground.cell_m=400",
}
"""Setting of each further run, by the name under which its terrain is kept."""

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Truth(NamedTuple):
    """Rasters of a scene's true state, north up.

    Parameters
    ----------
    terrain, surface : (rows, cols) float64
        Heights of ground, and of ground, roofs and crown envelopes [m].
    returns : (rows, cols) float64
        Highest return that is no noise, -inf without any [m].
    roof, water, ground : (rows, cols) bool
        Cells with returns of that kind, and with delivered ground returns.
    struck, kept : (rows, cols) bool
        Cells with returns that are of the ground in truth, and with such that the filter kept.
    """

    terrain: Grid
    surface: Grid
    returns: Grid
    roof: Mask
    water: Mask
    ground: Mask
    struck: Mask
    kept: Mask


def simulated(kind: str, seed: int, folder: Path) -> Path:
    """Folder of one survey, simulated where it is not there yet."""
    survey = folder / f"{kind}_{seed}"
    if not (survey / "workflow.yaml").exists():
        simulate(parse_scene({**COMMON, **SCENES[kind], "name": kind, "seed": seed}, kind), survey)
    return survey


def process(kind: str, seed: int, folder: Path, method: str) -> Path:
    """Simulate and run one survey: a single ground cell, a short reach, and as configured."""
    survey = simulated(kind, seed, folder)
    workflow = survey / "workflow.yaml"
    chosen = ["output=out", f"ground.method={method}"]
    for name, change in VARIANTS.items():
        if not (survey / method / name).exists():
            api.run(workflow, overrides=[change, *chosen])
            (survey / method).mkdir(exist_ok=True)
            shutil.copy(survey / "out" / "dtm.tif", survey / method / name)
    api.run(workflow, overrides=chosen)
    return survey


def figures(survey: Path, method: str) -> dict[str, float]:
    """All figures of one processed survey."""
    truth = load_truth(survey)
    dtm = cut(survey / "out" / "dtm.tif", survey)
    dsm = cut(survey / "out" / "dsm.tif", survey)
    whole = cut(survey / method / "dtm_whole.tif", survey)
    return {
        **terrain_figures(dtm, truth),
        **surface_figures(dsm, truth),
        "seams RMSE cm": 100 * float(np.sqrt(np.nanmean((dtm - whole) ** 2))),
        "seams largest cm": 100 * float(np.nanmax(np.abs(dtm - whole))),
        "seams largest beside cuts cm": 100
        * float(np.nanmax(np.abs(dtm - whole)[beside_cuts(survey)], initial=0.0)),
        "DTM void cells per 10 000": 1e4 * float(np.isnan(dtm).mean()),
        **void_figures(cut(survey / method / "dtm_gaps.tif", survey), truth),
    }


def terrain_figures(dtm: Grid, truth: Truth) -> dict[str, float]:
    """What the DTM is off, by what stands on the ground."""
    off = dtm - truth.terrain
    above = truth.surface - truth.terrain
    known = ~np.isnan(off) & ~truth.water
    roof = core(truth.roof) & known
    bare = known & ~beside(truth.roof)
    clear = known & (np.abs(above) < 0.2)
    canopy = known & ~truth.roof & (above >= 0.2)
    wrong = bare & (np.abs(off) > 0.5)
    return {
        "DTM RMSE on open ground cm": 100 * float(np.sqrt(np.mean(off[clear] ** 2))),
        "DTM mean d on open ground cm": 100 * float(off[clear].mean()),
        "DTM mean |d| but on water cm": 100 * float(np.abs(off[known]).mean()),
        "DTM mean |d| under canopy cm": 100 * float(np.abs(off[canopy]).mean()),
        "DTM mean |d| under roofs cm": 100 * float(np.abs(off[roof]).mean()),
        "DTM cells off by > 0.5 m per 10 000": 1e4 * float(np.mean(np.abs(off[known]) > 0.5)),
        "the same where no roof is": 1e4 * float(np.mean(np.abs(off[bare]) > 0.5)),
        "cells of these": float(wrong.sum()),
        "with true ground in or beside them": float((wrong & beside(truth.struck)).sum()),
        "with such that the filter kept": float((wrong & beside(truth.kept)).sum()),
        "DTM largest |d| m": float(np.abs(off[known]).max()),
    }


def surface_figures(dsm: Grid, truth: Truth) -> dict[str, float]:
    """Pits and spikes of the DSM.

    A roof has a pit where the DSM lies 1 m below the lowest true surface within one cell;
    a canopy where it lies under half of the lowest true height above ground.
    """
    lowest = ndimage.minimum_filter(truth.surface, 3)
    height = lowest - truth.terrain
    roof = ndimage.binary_erosion(core(truth.roof), np.ones((3, 3), dtype=np.bool_))
    canopy = (height > 2) & ~truth.roof
    pits = {
        "roofs": roof & ~(dsm >= lowest - 1.0),
        "canopy": canopy & ~(dsm >= lowest - 0.5 * height),
    }
    near = ndimage.maximum_filter(truth.returns, 3)
    seen = np.isfinite(near) & ~np.isnan(dsm)
    return {
        "DSM pits in roofs per 10 000": 1e4 * float(pits["roofs"].sum() / max(roof.sum(), 1)),
        "DSM pits in canopy per 10 000": 1e4 * float(pits["canopy"].sum() / max(canopy.sum(), 1)),
        "DSM spikes per 10 000": 1e4 * float(np.mean(dsm[seen] > near[seen] + SPIKE_M)),
    }


def void_figures(gaps: Grid, truth: Truth) -> dict[str, float]:
    """Voids at a short reach; those that have ground near enough, and filled cells without.

    Distances are between cells, hence the tolerance of a diagonal. Ground beyond the frame is not
    known: cells at its edges are left out.
    """
    cell_m = ProductSettings().cell_m
    away = ndimage.distance_transform_edt(~truth.ground) * cell_m
    slack, void = np.sqrt(2.0) * cell_m, np.isnan(gaps)
    known = np.zeros_like(void)
    rim = math.ceil((GAP_M + slack) / cell_m)
    known[rim:-rim, rim:-rim] = True
    near, far = away < GAP_M - slack, away > GAP_M + slack
    return {
        f"cells void at a reach of {GAP_M:g} m per 10 000": 1e4 * float(void[known].mean()),
        "void cells near ground": float((void & near & known).sum()),
        "filled cells far from ground": float((~void & far & known).sum()),
    }


def core(mask: Mask) -> Mask:
    """Areas of a mask that hold a square of three cells."""
    opened: Mask = ndimage.binary_opening(mask, np.ones((3, 3), dtype=np.bool_))
    return opened


def beside(mask: Mask) -> Mask:
    """A mask's cells and the eight around each."""
    around: Mask = ndimage.binary_dilation(mask, np.ones((3, 3), dtype=np.bool_))
    return around


def cut(path: Path, survey: Path) -> Grid:
    """A product's cells over the scene [m]; NaN for nodata."""
    with rasterio.open(survey / "truth" / "dtm.tif") as frame:
        bounds, shape = frame.bounds, frame.shape
    with rasterio.open(path) as source:
        window = source.window(*bounds).round_offsets().round_lengths()
        found = source.read(
            1, window=window, boundless=True, fill_value=source.nodata, out_shape=shape
        )
        return np.where(found == source.nodata, np.nan, found.astype(np.float64))


def beside_cuts(survey: Path) -> Mask:
    """Cells no farther than :data:`BESIDE_M` from a cut between ground cells."""
    edge = GroundSettings().cell_m
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        (rows, columns), at = source.shape, source.transform
    x, y = at.c + 0.5 + np.arange(columns), at.f - 0.5 - np.arange(rows)
    away = [np.abs(v - edge * np.rint(v / edge)) <= BESIDE_M for v in (x, y)]
    found: Mask = away[1][:, None] | away[0][None, :]
    return found


def load_truth(survey: Path) -> Truth:
    """True rasters, and what the returns of each cell are."""
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        terrain, at = source.read(1).astype(np.float64), source.transform
    with rasterio.open(survey / "truth" / "dsm.tif") as source:
        surface = source.read(1).astype(np.float64)
    top = np.full(terrain.shape, -np.inf)
    names = ("roof", "water", "ground", "struck", "kept")
    held = {name: np.zeros(terrain.shape, dtype=np.bool_) for name in names}
    for path in sorted((survey / "truth").glob("line_*.parquet")):
        kind = pq.read_table(path, columns=["kind"])["kind"].to_numpy()
        las = laspy.read(survey / "out" / "laz" / "flightlines" / f"{path.stem}.laz")
        col = np.floor(np.asarray(las.x) - at.c).astype(int)
        row = np.ceil(at.f - np.asarray(las.y)).astype(int) - 1
        inside = (col >= 0) & (col < EDGE_M) & (row >= 0) & (row < EDGE_M)
        noise = is_noise(kind)
        real = inside & ~noise
        np.maximum.at(top, (row[real], col[real]), np.asarray(las.z)[real])
        for name in ("roof", "water"):
            chosen = inside & (kind == KINDS.index(name))
            held[name][row[chosen], col[chosen]] = True
        # Water is ground to the terrain, by another class.
        label = np.asarray(las.classification)
        chosen = inside & np.isin(label, (CLASS_GROUND, CLASS_WATER))
        held["ground"][row[chosen], col[chosen]] = True
        struck = inside & (kind == KINDS.index("ground"))
        held["struck"][row[struck], col[struck]] = True
        kept = struck & ~np.isin(label, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
        held["kept"][row[kept], col[kept]] = True
    return Truth(terrain, surface, top, *(held[name] for name in names))


def main(
    folder: Path,
    scenes: Sequence[str] = tuple(SCENES),
    seeds: Sequence[int] = SEEDS,
    method: str = GroundSettings().method,
) -> dict[str, dict[str, float]]:
    """Run scenes and seeds, and print the table."""
    print(f"ground cells of {GroundSettings().cell_m:g} m against one of 400 m")
    columns = {}
    for kind in scenes:
        for seed in seeds:
            columns[f"{kind} {seed}"] = figures(process(kind, seed, folder, method), method)
    print(f"{'':38s}" + "".join(f"{name:>10s}" for name in columns) + "   bar")
    for name in next(iter(columns.values())):
        values = "".join(f"{column[name]:10.2f}" for column in columns.values())
        print(f"{name:38s}{values}   {BARS.get(name, '')}")
    return columns


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--scenes", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--method", default=GroundSettings().method)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        main(given.folder or Path(temporary), given.scenes, given.seeds, given.method)
