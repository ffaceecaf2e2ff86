"""Heights above a geoid, against bilinear interpolation in a grid written by hand."""

import struct
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import compound
from spl_batch.formats.geoid import Geoid

UTM = CRS.from_epsg(32615)
SOUTH, WEST, STEP = 29.0, -96.0, 0.25
NODES = np.random.default_rng(7).normal(-27, 1, (9, 13)).astype(">f4")


def write_grid(path: Path) -> str:
    """A grid in NOAA's GTX format: corner, steps, size, rows from the south."""
    rows, columns = NODES.shape
    path.write_bytes(struct.pack(">4d2i", SOUTH, WEST, STEP, STEP, rows, columns) + NODES.tobytes())
    return path.name


def by_hand(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    east, north = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(x, y)
    i, j = (north - SOUTH) / STEP, (east - WEST) / STEP
    row, col = np.floor(i).astype(int), np.floor(j).astype(int)
    u, v, n = i - row, j - col, NODES.astype(float)
    low = n[row, col] * (1 - v) + n[row, col + 1] * v
    high = n[row + 1, col] * (1 - v) + n[row + 1, col + 1] * v
    return low * (1 - u) + high * u


def test_heights_are_those_of_the_grid_and_void_beyond(tmp_path: Path) -> None:
    name = write_grid(tmp_path / "a geoid.gtx")
    geoid = Geoid(name, tmp_path / name, UTM)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(230_000, 480_000, 200), rng.uniform(3_215_000, 3_400_000, 200)
    np.testing.assert_allclose(geoid.heights(x, y), by_hand(x, y), atol=1e-5)
    assert np.isnan(geoid.heights(np.array([9e5]), np.array([3.3e6]))).all()
    assert geoid.crs_above("EPSG:5703").sub_crs_list[1].to_epsg() == 5703
    assert geoid.crs_above(None).equals(UTM)


def test_heights_of_which_the_unit_alone_is_known_may_be_above_the_ellipsoid(
    tmp_path: Path,
) -> None:
    name = write_grid(tmp_path / "a.gtx")
    for heights, taken in (("unknown", True), ("User-Defined", True), ("County heights", False)):
        text = f'VERT_CS["{heights}",VERT_DATUM["unknown",2005],UNIT["metre",1]]'
        crs = compound(UTM, CRS(text))
        if taken:
            above = Geoid(name, tmp_path / name, crs).crs_above("EPSG:5703")
            assert above.sub_crs_list[1].to_epsg() == 5703
        else:
            with pytest.raises(WorkflowError, match=f"already '{heights}'"):
                Geoid(name, tmp_path / name, crs)


@pytest.mark.parametrize("grid", ["nowhere.gtx", "@nowhere.gtx", "a.gtx,b.gtx", "broken.gtx"])
def test_a_grid_that_is_not_there_is_named(tmp_path: Path, grid: str) -> None:
    (tmp_path / "broken.gtx").write_bytes(b"no grid")
    with pytest.raises(WorkflowError, match=r"outputs\.geoid\.grid: .*gtx is no"):
        Geoid(grid, tmp_path / grid, UTM)


@pytest.mark.parametrize("datum", ["5703", "5773"])
def test_heights_above_a_geoid_are_not_taken_above_another(tmp_path: Path, datum: str) -> None:
    name = write_grid(tmp_path / "a.gtx")
    with pytest.raises(WorkflowError, match=r"already .* height.*leave outputs\.geoid out"):
        Geoid(name, tmp_path / name, CRS.from_user_input(f"EPSG:32615+{datum}"))
