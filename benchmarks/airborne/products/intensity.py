"""Reflectance from detections against truth.

Run ``python -m benchmarks.airborne.products.intensity [--folder F]``.

For each seed a survey is simulated (``--seeds``, ``--extent``; into F, where what is there is
used again) and run: rolling ground whose reflectance varies, roofs from 0.05 to 0.8, flat and
steep, flightlines at three altitudes of which two end within the scene, dead and weak channels.
Printed are, over patches of one reflectance (roofs without their rim; squares of 5 m of open
ground) and over single cells of the same surfaces:

* ``r2``, squared correlation with the true reflectance, which no scale or offset changes;
* ``R2``, 1 - residual / total sum of squares about the 1:1 line, which both change;
* ``ratio``, median of estimate / truth;

for the delivered raster, for the mean LAS intensity, and with each normalisation left out. The
last lines say what chance leaves of R2 per cell, by reflectance how far patches are off, and why
cells exceed 1. The bar is R2 >= 0.95 over patches; the source [W17 8.2.2] proposes the method
without a number.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import rasterio
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.airborne.filter.methods import flightlines, make_survey
from spl_batch import api
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart
from spl_batch.airborne.products.reflectance.reflectance import ALL_TERMS, Detections, detections
from spl_batch.airborne.settings import ProductSettings
from spl_batch.airborne.simulate.scene.layout import lay_out
from spl_batch.airborne.simulate.scene.objects import outline
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.constants import NOISE_SIGNAL
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

BAR = 0.95
"""R2 over patches, at least."""

ROOFS = 16
"""Roofs of a scene, from dark to bright [count]."""

PATCH = 5
"""Edge of a square of open ground [cells]."""

RIM_M = 1.5
"""Strip along the edges of roofs that is left out [m]."""

CLEAR = 7
"""Edge of the window in which nothing may stand beside open ground [cells]."""

NEARLY_ALL = 0.9
"""Share of beamlets seen from which it hardly tells how bright a cell is."""

STEEP = 1.5
"""Factor that incidence has on surfaces whose slope may be none."""

Raster = NDArray[np.float64]
Products = dict[str, Raster]


def intensity_scene(seed: int, extent_m: float) -> Scene:
    """Ground and roofs of many reflectances under flightlines of several altitudes."""
    rng = np.random.default_rng(seed)
    side = int(np.sqrt(ROOFS))
    step = extent_m / side
    bright = rng.permutation(np.geomspace(0.05, 0.8, ROOFS))
    roofs = [
        {
            "centre_m": [(k % side + 0.5) * step, (k // side + 0.5) * step],
            "size_m": [0.45 * step, 0.35 * step],
            "heading_deg": float(rng.uniform(0, 180)),
            "eave_m": float(rng.uniform(4, 9)),
            "roof": ("flat", "gable", "shed")[k % 3],
            "pitch_deg": float(rng.uniform(25, 45)),
            "reflectance": float(bright[k]),
        }
        for k in range(ROOFS)
    ]
    edge = np.tan(np.radians(15.0))
    heading = float(rng.uniform(0, 360))
    flights = [
        {"heading_deg": heading, "altitude_agl_m": 2500.0, "offset_m": 300.0},
        {"heading_deg": heading + 90, "altitude_agl_m": 1800.0, "offset_m": 1800.0 * edge},
        {"heading_deg": heading + 200, "altitude_agl_m": 3300.0, "offset_m": -3300.0 * edge},
    ]
    channels = rng.permutation(np.arange(1, 101))
    content: dict[str, Any] = {
        "name": f"intensity, seed {seed}",
        "seed": seed,
        "extent_m": [extent_m, extent_m],
        "terrain": {"relief_m": 25.0, "wavelength_m": 100.0, "reflectance_variation": 0.4},
        "buildings": {"list": roofs},
        "flights": [{"speed_m_s": 100.0, **flight} for flight in flights],
        "sky": {"background_per_m3": 0.08},
        "acquisition": {
            "prf_hz": 50_000.0,
            "gate_m": 250.0,
            "dead_channels": channels[:8].tolist(),
            "weak_channels": {int(c): 0.2 for c in channels[8:14]},
        },
    }
    return parse_scene(content, "intensity")


def main(folder: Path, seeds: Sequence[int], extent_m: float) -> None:
    """Print one table for each seed."""
    for seed in seeds:
        scene = intensity_scene(seed, extent_m)
        survey = make_survey(scene, folder / f"intensity_{seed}")
        api.run(survey / "workflow.yaml", workers=1)
        products, full = estimates(survey, scene)
        truth, patch = raster(survey / "truth" / "reflectance.tif"), patches(survey, scene)
        print(f"\n{scene.name}: {int((patch > 0).sum())} cells in {int(patch.max())} patches")
        print(f"{'':34s}{'patches':>24s}{'cells':>24s}")
        print(f"{'':34s}" + 2 * f"{'r2':>8s}{'R2':>8s}{'ratio':>8s}")
        for name, values in products.items():
            _row(name, values, truth, patch)
        chance = _chance(full, truth, patch)
        print(f"R2 of single cells that chance leaves: {chance:.3f}")
        _by_reflectance(products["delivered"], truth, patch)
        _above_one(full, products["without incidence"])


def _above_one(full: Detections, level: Raster) -> None:
    """Say how many cells exceed what a diffuse surface reflects, and for which reason."""
    reflectance, fired, seen = (values[::-1] for values in full)
    above = reflectance > 1
    bright = above & (seen >= NEARLY_ALL * fired)
    steep = above & ~bright & (reflectance > STEEP * level)
    print(f"cells above 1: {above.sum()} of {np.isfinite(reflectance).sum()}")
    print(f"  of which {NEARLY_ALL:.0%} of the beamlets were seen: {bright.sum()}")
    print(f"  others that incidence makes {STEEP:g} times as bright: {steep.sum()}")


def estimates(survey: Path, scene: Scene) -> tuple[Products, Detections]:
    """Rasters of the scene, north up, by name; and what the full estimate rests on."""
    points = _points(survey)
    parts = [
        FiredPart.from_arrays(read_arrays(path))
        for path in sorted((survey / "out" / "store" / "fired").rglob("*.npz"))
    ]
    west, south = (round(1000 * v) for v in scene.origin_m[:2])
    size = [round(1000 * v) for v in scene.extent_m]
    cell = Bounds(west, south, west + size[0], south + size[1])
    settings = ProductSettings()
    every = [replace(p, gain=np.where(np.arange(len(p.gain)) > 0, 1.0, 0.0)) for p in parts]
    full = detections(lambda: (points,), parts, cell, settings)
    flat = detections(lambda: (points,), parts, cell, settings, ALL_TERMS._replace(incidence=False))
    level = detections(lambda: (points,), parts, cell, settings, ALL_TERMS._replace(range=False))
    alike = detections(lambda: (points,), every, cell, settings)
    share = np.minimum(full.seen / full.fired.mean(), 0.995)
    # without a range the number is photo-electrons per area; scaled to the truth's middle
    scaled = level.reflectance * np.nanmedian(full.reflectance) / np.nanmedian(level.reflectance)
    density = -np.log1p(-share)
    density *= np.nanmedian(full.reflectance) / np.nanmedian(density)
    rasters = {
        "delivered": cut(survey / "out" / "intensity.tif", cell),
        "mean LAS intensity": _mean_intensity(points, cell)[::-1],
        "without overlap (density)": density[::-1],
        "without range": scaled[::-1],
        "without incidence": flat.reflectance[::-1],
        "without dead and weak channels": alike.reflectance[::-1],
    }
    return rasters, full


def _points(survey: Path) -> PointTable:
    """Delivered points of all flightlines."""
    names = {"gps_time": "gps_time", "channel": "channel", "noise_class": "noise_class"}
    names |= {"intensity": "intensity", "return_number": "return_number"}
    columns: dict[str, list[NDArray[Any]]] = {k: [] for k in ("x", "y", "z", *names)}
    for path in flightlines(survey):
        las = laspy.read(survey / "out" / "laz" / "flightlines" / path.name)
        for axis in "xyz":
            columns[axis].append(np.rint(np.asarray(las[axis]) * 1000).astype(np.int64))
        for name, dimension in names.items():
            columns[name].append(np.asarray(las[dimension]))
    return PointTable({}).with_columns(**{k: np.concatenate(v) for k, v in columns.items()})


def _mean_intensity(points: PointTable, cell: Bounds) -> Raster:
    """Mean of the first returns' intensity as delivered, south row first."""
    first = (points["noise_class"] == NOISE_SIGNAL) & (points["return_number"] <= 1)
    x, y = (points["x"][first] - cell.xmin) // 1000, (points["y"][first] - cell.ymin) // 1000
    rows, cols = (cell.ymax - cell.ymin) // 1000, (cell.xmax - cell.xmin) // 1000
    mine = (x >= 0) & (x < cols) & (y >= 0) & (y < rows)
    number = y[mine] * cols + x[mine]
    total = np.bincount(number, points["intensity"][first][mine], minlength=rows * cols)
    count = np.bincount(number, minlength=rows * cols)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean.reshape(rows, cols)


