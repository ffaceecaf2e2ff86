"""Photon files of every layout, and what is reported of those that are wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
import rasterio
from rasterio import Affine

from spl_batch.altimetry.formats import atl08 as atl08_io
from spl_batch.altimetry.formats.atl08 import find_labels, terrain_heights
from spl_batch.altimetry.formats.photons import Photons, inspect, iter_photons
from spl_batch.altimetry.formats.terrain import sample_terrain
from spl_batch.altimetry.formats.track_csv import check_unit, read_profile
from spl_batch.altimetry.simulate import SceneFile, Track, TrackScene, simulate
from spl_batch.altimetry.tasks.index import _Cells
from spl_batch.errors import InputError
from tests.altimetry.tracks import (
    ORIGIN_M,
    SEGMENT_M,
    photons_of,
    small_track,
    write_atl03,
    write_atl08,
    write_csv,
)


def whole(path: Path, layout: str, beam: str, chunk: int = 1000) -> Photons:
    parts = list(iter_photons(path, layout, beam, chunk))  # type: ignore[arg-type]
    assert layout == "csv" or all(p.read <= chunk for p in parts)
    columns = [
        np.concatenate([getattr(p, name) for p in parts])
        for name in ("row", "along", "height", "latitude", "longitude")
    ]
    return Photons(*columns, read=sum(p.read for p in parts))


def test_atl03_photons_lie_where_their_segments_are(tmp_path: Path) -> None:
    track = small_track()
    path = write_atl03(tmp_path / "atl03.h5", {"gt1r": track, "gt2l": small_track(2)})
    file = inspect(path)
    assert file.layout == "atl03"
    assert [b.name for b in file.beams] == ["gt1r", "gt2l"]
    photons = whole(path, "atl03", "gt1r")
    along, height = photons_of(track)
    np.testing.assert_array_equal(photons.row, np.arange(len(along)))
    assert np.abs(photons.along - along - round(ORIGIN_M * 1000)).max() <= 2, "float32 within 20 m"
    assert np.abs(photons.height - height).max() <= 1


def test_mabel_photons_lie_where_their_times_are(tmp_path: Path) -> None:
    scene = SceneFile(kind="altimetry", track=TrackScene(length_m=500.0, noise_per_m2=0.005))
    made = simulate(scene, tmp_path)
    path = tmp_path / "track.h5"
    file = inspect(path)
    assert file.layout == "mabel"
    assert [b.name for b in file.beams] == [name for name, _ in made.rows]
    photons = whole(path, "mabel", "channel006")
    with h5py.File(path) as stored:
        north = stored["photon/channel006/latitude"][()] * 110_574.0
    assert np.abs(photons.along / 1000 - north).max() < 0.2


def test_csv_columns_are_found_by_name(tmp_path: Path) -> None:
    track = small_track()
    path = write_csv(tmp_path / "photons.csv", track)
    photons = whole(path, "csv", "track")
    along, height = photons_of(track)
    np.testing.assert_array_equal(photons.along, along)
    np.testing.assert_array_equal(photons.height, height)
    assert inspect(path).beams[0].photons == pytest.approx(len(along), rel=0.2)


class Granule(NamedTuple):
    """A track in ATL03, what ATL08 has of it, and ATL08 of another day."""

    track: Track
    atl03: Path
    atl08: Path
    other: Path


@pytest.fixture
def granule(tmp_path: Path) -> Granule:
    track = small_track()
    atl03 = write_atl03(tmp_path / "atl03.h5", {"gt1r": track})
    atl08, other = (
        write_atl08(tmp_path / f"{name}.h5", atl03, {"gt1r": track}) for name in ("atl08", "other")
    )
    with h5py.File(other, "r+") as file:
        for group in ("land_segments", "signal_photons"):
            file[f"gt1r/{group}/delta_time"][:] += 86_400.0
        file["gt1r/signal_photons/classed_pc_flag"][:] = 0
    return Granule(track, atl03, atl08, other)


def test_heights_of_atl08_stand_where_their_segments_are(granule: Granule) -> None:
    track, atl03, atl08, other = granule
    assert len(terrain_heights(atl03, [other], "gt1r")) == 0
    assert len(terrain_heights(atl03, [], "gt1r")) == 0
    found = terrain_heights(atl03, [other, atl08], "gt1r")
    at = found[:, 0] - ORIGIN_M
    steps = np.diff(at) / SEGMENT_M
    assert set(np.rint(steps).tolist()) == {1.0, 2.0}, "what is unknown is left out"
    expected = np.interp(at, *track.reference_m.T)
    np.testing.assert_allclose(found[:, 1], expected, atol=1e-3)
    with h5py.File(atl08, "r+") as file:
        del file["gt1r/land_segments/terrain/h_te_best_fit_20m"]
    coarse = terrain_heights(atl03, [atl08], "gt1r")
    assert np.rint(np.diff(coarse[:, 0]) / SEGMENT_M).tolist() == [5.0] * (len(coarse) - 1)
    expected = np.interp(coarse[:, 0] - ORIGIN_M, *track.reference_m.T)
    np.testing.assert_allclose(coarse[:, 1], expected, atol=1e-3)


@pytest.mark.parametrize("order", ["as it is", "mixed"])
def test_atl08_labels_what_is_signal(
    granule: Granule, order: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atl08_io, "SLICE_PHOTONS", 97)
    track, atl03, atl08, other = granule
    with h5py.File(atl08, "r+") as file:
        for column in file["gt1r/signal_photons"].values() if order == "mixed" else ():
            column[:] = np.random.default_rng(5).permutation(column[()])
    found = find_labels(atl03, [atl08], "gt1r")
    assert found is not None
    stop = found.first + len(found.signal)
    assert stop - found.first > 0.9 * len(track.truth)
    np.testing.assert_array_equal(found.signal, track.truth[found.first : stop] > 0)
    assert find_labels(atl03, [], "gt1r") is None
    assert find_labels(atl03, [other], "gt1r") is None
    again = find_labels(atl03, [other, atl08], "gt1r")
    assert again is not None
    np.testing.assert_array_equal(again.signal, found.signal)


def test_terrain_is_read_between_cell_centres(tmp_path: Path) -> None:
    path = tmp_path / "dtm.tif"
    rows, columns = np.mgrid[0:700, 0:600]
    plane = (1000.0 + 2.0 * columns - 3.0 * rows).astype(np.float32)
    plane[650, 30] = -9999.0
    with rasterio.open(
        path, "w", driver="GTiff", height=700, width=600, count=1, dtype="float32",
        crs="EPSG:4326", transform=Affine(0.001, 0.0, 10.0, 0.0, -0.001, 50.0), nodata=-9999.0,
    ) as raster:  # fmt: skip
        raster.write(plane, 1)
    column, row = np.array([3.25, 511.5, 512.0, 598.9]), np.array([2.5, 511.75, 600.0, 698.9])
    longitude, latitude = 10.0 + (column + 0.5) * 0.001, 50.0 - (row + 0.5) * 0.001
    found = sample_terrain(path, latitude, longitude)
    np.testing.assert_allclose(found, 1000.0 + 2.0 * column - 3.0 * row, atol=1e-3)
    outside = sample_terrain(path, np.array([51.0, np.nan, 50.0 - 650.5e-3]), np.full(3, 10.0305))
    assert np.isnan(outside).all()


def _shorten(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _with(name: str, change: Callable[[np.ndarray], np.ndarray] | None) -> Callable[[Path], None]:
    """Replace a dataset, or drop it."""

    def apply(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            values = file[name][()]
            del file[name]
            if change is not None:
                file[name] = change(values)

    return apply


def _more(first: int, last: int) -> Callable[[np.ndarray], np.ndarray]:
    """Photons by segment that add up as they did, modulo 2^64 at the least."""
    return lambda count: np.r_[count[0] + first, count[1:-1], count[-1] + last]


def _wrapping(count: np.ndarray) -> np.ndarray:
    count = count.astype(np.uint64)
    count[[0, -1]] += np.uint64(2**63)
    return count


def _nothing(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_group("orbit_info")


HEIGHT, FIRST_PHOTONS = "gt1r/heights/h_ph", "gt1r/geolocation/segment_ph_cnt"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_shorten, "damaged HDF5"),
        (lambda path: path.write_text("no photons"), "is no HDF5 file"),
        (_with(HEIGHT, None), f"no dataset {HEIGHT}"),
        (_with(FIRST_PHOTONS, None), f"no dataset {FIRST_PHOTONS}"),
        (_with(FIRST_PHOTONS, _more(3, 0)), "subset it again"),
        (_with(FIRST_PHOTONS, _more(-1000, 1000)), "segment_ph_cnt is -"),
        (_with(FIRST_PHOTONS, _wrapping), "segment_ph_cnt is 9223372036854"),
        (_with(FIRST_PHOTONS, lambda count: count + 0.5), "segment_ph_cnt holds float64"),
        (_nothing, "neither gtxx/heights"),
        (_with("gt1r/heights/lat_ph", lambda values: values[:-1]), "differ in length"),
    ],
)
def test_a_wrong_hdf5_file_is_named_in_one_line(
    tmp_path: Path, change: Callable[[Path], None], words: str
) -> None:
    path = write_atl03(tmp_path / "atl03.h5", {"gt1r": small_track()})
    change(path)
    with pytest.raises(InputError, match=words) as caught:
        inspect(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_track_in_kilometres_or_degrees_is_refused() -> None:
    path = Path("track.csv")
    for photons, length_m in ((6000, 15.0), (900, 0.01)):
        check_unit(path, photons, length_m)
    for length_m in (3.0, 0.0):
        with pytest.raises(InputError, match=r"along_track has 6000 photons on .*not in metres"):
            check_unit(path, 6000, length_m)


def test_the_length_of_a_track_is_that_of_the_cells_that_hold_photons() -> None:
    cells = _Cells(20_000)
    assert cells.length_m() == 0.0
    for along in (np.array([100, 2_900]), np.array([500, 900_000_000])):
        unknown = np.full(2, np.nan)
        cells.add(Photons(np.arange(2), along, along.astype(np.int32), unknown, unknown, read=2))
    assert cells.length_m() == 40.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "x,z\n1,2\n",
            "no column along_track and height .* rename its columns to along_track,height",
        ),
        (
            "along_track,height\n1,high\n",
            r"column height, line 2: 'high' is no number; write numbers",
        ),
        ("along_track,height\n1,2e7\n", "at most 20000 m"),
        ("along_track;height\n1;2\n", "with commas between"),
    ],
)
def test_a_wrong_csv_file_is_named_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "photons.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        list(iter_photons(path, inspect(path).layout, "track", 100))
    assert "\n" not in str(caught.value)


def test_a_reference_of_one_height_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "reference.csv"
    path.write_text("along_track,height\n1,2\n")
    with pytest.raises(InputError, match="at least 2"):
        read_profile(path)
