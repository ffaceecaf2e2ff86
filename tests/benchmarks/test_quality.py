"""What the benchmark of quality counts."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from benchmarks.airborne import quality
from benchmarks.airborne.filter import methods


def write(path: Path, values: np.ndarray, west: float) -> None:
    """A raster of 1 m whose northern edge lies at 20 m."""
    path.parent.mkdir(exist_ok=True)
    profile = {"width": values.shape[1], "height": values.shape[0], "count": 1, "dtype": "float32"}
    place = {"transform": Affine(1.0, 0.0, west, 0.0, -1.0, 20.0), "crs": "EPSG:32615"}
    with rasterio.open(path, "w", driver="GTiff", **profile, **place) as out:
        out.write(values.astype(np.float32), 1)


def test_the_surface_of_clear_water_is_no_spike_and_what_stands_above_it_is(tmp_path: Path) -> None:
    ring = [[5.0, 5.0], [15.0, 5.0], [15.0, 15.0], [5.0, 15.0]]
    scene = {"origin_m": [0.0, 0.0, 0.0], "water": [{"ring_m": ring}]}
    write(tmp_path / "truth" / "dtm.tif", np.full((20, 20), 10.0), west=0.0)
    (tmp_path / "truth" / "scene.json").write_text(json.dumps({"scene": scene}))
    # The delivered raster reaches two cells farther west; of the water one return is a bottom's.
    y, x = (grid.ravel() + 0.5 for grid in np.mgrid[0:20, 0:20])
    wet = (abs(x - 10) < 5) & (abs(y - 10) < 5)
    points = {
        "x": x, "y": y, "z": np.where(wet, 8.0, 10.0),
        "kind": np.where(wet, quality.KINDS.index("bottom"), methods.GROUND),
    }  # fmt: skip
    dsm = np.full((20, 22), 10.0)
    write(tmp_path / "out" / "dsm.tif", dsm, west=-2.0)
    name = "DSM cells set by noise per 10 000"
    assert quality._spikes(tmp_path, points)[name] == 0.0
    dsm[10, 12] = dsm[1, 3] = dsm[1, 1] = 12.0  # on water, on land, beyond the scene
    write(tmp_path / "out" / "dsm.tif", dsm, west=-2.0)
    assert quality._spikes(tmp_path, points)[name] == 1e4 * 2 / 400


def test_what_is_as_high_as_the_cell_beside_it_is_no_spike_and_is_counted(tmp_path: Path) -> None:
    write(tmp_path / "truth" / "dtm.tif", np.full((20, 20), 10.0), west=0.0)
    scene = {"origin_m": [0.0, 0.0, 0.0], "water": []}
    (tmp_path / "truth" / "scene.json").write_text(json.dumps({"scene": scene}))
    y, x = (grid.ravel() + 0.5 for grid in np.mgrid[0:20, 0:20])
    # One cell is a crown's, beside it noise was taken for the crown, and one cell saw nothing.
    crown = (x == 8.5) & (y == 9.5)
    seen = (x != 3.5) | (y != 3.5)
    points = {
        "x": x,
        "y": y,
        "z": np.where(crown, 20.0, 10.0),
        "kind": np.full(400, methods.GROUND),
    }
    dsm = np.full((20, 20), 10.0)
    dsm[10, 8] = dsm[10, 9] = 20.0
    write(tmp_path / "out" / "dsm.tif", dsm, west=0.0)
    found = quality._spikes(tmp_path, {name: values[seen] for name, values in points.items()})
    assert found["DSM cells set by noise per 10 000"] == 0.0
    assert found["DSM cells above their own returns per 10 000"] == pytest.approx(1e4 / 399)
