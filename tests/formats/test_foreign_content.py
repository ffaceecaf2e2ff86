"""A file that sends its content elsewhere is refused: a run reads what a user has named."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from pyproj import CRS

from spl_batch.altimetry.formats.photons import inspect as inspect_track
from spl_batch.altimetry.formats.terrain import sample_terrain
from spl_batch.errors import InputError
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.checkpoints import read_checkpoints
from spl_batch.formats.vector_files import read_polygons
from spl_batch.geiger.water.formats import inspect_frames
from tests.altimetry.tracks import small_track, write_atl03

UTM = CRS.from_epsg(32615)
POLYGON = (
    '{"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates":'
    " [[[0, 0, 1], [0, 9, 1], [9, 9, 1], [0, 0, 1]]]}}"
)
REFERRING = {
    "VRT": '<?xml version="1.0"?>\n<OGRVRTDataSource><OGRVRTLayer name="secret">'
    "<SrcDataSource>{secret}</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>",
    "service": "<OGRWFSDataSource><URL>http://127.0.0.1:9/</URL></OGRWFSDataSource>",
    "pipeline": '{{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline read'
    ' {secret}"}}',
}


@pytest.mark.parametrize("kind", REFERRING)
@pytest.mark.parametrize("read", [read_polygons, read_breaklines, read_checkpoints])
def test_a_vector_file_that_names_another_is_refused(
    tmp_path: Path, kind: str, read: Callable[[Path, CRS], Any]
) -> None:
    secret = tmp_path / "secret.geojson"
    secret.write_text(POLYGON)
    path = tmp_path / "aoi.gpkg"
    path.write_text(REFERRING[kind].format(secret=secret))
    with pytest.raises(InputError, match="names where GDAL finds some"):
        read(path, UTM)


def test_a_raster_that_names_another_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dtm.tif"
    path.write_text(
        '<VRTDataset rasterXSize="4" rasterYSize="4"><SRS>EPSG:4326</SRS><GeoTransform>0, 1, 0,'
        ' 0, 0, -1</GeoTransform><VRTRasterBand dataType="Float32" band="1"/></VRTDataset>'
    )
    with pytest.raises(InputError, match="names where GDAL finds some"):
        sample_terrain(path, np.full(2, -1.5), np.full(2, 1.5))


def linked(file: h5py.File, name: str, other: Path) -> None:
    file[name] = h5py.ExternalLink(str(other), name)


def virtual(file: h5py.File, name: str, other: Path) -> None:
    with h5py.File(other) as source:
        shape, dtype = source[name].shape, source[name].dtype
    layout = h5py.VirtualLayout(shape, dtype)
    layout[...] = h5py.VirtualSource(str(other), name, shape)
    file.create_virtual_dataset(name, layout)


def external(file: h5py.File, name: str, other: Path) -> None:
    with h5py.File(other) as source:
        shape, dtype = source[name].shape, source[name].dtype
    file.create_dataset(name, shape, dtype, external=[(str(other), 0, h5py.h5f.UNLIMITED)])


@pytest.mark.parametrize("harm", [linked, virtual, external])
@pytest.mark.parametrize("name", ["gt1r/heights/h_ph", "gt1r/geolocation/segment_ph_cnt"])
def test_photons_of_another_file_are_refused(
    tmp_path: Path, harm: Callable[[h5py.File, str, Path], None], name: str
) -> None:
    path, other = (write_atl03(tmp_path / n, {"gt1r": small_track()}) for n in ("a.h5", "b.h5"))
    inspect_track(path)
    with h5py.File(path, "r+") as file:
        del file[name]
        harm(file, name, other)
    with pytest.raises(InputError, match=f"{name} lies in another file: copy its values"):
        inspect_track(path)


@pytest.mark.parametrize("harm", [linked, virtual, external])
def test_frames_of_another_file_are_refused(
    tmp_path: Path, harm: Callable[[h5py.File, str, Path], None]
) -> None:
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["frames"] = np.ones((9, 4, 5), np.uint16)
    path = tmp_path / "frames.h5"
    with h5py.File(path, "w") as file:
        harm(file, "frames", other)
    with pytest.raises(InputError, match="frames lies in another file"):
        inspect_frames(path, 4, 5)
