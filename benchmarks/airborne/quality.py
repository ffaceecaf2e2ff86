"""What the chain keeps and removes, against point truth.

Run ``python -m benchmarks.airborne.quality SURVEY``.

SURVEY is a folder that ``spl-batch simulate`` or ``spl-batch quickstart`` wrote and that
``spl-batch run`` has processed with ``outputs.diagnostics: true`` where the noise density
is to be checked. Prints one line for each figure, with the bar that the project sets. Open ground
is where the true surface is the ground, and no water: the terrain of water is its surface, and has
figures of its own.
"""

import json
import sys
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
import shapely
from affine import Affine
from numpy.typing import NDArray
from rasterio.features import rasterize
from scipy import ndimage

from benchmarks.airborne.filter import methods

KINDS = (*methods.KINDS, "bottom")
SPIKE_M = 0.5
"""A DSM cell this much above every true return of it and its neighbours is set by noise [m]."""

Bar = tuple[str, float]
BARS: dict[str, Bar] = {
    "ground labelled signal %": (">=", 99.5),
    "roof labelled signal %": (">=", 99.0),
    "vegetation labelled signal %": (">=", 98.0),
    "wire labelled signal %": (">=", 98.0),
    "background removed %": (">=", 95.0),
    "afterpulses under ground and roofs removed %": (">=", 97.0),
    "afterpulses in vegetation removed %": (">=", 80.0),
    "DTM RMSE on open ground cm": ("<=", 5.0),
    "DSM cells set by noise per 10 000": ("<=", 1.0),
    "expected / true noise density": ("~", 0.03),
}


def main(folder: Path) -> dict[str, float]:
    """Measure one processed survey and print the figures."""
    points = _load(folder)
    figures = {**_kept(folder, points), **_terrain(folder), **_spikes(folder, points)}
    if "noise_density" in points:
        figures["expected / true noise density"] = _density_ratio(folder, points)
    for name, value in figures.items():
        kind, limit = BARS.get(name, ("", 0.0))
        bar = {"~": f"1 +- {limit:g}", "": ""}.get(kind, f"{kind} {limit:g}")
        print(f"{name:48s} {value:10.3f}   {bar}")
    return figures


def _load(folder: Path) -> dict[str, NDArray[np.generic]]:
    """Delivered points of all flightlines, with truth beside them."""
    parts: dict[str, list[NDArray[np.generic]]] = {}
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        las = laspy.read(folder / "out" / "laz" / "flightlines" / f"{truth.stem}.laz")
        table = pq.read_table(truth)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        columns |= {"x": np.asarray(las.x), "y": np.asarray(las.y), "z": np.asarray(las.z)}
        for name in ("noise_class", "classification", "noise_density", "p_value"):
            if name in las.point_format.dimension_names:
                columns[name] = np.asarray(las[name])
        for name, values in columns.items():
            parts.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def _kept(folder: Path, points: dict[str, NDArray[np.generic]]) -> dict[str, float]:
    kind, signal = points["kind"], points["noise_class"] == 0
    shares = {
        f"{name} labelled signal %": 100 * float(signal[kind == KINDS.index(name)].mean())
        for name in ("ground", "roof", "vegetation", "wire", "water", "bottom")
        if np.any(kind == KINDS.index(name))
    }
    background = kind == KINDS.index("background")
    afterpulse = kind == KINDS.index("afterpulse")
    in_water = _in_water(folder, points)
    for name, given in (("water", 9), ("bottom", 1)):
        of = in_water & (kind == KINDS.index(name))
        if of.any():
            share = float((points["classification"][of] == given).mean())
            shares[f"{name} in its polygon of class {given} %"] = 100 * share
    hard = afterpulse & np.isin(points["parent"], (KINDS.index("ground"), KINDS.index("roof")))
    soft = afterpulse & (points["parent"] == KINDS.index("vegetation"))
    return {
        **shares,
        "background removed %": 100 * float(1 - signal[background].mean()),
        "afterpulses under ground and roofs removed %": 100 * float(1 - signal[hard].mean()),
        "afterpulses in vegetation removed %": 100 * float(1 - signal[soft].mean()),
    }


def _terrain(folder: Path) -> dict[str, float]:
    """DTM against the true one, where the true surface is the ground, and everywhere."""
    with rasterio.open(folder / "out" / "dtm.tif") as found:
        height, at = found.read(1), found.transform
    with rasterio.open(folder / "truth" / "dtm.tif") as true:
        terrain, origin = true.read(1), true.transform
    with rasterio.open(folder / "truth" / "dsm.tif") as true:
        top = true.read(1)
    wet = _water(folder, origin, terrain.shape)
    row, col = round((origin.f - at.f) / at.e), round((origin.c - at.c) / at.a)
    r0, c0 = max(row, 0), max(col, 0)
    r1, c1 = (
        min(row + terrain.shape[0], height.shape[0]),
        min(col + terrain.shape[1], height.shape[1]),
    )
    got = height[r0:r1, c0:c1].astype(np.float64)
    want = terrain[r0 - row : r1 - row, c0 - col : c1 - col].astype(np.float64)
    above = top[r0 - row : r1 - row, c0 - col : c1 - col] - want
    wet = wet[r0 - row : r1 - row, c0 - col : c1 - col]
    valid = (got > -9000) & (want > -9000)
    open_ground = valid & (np.abs(above) < 0.2) & ~wet
    difference = got - want
    figures = {
        "DTM RMSE on open ground cm": 100 * float(np.sqrt(np.mean(difference[open_ground] ** 2))),
        "DTM mean difference on open ground cm": 100 * float(difference[open_ground].mean()),
        "DTM mean |difference| everywhere cm": 100 * float(np.abs(difference[valid]).mean()),
        "DTM worst difference cm": 100 * float(np.abs(difference[valid]).max()),
    }
    inner = valid & ndimage.binary_erosion(wet, np.ones((3, 3)))
    if inner.any():
        off = difference[inner]
        figures["DTM RMSE within water cm"] = 100 * float(np.sqrt(np.mean(off**2)))
        figures["DTM mean difference within water cm"] = 100 * float(off.mean())
    return figures


