"""Reading LAS and LAZ: laspy reads the same files, coordinates are exact."""

import struct
from decimal import Decimal
from pathlib import Path

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.errors import InputError
from spl_batch.formats.las.chunks import CHUNK_SIZE_AT
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.units import Units
from spl_batch.lattice.tables import COLUMNS, SOURCE_COLUMNS, PointFlag, PointTable, concat
from tests.io_files import VERSIONS, patch, write_las


def read_all(path: Path, **given: object) -> PointTable:
    settings_ = {"channel_dimension": None, "source": 7, **given}
    return concat(list(iter_points(path, **settings_)), SOURCE_COLUMNS)  # type: ignore[arg-type]


def exact_quanta(raw: int, scale: float, offset: float) -> Decimal:
    """What a coordinate is, in decimal arithmetic without rounding [quanta]."""
    return (Decimal(str(scale)) * int(raw) + Decimal(str(offset))) * 1000


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize(("version", "point_format"), VERSIONS)
def test_every_version_and_point_format(
    tmp_path: Path, version: str, point_format: int, suffix: str
) -> None:
    path = write_las(tmp_path / f"a{suffix}", version=version, point_format=point_format)
    facts, table, oracle = inspect(path), read_all(path), laspy.read(path)
    assert (facts.version, facts.point_format) == (
        tuple(map(int, version.split("."))),
        point_format,
    )
    assert facts.n_points == len(table) == 1000
    assert facts.dimensions == tuple(oracle.point_format.dimension_names)
    assert facts.has_gps_time == ("gps_time" in facts.dimensions)
    for axis, name in enumerate("XYZ"):
        scale, offset = oracle.header.scales[axis], oracle.header.offsets[axis]
        expected = [int(exact_quanta(v, scale, offset)) for v in oracle[name]]
        np.testing.assert_array_equal(table[name.lower()], expected)
    assert {k: table[k].dtype for k in SOURCE_COLUMNS} == {
        k: np.dtype(COLUMNS[k].dtype) for k in SOURCE_COLUMNS
    }
    for name in ("return_number", "intensity", "point_source_id"):
        np.testing.assert_array_equal(table[name], oracle[name])
    np.testing.assert_array_equal(table["input_class"], oracle.classification)
    np.testing.assert_array_equal(table["index"], np.arange(1000))
    assert set(table["source"].tolist()) == {7}
    assert set(table["channel"].tolist()) == {0}
    withheld = np.asarray(oracle.withheld, dtype=bool)
    noise = np.isin(oracle.classification, (7, 18))
    np.testing.assert_array_equal(table.has(PointFlag.WITHHELD), withheld)
    np.testing.assert_array_equal(table.has(PointFlag.VENDOR_NOISE), noise)
    time = oracle.gps_time if facts.has_gps_time else np.full(1000, np.nan)
    np.testing.assert_array_equal(table["gps_time"], time)
    angle = oracle.scan_angle_rank if point_format < 6 else np.asarray(oracle.scan_angle) * 0.006
    np.testing.assert_allclose(table["scan_angle"], angle, rtol=1e-6)


def test_chunk_size_zero_is_that_of_the_table(tmp_path: Path) -> None:
    columns = {name: np.arange(30_000, dtype=COLUMNS[name].dtype) for name in ("x", "y", "z")}
    path = tmp_path / "a.laz"
    write_points(path, PointTable(columns), crs=None, copc=True)
    expected = read_all(path)
    at = path.read_bytes().index(b"laszip encoded") - 2 + 54 + CHUNK_SIZE_AT
    table = read_all(patch(path, at, "I", 0))
    assert set(table["z"].tolist()) == set(range(30_000))
    np.testing.assert_array_equal(table["x"], expected["x"])


@pytest.mark.parametrize("point_format", [1, 6])
def test_a_stream_has_the_offset_of_its_chunk_table_at_its_end(
    tmp_path: Path, point_format: int
) -> None:
    path = write_las(tmp_path / "a.laz", n=60_000, point_format=point_format)
    expected, content = read_all(path), path.read_bytes()
    start = struct.unpack_from("<I", content, 96)[0]
    path.write_bytes(content + content[start : start + 8])
    table = read_all(patch(path, start, "q", -1))
    np.testing.assert_array_equal(table["x"], expected["x"])


