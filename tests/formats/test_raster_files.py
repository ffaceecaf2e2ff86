"""GeoTIFFs and the working raster store."""

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.store.raster_cells import stored_blocks, write_cell
from spl_batch.constants import NODATA
from spl_batch.engine.store.working_store import Store
from spl_batch.errors import InputError
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds

LAYOUT = {"origin_xy_m": (500_000.0, 4_000_000.0), "cell_m": 0.5, "description": "dtm", "unit": "m"}


def sample(rows, cols):
    values = np.random.default_rng(1).normal(100, 5, (rows, cols)).astype(np.float32)
    values[: rows // 3, : cols // 2] = NODATA
    return values


def test_a_cog_has_the_layout_values_and_transform(tmp_path):
    values = sample(700, 600)
    path = tmp_path / "deep" / "dtm.tif"
    write_cog(path, values, shape=values.shape, crs="EPSG:32615", **LAYOUT)
    with rasterio.open(path) as source:
        np.testing.assert_array_equal(source.read(1), values)
        assert tuple(source.transform)[:6] == (0.5, 0, 500_000, 0, -0.5, 4_000_000)
        assert source.crs.to_epsg() == 32615
        assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert source.profile["compress"] == "deflate"
        assert source.block_shapes == [(256, 256)]
        assert source.nodata == NODATA
        assert source.dtypes == ("float32",)
        assert source.descriptions == ("dtm",)
        assert source.units == ("m",)
        assert source.overviews(1) == [2, 4]
        half = source.read(1, out_shape=(350, 300))
    blocks = values.reshape(350, 2, 300, 2).swapaxes(1, 2).reshape(350, 300, 4).astype(float)
    known = (blocks != NODATA).all(axis=2)
    np.testing.assert_allclose(half[known], blocks[known].mean(axis=1), rtol=1e-5)
    assert (half[(blocks == NODATA).all(axis=2)] == NODATA).all()
    assert [p.name for p in path.parent.iterdir()] == ["dtm.tif"]


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (200, 200)])
def test_small_rasters_have_an_overview_too(tmp_path, shape):
    path = tmp_path / "a.tif"
    write_cog(path, np.ones(shape, np.float32), shape=shape, crs=None, **LAYOUT)
    with rasterio.open(path) as source:
        assert len(source.overviews(1)) == 1
        assert source.crs is None
        assert (source.read(1) == 1).all()


def test_pieces_in_any_order_give_the_same_bytes(tmp_path):
    values = sample(300, 500)
    whole, pieces = tmp_path / "whole.tif", tmp_path / "pieces.tif"
    write_cog(whole, values, shape=values.shape, crs="EPSG:32615", **LAYOUT)
    corners = [(r, c) for r in range(0, 300, 70) for c in range(0, 500, 70)]
    np.random.default_rng(0).shuffle(corners)
    blocks = ((r, c, values[r : r + 70, c : c + 70]) for r, c in corners)
    write_cog(pieces, blocks, shape=values.shape, crs="EPSG:32615", **LAYOUT)
    assert whole.read_bytes() == pieces.read_bytes()


def test_what_no_piece_covers_is_nodata(tmp_path):
    path = tmp_path / "a.tif"
    blocks = [(5, 7, np.ones((2, 2), np.float32))]
    write_cog(path, blocks, shape=(20, 20), crs=None, **LAYOUT)
    with rasterio.open(path) as source:
        values = source.read(1)
    assert (values[5:7, 7:9] == 1).all()
    assert (values == NODATA).sum() == 396


def test_a_crs_that_nobody_knows_is_named(tmp_path):
    with pytest.raises(InputError, match="EPSG:1234567"):
        write_cog(tmp_path / "a", np.ones((2, 2)), shape=(2, 2), crs="EPSG:1234567", **LAYOUT)


def test_a_cell_comes_back_at_its_position(tmp_path):
    store, values = Store(tmp_path), sample(10, 10)
    for cell in (CellId(-3, 5), CellId(40_000, 600_000)):
        around = cell_bounds(cell, 10_000)
        written = write_cell(store, str(cell), around, {"dtm": values, "dsm": values + 1})
        assert len(written) == 2
        part = Bounds(around.xmin + 4000, around.ymin + 3000, around.xmax - 2000, around.ymax)
        ((row, col, block),) = stored_blocks(store, "dsm", [str(cell)], part)
        np.testing.assert_array_equal(block, values[:7, 4:8] + 1)
        assert (row, col) == (0, 0)


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), unique=True, max_size=8))
@settings(max_examples=10, deadline=None)
def test_a_mosaic_of_cells_equals_the_window(tmp_path_factory, corners):
    store = Store(tmp_path_factory.mktemp("store"))
    cells = [CellId(*corner) for corner in corners]
    for k, cell in enumerate(cells):
        values = np.full((3, 3), k, np.float32)
        write_cell(store, str(cell), cell_bounds(cell, 3000), {"dtm": values})
    bounds = Bounds(-7000, -5000, 8000, 4000)
    mosaic = np.full((9, 15), NODATA, np.float32)
    for row, col, block in stored_blocks(store, "dtm", map(str, cells), bounds):
        mosaic[row : row + block.shape[0], col : col + block.shape[1]] = block
    expected = np.full((21, 21), NODATA, np.float32)  # of the squares from -3 to 3
    for k, (i, j) in enumerate(corners):
        row, col = 3 * (3 - j), 3 * (i + 3)
        expected[row : row + 3, col : col + 3] = k
    np.testing.assert_array_equal(mosaic, expected[8:17, 2:17])


def test_a_raster_knows_its_statistics_whatever_the_order_of_its_pieces(tmp_path):
    values = np.random.default_rng(4).normal(300, 20, (40, 60)).astype(np.float32)
    values[3:9, 5:20] = NODATA
    pieces = [(0, 0, values[:, :25]), (0, 25, values[:, 25:])]
    write_cog(tmp_path / "a.tif", pieces, shape=values.shape, crs=None, **LAYOUT)
    write_cog(tmp_path / "b.tif", pieces[::-1], shape=values.shape, crs=None, **LAYOUT)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
    with rasterio.open(tmp_path / "a.tif") as source:
        tags = source.tags(1)
    known = values[values != NODATA].astype(np.float64)
    for key, wanted in (
        ("MINIMUM", known.min()),
        ("MAXIMUM", known.max()),
        ("MEAN", known.mean()),
        ("STDDEV", known.std()),
        ("VALID_PERCENT", 100 * known.size / values.size),
    ):
        assert float(tags[f"STATISTICS_{key}"]) == pytest.approx(wanted, rel=1e-3)