def patches(survey: Path, scene: Scene) -> NDArray[np.int64]:
    """Number of the patch of each cell, from 1, north up; 0 for cells of none."""
    height = raster(survey / "truth" / "dsm.tif") - raster(survey / "truth" / "dtm.tif")
    open_ground = ndimage.maximum_filter(np.abs(height), CLEAR) < 0.05
    rows, cols = height.shape
    patch = np.zeros(height.shape, dtype=np.int64)
    last = 0
    for row in range(0, rows - PATCH + 1, PATCH):
        for col in range(0, cols - PATCH + 1, PATCH):
            if open_ground[row : row + PATCH, col : col + PATCH].all():
                last += 1
                patch[row : row + PATCH, col : col + PATCH] = last
    x, y = np.meshgrid(np.arange(cols) + 0.5, rows - np.arange(rows) - 0.5)
    for building in lay_out(scene).buildings:
        roof = shapely.Polygon(outline(building)).buffer(-RIM_M)
        inside = shapely.contains_xy(roof, x, y)
        if inside.any():
            last += 1
            patch[inside] = last
    return patch


def raster(path: Path) -> Raster:
    """Values of a raster; NaN where it has none."""
    with rasterio.open(path) as source:
        values = source.read(1).astype(np.float64)
        return np.where(values == source.nodata, np.nan, values)


