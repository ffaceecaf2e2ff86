"""What files declare is compared with what can be, before anything is read by it."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rasterio
import yaml
import zarr
from hypothesis import given
from hypothesis import strategies as st
from rasterio.transform import Affine

from spl_batch.altimetry.formats.photons import inspect as inspect_track
from spl_batch.altimetry.formats.terrain import sample_terrain
from spl_batch.engine.settings.workflow_file import parse_yaml
from spl_batch.errors import InputError
from spl_batch.formats.declared import BOMB_RATIO, SMALL_BYTES, bounded, refuse_bomb
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.trajectory.records import read_records
from spl_batch.geiger.coincidence import files
from spl_batch.geiger.coincidence.tables import Detections
from spl_batch.geiger.water.formats import inspect_frames
from tests.io_files import patch, write_las


@given(st.integers(), st.integers(0, 2**40), st.integers(0, 2**40))
def test_an_integer_is_in_bounds_or_an_input_fault(value: int, least: int, more: int) -> None:
    most = least + more
    if least <= value <= most:
        assert bounded("a.las", "count", value, least=least, most=most) == value
    else:
        with pytest.raises(InputError, match=r"a\.las: count is .*allowed") as caught:
            bounded("a.las", "count", value, least=least, most=most)
        assert len(str(caught.value)) < 200


@pytest.mark.parametrize("value", [1.5, None, "7", float("nan"), np.float64(3)])
def test_what_is_no_integer_is_an_input_fault(value: object) -> None:
    with pytest.raises(InputError, match="no whole number"):
        bounded("a.las", "count", value, most=9)


def test_little_may_be_dense_and_much_may_not() -> None:
    refuse_bomb("a", "rows", SMALL_BYTES, 1)
    refuse_bomb("a", "rows", BOMB_RATIO * 10**6, 10**6)
    with pytest.raises(InputError, match=r"rows would unpack to .* from 1 bytes"):
        refuse_bomb("a", "rows", SMALL_BYTES + 1, 1)


def test_a_laz_bomb_is_refused_by_its_size(tmp_path: Path) -> None:
    """A header of four thousand million points over a file of some kilobytes."""
    path = write_las(tmp_path / "a.laz", n=100)
    patch(path, 247, "Q", 2**32 - 1)
    patch(path, 107, "I", 0)
    with pytest.raises(InputError, match="points would unpack to"):
        next(iter_points(path, channel_dimension=None, source=1))


def test_an_hdf5_bomb_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name in ("delta_time", "elev", "latitude", "longitude"):
            shape, chunks = (2**36,), (2**16,)
            file.create_dataset(f"photon/channel001/{name}", shape, "f8", chunks=chunks)
    assert path.stat().st_size < 10**5
    with pytest.raises(InputError, match="would unpack to"):
        inspect_track(path)


def test_a_chunk_that_is_no_chunk_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name in ("delta_time", "elev", "latitude", "longitude"):
            dataset = f"photon/channel001/{name}"
            file.create_dataset(dataset, (10,), "f8", chunks=(2**27,), maxshape=(None,))
    with pytest.raises(InputError, match="bytes of a chunk"):
        inspect_track(path)


def test_frames_that_are_not_there_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("frames", (2**34, 4, 5), "u2", chunks=(1000, 4, 5))
    group = zarr.open_group(tmp_path / "f.zarr", mode="w")
    group.create_array("frames", shape=(2**34, 4, 5), chunks=(1000, 4, 5), dtype="u2")
    for made in (path, tmp_path / "f.zarr"):
        with pytest.raises(InputError, match="frames would unpack to"):
            inspect_frames(made, 4, 5)


def constant(path: Path, names: Any, rows: int, kinds: Any = pa.float64) -> Path:
    """A Parquet file of zeros, which take next to no room."""
    zeros = {n: pa.array(np.zeros(rows), pa.int64() if n in kinds else None) for n in names}
    pq.write_table(pa.table(zeros), path)
    return path


def test_a_parquet_bomb_is_refused_by_its_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = 1_000_000
    monkeypatch.setattr("spl_batch.formats.declared.SMALL_BYTES", 1 << 20)
    path = constant(tmp_path / "t.parquet", ("gps_time", "x", "y", "z"), rows, ())
    assert path.stat().st_size * BOMB_RATIO < 32 * rows
    with pytest.raises(InputError, match="records would unpack to"):
        next(iter(read_records(path)))
    whole = ("frame", "detector")
    path = constant(tmp_path / "d.parquet", Detections.types(), rows, whole)
    with pytest.raises(InputError, match="rows would unpack to"):
        files.inspect(path, Detections.types())


def test_a_raster_of_one_block_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "height": 9000, "width": 9000, "count": 1, "dtype": "float32"}
    layout = {"crs": "EPSG:4326", "transform": Affine(1e-3, 0, 0, 0, -1e-3, 0), "sparse_ok": True}
    with rasterio.open(path, "w", blockysize=9000, compress="deflate", **profile, **layout):
        pass
    with pytest.raises(InputError, match="bytes of a block"):
        sample_terrain(path, np.zeros(3), np.zeros(3))


NO_YAML = {
    "depth": "[" * 9000,
    "digits": "a: " + "1" * 9000,
    "a date": "a: 2001-99-99",
    "a command": "a: !!python/object/apply:os.system [ls]",
    "a key twice": "a: 1\na: 2",
}


@pytest.mark.parametrize("text", NO_YAML.values(), ids=NO_YAML)
def test_what_is_no_yaml_of_settings_is_refused(text: str) -> None:
    with pytest.raises(yaml.YAMLError):
        parse_yaml(text)
