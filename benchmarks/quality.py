"""What the chain keeps and removes, against point truth: ``python -m benchmarks.quality SURVEY``.

SURVEY is a folder that ``spl-batch simulate`` or ``spl-batch quickstart`` wrote and that
``spl-batch run`` has processed with ``outputs.diagnostics: true`` where the noise density
is to be checked. Prints one line for each figure, with the bar that the project sets. Open ground
is where the true surface is the ground, and no water: the terrain of water is its surface, and has
figures of its own.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import rasterio
import shapely
from rasterio.features import rasterize
from scipy import ndimage

from benchmarks.held import truth
from benchmarks.held.truth import Grid, Mask, Points, share

SPIKE_M: Final = 0.5
"""A DSM cell this much above every true return of it and its neighbours is set by noise [m]."""

VOXEL_M: Final = 10.0

UNJUDGED: Final = 255
"""Class of points outside the area of interest."""

BARS: Final[Mapping[str, tuple[str, float]]] = {
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


def main(folder: Path) -> None:
    """Print the figures of one processed survey."""
    for name, value in figures(folder).items():
        kind, limit = BARS.get(name, ("", 0.0))
        bar = {"~": f"1 +- {limit:g}", "": ""}.get(kind, f"{kind} {limit:g}")
        print(f"{name:48s} {value:10.3f}   {bar}")


def figures(folder: Path) -> dict[str, float]:
    """Figures of one processed survey by name."""
    table = truth.points(folder)
    judged = table["noise_class"] != UNJUDGED
    inside = {name: values[judged] for name, values in table.items()}
    found = {**_kept(folder, inside), **_terrain(folder), **_spikes(folder, inside)}
    if "noise_density" in table:
        found["expected / true noise density"] = _density_ratio(table)
    return found


def _kept(folder: Path, table: Points) -> dict[str, float]:
    kept = table["noise_class"] == 0
    found = {}
    for name in ("ground", "roof", "vegetation", "wire", "water", "bottom"):
        found[f"{name} labelled signal %"] = share(kept, truth.of(table, name))
    in_water = np.zeros(len(kept), np.bool_)
    for polygon in _polygons(folder):
        in_water |= shapely.contains_xy(polygon, table["x"], table["y"])
    for name, code in (("water", 9), ("bottom", 1)):
        mine = in_water & truth.of(table, name)
        found[f"{name} in its polygon of class {code} %"] = share(
            table["classification"] == code, mine
        )
    hard, soft = truth.echoes(table, "ground", "roof"), truth.echoes(table, "vegetation")
    found["background removed %"] = share(~kept, truth.of(table, "background"))
    found["afterpulses under ground and roofs removed %"] = share(~kept, hard)
    found["afterpulses in vegetation removed %"] = share(~kept, soft)
    return {name: value for name, value in found.items() if np.isfinite(value)}


def _terrain(folder: Path) -> dict[str, float]:
    """DTM against the true one, where the true surface is the ground, and everywhere."""
    true, top = (truth.raster(folder / "truth" / f"{name}.tif") for name in ("dtm", "dsm"))
    off = truth.delivered(folder, "dtm") - true
    valid, wet = np.isfinite(off), _water(folder)
    open_ground = valid & (np.abs(top - true) < 0.2) & ~wet
    found = {
        "DTM RMSE on open ground cm": 100 * truth.rms(off[open_ground]),
        "DTM mean difference on open ground cm": 100 * float(off[open_ground].mean()),
        "DTM mean |difference| everywhere cm": 100 * float(np.abs(off[valid]).mean()),
        "DTM worst difference cm": 100 * float(np.abs(off[valid]).max()),
    }
    inner = valid & ndimage.binary_erosion(wet, np.ones((3, 3), np.bool_))
    if inner.any():
        found["DTM RMSE within water cm"] = 100 * truth.rms(off[inner])
        found["DTM mean difference within water cm"] = 100 * float(off[inner].mean())
    return found


def _polygons(folder: Path) -> list[shapely.Polygon]:
    """Water of the scene."""
    scene = json.loads((folder / "truth" / "scene.json").read_text(encoding="utf-8"))["scene"]
    east, north = scene["origin_m"][:2]
    return [
        shapely.Polygon([(x + east, y + north) for x, y in water["ring_m"]])
        for water in scene["water"]
    ]


def _water(folder: Path) -> Mask:
    """Cells of the true rasters that water covers in part."""
    with rasterio.open(folder / "truth" / "dtm.tif") as source:
        shape, at = source.shape, source.transform
    polygons = _polygons(folder)
    if not polygons:
        return np.zeros(shape, np.bool_)
    found: Mask = rasterize(polygons, shape, transform=at, all_touched=True).astype(np.bool_)
    return found


def _spikes(folder: Path, table: Points) -> dict[str, float]:
    """Shares of the scene's DSM cells that lie above every true return within one cell, and in it.

    Noise a metre beside a crown cannot be distinguished from its twigs, and a cell that it sets is
    as high as the crown beside it. The second share counts such cells, too, and a crown's own cells
    in which noise lies above what was returned. Where only the bottom of clear water sent
    something back, its surface is as true.
    """
    dsm, top = truth.delivered(folder, "dsm"), truth.highest(folder, table)
    level: Grid = np.where(_water(folder), truth.raster(folder / "truth" / "dtm.tif"), -np.inf)
    near = truth.around(top)
    valid, seen = np.isfinite(dsm) & np.isfinite(near), np.isfinite(dsm) & np.isfinite(top)
    spiked = valid & (dsm > np.maximum(near, level) + SPIKE_M)
    above = seen & (dsm > np.maximum(top, level) + SPIKE_M)
    return {
        "DSM cells set by noise per 10 000": 1e4 * float(spiked.sum() / valid.sum()),
        "DSM cells above their own returns per 10 000": 1e4 * float(above.sum() / seen.sum()),
    }


def _density_ratio(table: Points) -> float:
    """Expected over true background, pooled: summed expectation of voxels over their noise.

    Only voxels that hold at least one delivered density count; each counts once. One ring of voxels
    at the survey's edge, which it covers in part, is left out.
    """
    voxel = np.floor(np.stack([table[axis] / VOXEL_M for axis in "xyz"])).astype(np.int64)
    voxel -= voxel.min(axis=1, keepdims=True)
    shape = tuple(voxel.max(axis=1) + 1)
    at = np.ravel_multi_index(tuple(voxel), shape)
    count = np.bincount(at, weights=truth.of(table, "background"), minlength=int(np.prod(shape)))
    known = np.isfinite(table["noise_density"])
    expected = np.zeros(int(np.prod(shape)))
    expected[at[known]] = table["noise_density"][known] * VOXEL_M**3
    ground = np.zeros(shape[:2], dtype=np.bool_)
    ground[tuple(voxel[:2])] = True
    inner = ndimage.binary_erosion(ground, np.ones((5, 5), np.bool_))
    used = (expected > 0) & np.broadcast_to(inner[:, :, None], shape).reshape(-1)
    return float(expected[used].sum() / count[used].sum())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m benchmarks.quality SURVEY_FOLDER")
    main(Path(sys.argv[1]))