def _polygons(folder: Path) -> list[shapely.Polygon]:
    """Water of the scene."""
    truth = json.loads((folder / "truth" / "scene.json").read_text(encoding="utf-8"))["scene"]
    east, north = truth["origin_m"][:2]
    return [
        shapely.Polygon([(x + east, y + north) for x, y in water["ring_m"]])
        for water in truth["water"]
    ]


def _in_water(folder: Path, points: dict[str, NDArray[np.generic]]) -> NDArray[np.bool_]:
    """Points within the water's outlines."""
    found = np.zeros(len(points["x"]), np.bool_)
    for polygon in _polygons(folder):
        found |= shapely.contains_xy(polygon, points["x"], points["y"])
    return found


def _water(folder: Path, at: Affine, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Cells of the true rasters that water covers in part."""
    polygons = _polygons(folder)
    if not polygons:
        return np.zeros(shape, np.bool_)
    return rasterize(polygons, shape, transform=at, all_touched=True).astype(np.bool_)


def _spikes(folder: Path, points: dict[str, NDArray[np.generic]]) -> dict[str, float]:
    """Shares of the scene's DSM cells that lie above every true return within one cell, and in it.

    Noise a metre beside a crown is told from its twigs by nothing, and a cell that it sets is as
    high as the crown beside it. The second share counts such cells, too, and a crown's own cells
    in which noise lies above what was returned. Where only the bottom of clear water sent
    something back, its surface is as true.
    """
    with rasterio.open(folder / "out" / "dsm.tif") as source:
        dsm, at = source.read(1).astype(np.float64), source.transform
    noise = methods.is_noise(points["kind"])
    row = np.floor((at.f - points["y"][~noise]) / -at.e).astype(int)
    col = np.floor((points["x"][~noise] - at.c) / at.a).astype(int)
    inside = (row >= 0) & (row < dsm.shape[0]) & (col >= 0) & (col < dsm.shape[1])
    top = np.full(dsm.shape, -np.inf)
    np.maximum.at(top, (row[inside], col[inside]), points["z"][~noise][inside])
    padded = np.pad(top, 1, constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    near = windows.max(axis=(2, 3))
    with rasterio.open(folder / "truth" / "dtm.tif") as true:
        r0, c0 = round((true.transform.f - at.f) / at.e), round((true.transform.c - at.c) / at.a)
        terrain, wet = true.read(1), _water(folder, true.transform, true.shape)
    rows, cols = terrain.shape
    first, left = max(r0, 0), max(c0, 0)
    scene = slice(first, r0 + rows), slice(left, c0 + cols)
    valid = np.zeros(dsm.shape, dtype=bool)
    valid[scene] = True
    valid &= (dsm > -9000) & np.isfinite(near)
    level = np.where(wet, terrain, -np.inf)[first - r0 :, left - c0 :]
    for returns in (near, top):
        within = returns[scene]
        returns[scene] = np.maximum(within, level[: within.shape[0], : within.shape[1]])
    spiked = valid & (dsm > near + SPIKE_M)
    seen = valid & np.isfinite(top)
    above = seen & (dsm > top + SPIKE_M)
    return {
        "DSM cells set by noise per 10 000": 1e4 * float(spiked.sum() / valid.sum()),
        "DSM cells above their own returns per 10 000": 1e4 * float(above.sum() / seen.sum()),
    }


def _density_ratio(folder: Path, points: dict[str, NDArray[np.generic]]) -> float:
    """Expected over true background, pooled: summed expectation of voxels over their noise.

    Only voxels that hold at least one delivered density count; each counts once.
    """
    voxel = np.floor(np.stack([points[a] / 10.0 for a in "xyz"])).astype(np.int64)
    low = voxel.min(axis=1, keepdims=True)
    shape = tuple(voxel.max(axis=1) - low[:, 0] + 1)
    at = np.ravel_multi_index(tuple(voxel - low), shape)
    count = np.bincount(at, weights=points["kind"] == 0, minlength=int(np.prod(shape)))
    known = np.isfinite(points["noise_density"])
    expected = np.zeros(int(np.prod(shape)))
    expected[at[known]] = points["noise_density"][known] * 1000.0
    inner = _interior(folder, voxel, low, shape)
    used = (expected > 0) & inner
    print(f"{'true noise returns pooled':48s} {count[used].sum():10.0f}")
    return float(expected[used].sum() / count[used].sum())


def _interior(
    folder: Path,
    voxel: NDArray[np.int64],
    low: NDArray[np.int64],
    shape: tuple[int, ...],
) -> NDArray[np.bool_]:
    """Voxels that the survey covers wholly: one ring inside its edge."""
    del folder
    ground = np.zeros(shape[:2], dtype=bool)
    ground[tuple((voxel - low)[:2])] = True
    padded = np.pad(ground, 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    inner = windows.all(axis=(2, 3))
    return np.broadcast_to(inner[:, :, None], shape).reshape(-1)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m benchmarks.airborne.quality SURVEY_FOLDER")
    main(Path(sys.argv[1]))