def cut(path: Path, cell: Bounds) -> Raster:
    """The part of a raster of 1 m cells that lies over the scene."""
    with rasterio.open(path) as source:
        left, top = (round(v) for v in (source.transform.c, source.transform.f))
    row, col = top - cell.ymax // 1000, cell.xmin // 1000 - left
    rows, cols = (cell.ymax - cell.ymin) // 1000, (cell.xmax - cell.xmin) // 1000
    return raster(path)[row : row + rows, col : col + cols]


def means(values: Raster, patch: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean over each patch, cells without a value left out."""
    used = (patch > 0) & np.isfinite(values)
    count = np.bincount(patch[used], minlength=int(patch.max()) + 1)[1:]
    total = np.bincount(patch[used], values[used], minlength=int(patch.max()) + 1)[1:]
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def scores(found: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float, float]:
    """Squared correlation, R2 about the 1:1 line, median ratio."""
    known = np.isfinite(found) & np.isfinite(truth)
    found, truth = found[known], truth[known]
    about = 1 - float(((found - truth) ** 2).sum() / ((truth - truth.mean()) ** 2).sum())
    return float(np.corrcoef(found, truth)[0, 1] ** 2), about, float(np.median(found / truth))


def _row(name: str, values: Raster, truth: Raster, patch: NDArray[np.int64]) -> None:
    by_patch = scores(means(values, patch), means(truth, patch))
    by_cell = scores(values[patch > 0], truth[patch > 0])
    text = "".join(f"{a:8.3f}{b:8.3f}{c:8.3f}" for a, b, c in (by_patch, by_cell))
    if "LAS" in name:
        text = "".join(f"{a:8.3f}{'-':>8s}{'-':>8s}" for a, _, _ in (by_patch, by_cell))
    mark = "" if name != "delivered" else f"   R2 >= {BAR}" + ("" if by_patch[1] >= BAR else " !")
    print(f"{name:34s}{text}{mark}")


def _chance(full: Detections, truth: Raster, patch: NDArray[np.int64]) -> float:
    """R2 of an estimate whose only error is that of counting beamlets.

    A share p of N beamlets has variance p (1 - p) / N, hence n = -ln(1 - p) has p / (N (1 - p)).
    """
    fired, seen, rho = (v[::-1][patch > 0] for v in (full.fired, full.seen, full.reflectance))
    known = np.isfinite(rho) & (seen > 0)
    share = np.minimum(seen / np.maximum(fired, 1), 1 - 0.5 / np.maximum(fired, 1))[known]
    electrons = -np.log1p(-share)
    variance = share / (fired[known] * (1 - share)) * (rho[known] / electrons) ** 2
    return 1 - float(variance.sum() / ((truth[patch > 0] - truth[patch > 0].mean()) ** 2).sum())


def _by_reflectance(values: Raster, truth: Raster, patch: NDArray[np.int64]) -> None:
    found, true = means(values, patch), means(truth, patch)
    print(f"{'reflectance':>14s}{'patches':>9s}{'ratio':>8s}{'spread':>8s}")
    for low, high in ((0.0, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.5), (0.5, 1.0)):
        mine = (true >= low) & (true < high) & np.isfinite(found)
        if mine.any():
            ratio = found[mine] / true[mine]
            print(f"{low:7.1f} -{high:4.1f} {int(mine.sum()):9d}"
                  f"{float(ratio.mean()):8.3f}{float(ratio.std()):8.3f}")  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else "")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--extent", type=float, default=120.0, help="edge of the scene [m]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        main(options.folder or Path(temporary), options.seeds, options.extent)
