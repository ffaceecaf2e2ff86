"""What a run delivered of a simulated survey, beside the truth that the simulation kept."""

from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.simulate.scene.ray_trace import KINDS

NOISE: Final = tuple(map(KINDS.index, ("background", "afterpulse")))
"""Kinds of returns that no surface reflected."""

GIVEN: Final = ("noise_class", "classification", "noise_density", "p_value")
"""Dimensions of delivered clouds that are read where they are there."""

Points = dict[str, NDArray[Any]]
Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


def points(survey: Path, out: str = "out") -> Points:
    """Delivered returns of all flightlines by column, x, y, z in metres, with their truth."""
    parts: dict[str, list[NDArray[Any]]] = {}
    for truth in sorted((survey / "truth").glob("line_*.parquet")):
        las = laspy.read(survey / out / "laz" / "flightlines" / f"{truth.stem}.laz")
        table = pq.read_table(truth, columns=["kind", "parent"])
        columns = {name: table[name].to_numpy() for name in table.column_names}
        columns |= {axis: np.asarray(las[axis]) for axis in "xyz"}
        names = set(las.point_format.dimension_names)
        columns |= {name: np.asarray(las[name]) for name in GIVEN if name in names}
        for name, values in columns.items():
            parts.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def of(table: Points, *names: str) -> Mask:
    """Which returns are of some kinds."""
    found: Mask = np.isin(table["kind"], [KINDS.index(name) for name in names])
    return found


def echoes(table: Points, *names: str) -> Mask:
    """Which returns are afterpulses of some kinds."""
    parents = [KINDS.index(name) for name in names]
    return of(table, "afterpulse") & np.isin(table["parent"], parents)


def is_noise(table: Points) -> Mask:
    """Which returns no surface reflected."""
    found: Mask = np.isin(table["kind"], NOISE)
    return found


def share(part: Mask, of_these: Mask) -> float:
    """Percentage of some that are in a part; NaN where there are none."""
    return 100.0 * float(part[of_these].mean()) if of_these.any() else float("nan")


def raster(path: Path) -> Grid:
    """Values of a raster, north up; NaN where it has none."""
    with rasterio.open(path) as source:
        values = source.read(1).astype(np.float64)
        return np.where(values == source.nodata, np.nan, values)


def delivered(survey: Path, name: str, out: str = "out") -> Grid:
    """A delivered raster on the cells of the true ones; NaN where it has none."""
    with rasterio.open(survey / "truth" / "dtm.tif") as frame:
        bounds, shape = frame.bounds, frame.shape
    with rasterio.open(survey / out / f"{name}.tif") as source:
        window = source.window(*bounds).round_offsets().round_lengths()
        found = source.read(
            1, window=window, boundless=True, fill_value=source.nodata, out_shape=shape
        )
        return np.where(found == source.nodata, np.nan, found.astype(np.float64))


def cells(survey: Path, table: Points) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
    """Row and column of each return in the true rasters, and whether it lies in them."""
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        (rows, columns), at = source.shape, source.transform
    row = np.floor((at.f - table["y"]) / -at.e).astype(np.int64)
    column = np.floor((table["x"] - at.c) / at.a).astype(np.int64)
    inside: Mask = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return row, column, inside


def highest(survey: Path, table: Points) -> Grid:
    """Highest return of each cell of the true rasters that is no noise; -inf without any [m]."""
    row, column, inside = cells(survey, table)
    inside &= ~is_noise(table)
    top = np.full(raster(survey / "truth" / "dtm.tif").shape, -np.inf)
    np.maximum.at(top, (row[inside], column[inside]), table["z"][inside])
    return top


def around(values: Grid) -> Grid:
    """Highest value of each cell and the eight around it."""
    found: Grid = ndimage.maximum_filter(values, 3, mode="constant", cval=-np.inf)
    return found


def rms(values: Grid) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