@settings(max_examples=60, deadline=None)
@given(
    raw=st.lists(st.integers(-(2**31) + 1, 2**31 - 2), min_size=1, max_size=20),
    step=st.sampled_from([0.001, 0.002, 0.01, 0.05, 0.1]),
    offset_mm=st.integers(-(10**9), 10**9),
)
def test_whole_millimetres_are_exact(
    tmp_path_factory: pytest.TempPathFactory, raw: list[int], step: float, offset_mm: int
) -> None:
    path = tmp_path_factory.mktemp("las") / "a.las"
    offset = offset_mm / 1000
    write_las(
        path,
        n=len(raw),
        scales=(step, step, 0.001),
        offsets=(offset, -offset, 0.0),
        values={"X": raw, "Y": raw, "Z": np.zeros(len(raw), int)},
    )
    table = read_all(path)
    assert inspect(path).rounding == ()
    assert table["x"].tolist() == [int(exact_quanta(v, step, offset)) for v in raw]
    assert table["y"].tolist() == [int(exact_quanta(v, step, -offset)) for v in raw]


def test_mixed_and_fine_scales_are_rounded_and_reported(tmp_path: Path) -> None:
    path = write_las(tmp_path / "a.laz", scales=(0.00025, 0.01, 0.001), offsets=(0.0005, 1.0, 2.0))
    table, oracle = read_all(path), laspy.read(path)
    error = table["x"] - np.asarray(oracle.x) * 1000
    assert 0.2 < np.abs(error).max() <= 0.5 + 1e-6
    np.testing.assert_array_equal(table["y"], np.asarray(oracle.Y, np.int64) * 10 + 1000)
    found = inspect(path)
    (remark,) = found.rounding
    assert found.warnings == found.in_metres(Units("US survey foot", 0.3048, "metre", 1.0)).rounding
    assert remark.startswith("the scale (0.00025, 0.01, 0.001) is not whole millimetres")
    for offset in (0.0005, 7.0001):
        (remark,) = inspect(write_las(tmp_path / "b.laz", offsets=(offset, 1.0, 2.0))).rounding
        assert remark.startswith("the offset is not whole millimetres: working coordinates are")


@pytest.mark.parametrize("point_format", [1, 6])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_any_range_equals_the_whole(tmp_path: Path, point_format: int, suffix: str) -> None:
    n = 120_000
    path = write_las(tmp_path / f"a{suffix}", point_format=point_format, n=n)
    whole = read_all(path)
    for start, stop in [(0, 1), (49_999, 50_001), (50_000, 100_000), (7, 119_000), (n - 1, n)]:
        part = read_all(path, start=start, stop=stop, chunk=33_333)
        for name in SOURCE_COLUMNS:
            np.testing.assert_array_equal(part[name], whole[name][start:stop])
    assert len(read_all(path, start=n)) == 0
    assert len(read_all(path, start=n - 5, stop=n + 10**9)) == 5


def test_channel_from_standard_and_extra_dimensions(tmp_path: Path) -> None:
    channel = np.arange(1000) % 101
    path = write_las(
        tmp_path / "a.laz",
        extra={"beam": "i2", "share": "f4", "pair": "2u1"},
        values={"user_data": channel, "beam": channel, "share": channel},
    )
    for name in ("user_data", "beam", "share"):
        table = read_all(path, channel_dimension=name)
        np.testing.assert_array_equal(table["channel"], channel)
    with pytest.raises(InputError, match="2 values a point"):
        read_all(path, channel_dimension="pair")
    with pytest.raises(InputError, match=r"no dimension 'channel'.*user_data.*beam"):
        read_all(path, channel_dimension="channel")


@pytest.mark.parametrize("wrong", [-1, 256, 0.5, float("nan")])
def test_channel_that_is_no_channel(tmp_path: Path, wrong: float) -> None:
    beam = np.zeros(1000)
    beam[613] = wrong
    path = write_las(tmp_path / "a.las", extra={"beam": "f8"}, values={"beam": beam})
    with pytest.raises(InputError, match="point 613"):
        read_all(path, channel_dimension="beam", chunk=100)


def test_scaled_extra_dimension(tmp_path: Path) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.add_extra_dim(laspy.ExtraBytesParams("beam", "u2", "", np.array([5.0]), np.array([0.5])))
    points = laspy.ScaleAwarePointRecord.zeros(40, header=header)
    points["beam"] = np.arange(40) * 2 + 5
    with laspy.open(tmp_path / "a.las", mode="w", header=header) as writer:
        writer.write_points(points)
    table = read_all(tmp_path / "a.las", channel_dimension="beam")
    np.testing.assert_array_equal(table["channel"], np.arange(40) * 2 + 5)


@pytest.mark.parametrize("counted", [False, True])
def test_las_1_0_is_read_behind_its_start_signature(tmp_path: Path, *, counted: bool) -> None:
    path = write_las(tmp_path / "a.las", version="1.2", point_format=1)
    want, content = read_all(path), bytearray(path.read_bytes())
    start = struct.unpack_from("<I", content, 96)[0]
    content[25] = 0
    content[start:start] = b"\xdd\xcc"
    struct.pack_into("<I", content, 96, start if counted else start + 2)
    path.write_bytes(content)
    got = read_all(path)
    for name in "xyz":
        np.testing.assert_array_equal(got[name], want[name])
