"""What a processed survey is worth whose points carry their truth.

``far noise`` is noise more than 3 m from every true return. A DSM cell is too high where it stands
above every true return of it and the cells around.
"""

import math
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from affine import Affine
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks.airborne.filter.methods import KINDS, is_noise
from spl_batch.constants import CLASS_GROUND

FAR_M: Final = 3.0
"""Distance from true returns from which on noise is far [m]."""


def measure(folder: Path, out: str = "out") -> dict[str, float]:
    """Figures of one processed survey [%, m].

    ``out``: folder of the result below that of the survey.
    """
    points = _load(folder, out)
    kind, kept = points["kind"], points["noise_class"] == 0
    noise = is_noise(kind)
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    gap = KDTree(xyz[~noise]).query(xyz[noise], distance_upper_bound=FAR_M, workers=2)[0]
    far = np.isinf(gap)
    figures = {
        "noise removed": 100 * float(1 - kept[noise].mean()),
        "far noise kept": 100 * float(kept[noise][far].mean()),
    }
    late = kind == KINDS.index("afterpulse")
    figures["afterpulses"] = 100 * float(1 - kept[late].mean())
    for name in ("ground", "roof", "vegetation", "wire"):
        figures[name] = 100 * float(kept[kind == KINDS.index(name)].mean())
    found = points["classification"] == CLASS_GROUND
    figures["ground found"] = 100 * float(found[kind == KINDS.index("ground")].mean())
    return figures | _surfaces(folder, out, points, noise)


def _load(folder: Path, out: str) -> dict[str, NDArray[Any]]:
    parts: dict[str, list[NDArray[Any]]] = {}
    for path in sorted((folder / out / "laz").rglob("*.laz")):
        las, truth = laspy.read(path), folder / "truth" / f"{path.stem}.parquet"
        parts.setdefault("kind", []).append(pq.read_table(truth)["kind"].to_numpy())
        for name in ("x", "y", "z", "noise_class", "classification"):
            parts.setdefault(name, []).append(np.asarray(las[name]))
    return {name: np.concatenate(values) for name, values in parts.items()}


def _surfaces(
    folder: Path, out: str, points: dict[str, NDArray[Any]], noise: NDArray[np.bool_]
) -> dict[str, float]:
    """How much of the DSM stands above every true return around, and the error of the DTM."""
    with rasterio.open(folder / "truth" / "dtm.tif") as source:
        true, origin = source.read(1).astype(np.float64), source.transform
    dsm, dtm = (
        _on_grid(folder / out / f"{name}.tif", origin, true.shape) for name in ("dsm", "dtm")
    )
    row = np.floor((origin.f - points["y"][~noise]) / -origin.e).astype(int)
    col = np.floor((points["x"][~noise] - origin.c) / origin.a).astype(int)
    inside = (row >= 0) & (row < true.shape[0]) & (col >= 0) & (col < true.shape[1])
    top = np.full((true.shape[0] + 2, true.shape[1] + 2), -np.inf)
    np.maximum.at(top, (row[inside] + 1, col[inside] + 1), points["z"][~noise][inside])
    near = np.lib.stride_tricks.sliding_window_view(top, (3, 3)).max(axis=(2, 3))
    over = (dsm - near)[np.isfinite(dsm) & np.isfinite(near)]
    error = (dtm - true)[np.isfinite(dtm) & (true > -9000)]
    return {
        "DSM > 1 m": 100 * float((over > 1).mean()),
        "DSM > 10 m": 100 * float((over > 10).mean()),
        "DSM rmse": math.sqrt(float(np.mean(np.maximum(over, 0) ** 2))),
        "DTM rmse": math.sqrt(float(np.mean(error**2))),
        "DTM > 0.5": 100 * float((np.abs(error) > 0.5).mean()),
    }


def _on_grid(path: Path, origin: Affine, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Part of a raster on the cells of the truth; NaN where it has none."""
    with rasterio.open(path) as source:
        values, at = source.read(1).astype(np.float64), source.transform
    out = np.full(shape, np.nan)
    r0, c0 = round((origin.f - at.f) / -origin.e), round((at.c - origin.c) / at.a)
    rows = slice(max(r0, 0), min(r0 + values.shape[0], shape[0]))
    cols = slice(max(c0, 0), min(c0 + values.shape[1], shape[1]))
    part = values[rows.start - r0 : rows.stop - r0, cols.start - c0 : cols.stop - c0]
    out[rows, cols] = np.where(part > -9000, part, np.nan)
    return out
