"""Writing: nothing of the input is lost, laspy reads it, the same input gives the same bytes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.crs import CompoundCRS

from spl_batch.constants import US_FOOT_M
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats.crs import horizontal, vertical
from spl_batch.formats.gps_clock import TimeStandard
from spl_batch.formats.las.convert import EXTENDED_FORMAT
from spl_batch.formats.las.copc import copy_as_copc
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.known_records import broken_records, header_crs
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.las.writer import write_classified, write_points
from spl_batch.formats.units import Units, in_words
from spl_batch.lattice.tables import SOURCE_COLUMNS, PointTable, concat
from tests.io_files import VERSIONS, keys_record, patch, wkt_record, write_las

UTM = ((1024, 1), (3072, 32615))
"""Keys of UTM 15 N."""


def labels(start: int, stop: int) -> Mapping[str, NDArray[Any]]:
    """Labels that differ from point to point and do not depend on the cut."""
    i = np.arange(start, stop)
    return {
        "classification": np.array([1, 2, 7, 18, 255], np.uint8)[i % 5],
        "noise_class": np.array([0, 1, 2, 255], np.uint8)[i % 4],
        "noise_density": (i / 1000).astype(np.float32),
        "p_value": (1 / (i + 1)).astype(np.float32),
    }


def classify(src: Path, dst: Path, **given: Any) -> int:
    return write_classified(
        src, dst, **{"labels": labels, "diagnostics": True, "crs": None, **given}
    )


def assert_kept(before: laspy.LasData, after: laspy.LasData) -> None:
    """Every dimension of the input is in the output, bit by bit."""
    for name in before.point_format.dimension_names:
        if name not in {"classification", "scan_angle_rank"}:
            x, y = before.points[name], after.points[name]
            np.testing.assert_array_equal(np.asarray(x), np.asarray(y), err_msg=name)
    np.testing.assert_array_equal(after["input_classification"], before.classification)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize(("version", "point_format"), VERSIONS)
def test_every_version_and_point_format(
    tmp_path: Path, version: str, point_format: int, suffix: str
) -> None:
    extra = {"height": "f8", "beam": "u1", "pair": "2i4"}
    src = write_las(
        tmp_path / f"a{suffix}", version=version, point_format=point_format, extra=extra
    )
    dst = tmp_path / "out" / "a.laz"
    assert classify(src, dst) == 1000
    before, after = laspy.read(src), laspy.read(dst)
    assert_kept(before, after)
    assert after.header.version == "1.4"
    assert after.header.are_points_compressed == (after.header.point_format.id < 9)
    assert after.header.point_format.id == EXTENDED_FORMAT.get(point_format, point_format)
    if point_format < 6:
        np.testing.assert_array_equal(
            np.rint(np.asarray(after.scan_angle) * 0.006), before.scan_angle_rank
        )
        np.testing.assert_array_equal(after.overlap, np.asarray(before.classification) == 12)
    for name in ("scales", "offsets", "mins", "maxs"):
        np.testing.assert_array_equal(getattr(after.header, name), getattr(before.header, name))
    by_return = np.bincount(before.return_number, minlength=16)[1:]
    np.testing.assert_array_equal(after.header.number_of_points_by_return, by_return)
    expected = labels(0, 1000)
    given, old = expected["classification"], before.classification
    np.testing.assert_array_equal(after.classification, np.where(given == 255, old, given))
    for name in ("noise_class", "noise_density", "p_value"):
        np.testing.assert_array_equal(after[name], expected[name])


def test_header_is_kept_and_nothing_depends_on_the_clock(tmp_path: Path) -> None:
    src = write_las(tmp_path / "a.las", version="1.2", point_format=1)
    patch(src, 4, "HH", 77, 1)
    patch(src, 8, "16s", bytes(range(16)))
    patch(src, 26, "32s", b"scanner")
    patch(src, 90, "HH", 123, 2017)
    classify(src, tmp_path / "b.laz")
    header = laspy.read(tmp_path / "b.laz").header
    assert header.file_source_id == 77
    assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert header.uuid.bytes_le == bytes(range(16))
    assert header.system_identifier == "scanner"
    assert header.creation_date == laspy.header.date(2017, 5, 3)
    classify(src, tmp_path / "c.laz")
    assert (tmp_path / "b.laz").read_bytes() == (tmp_path / "c.laz").read_bytes()


def header_of(path: Path) -> tuple[bool, bool, str, laspy.header.date | None]:
    """Time bit, WKT bit, system and day of a header."""
    header = laspy.read(path).header
    adjusted = header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    return adjusted, header.global_encoding.wkt, header.system_identifier, header.creation_date


@pytest.mark.parametrize("standard", ["adjusted", "week"])
@pytest.mark.parametrize("point_format", [1, 6])
def test_header_is_repaired_by_the_values(
    tmp_path: Path, standard: TimeStandard, point_format: int
) -> None:
    last_s = 267_608_600.0 if standard == "adjusted" else 345_000.0
    times = {"gps_time": np.linspace(last_s - 100, last_s, 1000)}
    src = write_las(tmp_path / "a.laz", point_format=point_format, values=times)
    patch(src, 6, "H", int(standard == "week"))
    patch(src, 26, "32s", b"")
    patch(src, 90, "HH", 0, 0)
    classify(src, tmp_path / "b.laz", standard=standard)
    expected = (standard == "adjusted", True, "MODIFICATION", None)
    assert header_of(tmp_path / "b.laz") == expected
    (table,) = iter_points(src, channel_dimension=None, source=1)
    write_points(tmp_path / "c.laz", table, crs=None)
    assert header_of(tmp_path / "c.laz") == (*expected[:2], "OTHER", None)


def test_second_run_replaces_its_own_dimensions_and_keeps_those_of_others(tmp_path: Path) -> None:
    others = {"noise_class": "f8", "input_classification": "u1", "height": "f4"}
    src = write_las(tmp_path / "a.laz", extra=others)
    classify(src, tmp_path / "b.laz")
    classify(tmp_path / "b.laz", tmp_path / "c.laz")
    given, first, second = (laspy.read(tmp_path / f"{name}.laz") for name in "abc")
    kept = ["noise_class_2", "input_classification_2", "height"]
    names = [*kept, "input_classification", "noise_class", "noise_density", "p_value"]
    for cloud in (first, second):
        assert list(cloud.point_format.extra_dimension_names) == names
        for before, after in zip(others, kept, strict=True):
            np.testing.assert_array_equal(cloud[after], given[before])
        np.testing.assert_array_equal(cloud["input_classification"], given.classification)


def test_records_are_kept_but_for_those_of_the_old_packing(tmp_path: Path) -> None:
    vlrs = [laspy.VLR("me", 7, "mine", b"abc"), laspy.VLR("copc", 10000, "", bytes(5))]
    evlrs = [laspy.VLR("me", 8, "long", bytes(70_000)), laspy.VLR("copc", 1000, "", bytes(32))]
    src = write_las(tmp_path / "a.laz", vlrs=vlrs, evlrs=evlrs)
    classify(src, tmp_path / "b.laz")
    with laspy.open(tmp_path / "b.laz") as reader:
        found = {(v.user_id, v.record_id) for v in reader.header.vlrs}
        assert found == {("me", 7), ("LASF_Spec", 4), ("laszip encoded", 22204)}
        extended = reader.header.evlrs
        assert extended is not None
        assert [(v.user_id, v.record_id, len(v.record_data)) for v in extended] == [
            ("me", 8, 70_000)
        ]


def test_waveforms_of_version_1_3_move_along(tmp_path: Path) -> None:
    src = write_las(tmp_path / "a.las", version="1.3", point_format=4)
    start = src.stat().st_size
    packet = b"\0\0" + b"LASF_Spec".ljust(16, b"\0") + (65535).to_bytes(2, "little")
    packet += (5000).to_bytes(8, "little") + bytes(32) + bytes(range(250)) * 20
    src.write_bytes(src.read_bytes() + packet)
    patch(src, 6, "H", 2)
    patch(src, 227, "Q", start)
    classify(src, tmp_path / "b.laz")
    content = (tmp_path / "b.laz").read_bytes()
    offset = int.from_bytes(content[227:235], "little")
    assert content[offset:] == packet
    assert laspy.read(tmp_path / "b.laz").header.number_of_evlrs == 1


@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
def test_crs(tmp_path: Path, version: str, point_format: int) -> None:
    own, named = CRS.from_epsg(32615), CRS.from_epsg(2154)
    kept = {"version": version, "point_format": point_format}
    classify(write_las(tmp_path / "a.las", crs=own, **kept), tmp_path / "b.laz", crs=named)  # type: ignore[arg-type]
    classify(write_las(tmp_path / "c.las", **kept), tmp_path / "d.laz", crs=named)  # type: ignore[arg-type]
    for name, crs in (("b", own), ("d", named)):
        header = laspy.read(tmp_path / f"{name}.laz").header
        assert header.global_encoding.wkt
        assert header.parse_crs().to_epsg() == crs.to_epsg()


NAMELESS = CompoundCRS(
    "", ["EPSG:2154", CRS('VERT_CS["unknown height",VERT_DATUM["unknown",2005],UNIT["metre",1]]')]
).to_wkt()


@pytest.mark.parametrize("where", ["vlrs", "evlrs"])
@pytest.mark.parametrize(
    ("own", "wanted"),
    [
        ("EPSG:2154", [2154, 5703]),  # the record gets the vertical datum that it lacks
        ("EPSG:2154+5720", [2154, 5720]),
        (NAMELESS, [2154, 5703]),
        ("EPSG:4978", [32615, 5703]),  # no coordinates of a survey are geocentric
        ("nonsense", [32615, 5703]),
    ],
)
def test_a_record_without_a_vertical_datum_gets_that_of_the_survey(
    tmp_path: Path, own: str, wanted: list[int], where: str
) -> None:
    nonsense = laspy.VLR("LASF_Projection", 2112, "", b"nonsense\0")
    record = nonsense if own == "nonsense" else wkt_record(own)
    given: dict[str, Any] = {where: [record], "scales": (0.01,) * 3}
    src = write_las(tmp_path / "a.laz", **given)
    classify(src, tmp_path / "b.laz", crs=CRS.from_user_input("EPSG:32615+5703"))
    copy_as_copc(tmp_path / "b.laz", tmp_path / "b.copc.laz")
    for name in ("b.laz", "b.copc.laz"):
        found = header_crs(read_header(tmp_path / name))[0]
        assert found is not None
        assert [part.to_epsg() for part in found.sub_crs_list] == wanted
        records = laspy.read(tmp_path / name).header
        both = [*records.vlrs, *(records.evlrs or [])]
        assert [one.record_id for one in both].count(2112) == 1


@pytest.mark.parametrize(("point_format", "wanted"), [(1, 32615), (6, 32616)])
@pytest.mark.parametrize("other", ["EPSG:32616", "EPSG:32615"])
@pytest.mark.parametrize("writer", ["LASF_Projection", "liblas"])
def test_keys_and_wkt_that_contradict_each_other(
    tmp_path: Path, point_format: int, wanted: int, other: str, writer: str
) -> None:
    records = [keys_record(*UTM), wkt_record(other, writer)]
    src = write_las(tmp_path / "a.las", point_format=point_format, vlrs=records)
    crs, warnings = header_crs(read_header(src))
    assert crs is not None
    if other == "EPSG:32615":
        assert (crs.to_epsg(), warnings) == (32615, ())
        return
    assert crs.to_epsg() == wanted
    assert all(name in warnings[0] for name in ("EPSG:32615", "EPSG:32616"))
    assert "Longitude of natural origin -87 degree against -93 degree" in warnings[0]
    classify(src, tmp_path / "b.laz")
    copy = read_header(tmp_path / "b.laz")
    assert header_crs(copy) == (crs, ())
    assert (copy.vlr("LASF_Projection", 34735) is None) == (wanted == 32616)


@pytest.mark.parametrize(
    ("heights", "other", "agree"),
    [
        ([5703], "EPSG:32615+5703", True),
        ([5703], "EPSG:32615+5773", False),
        ([5019], "EPSG:32615+5703", False),
        ([5703, 9001], "EPSG:32615", True),
        ([6360], "EPSG:32615+6360", True),
        ([6360, 9001], "EPSG:32615+6360", False),
        ([6360, 9001], "EPSG:32615+5703", False),  # the keys contradict themselves
    ],
)
def test_heights_of_keys_and_wkt_are_above_the_same(
    tmp_path: Path, heights: list[int], other: str, *, agree: bool
) -> None:
    keys = keys_record(*UTM, *zip((4096, 4099), heights, strict=False))
    src = write_las(tmp_path / "a.las", vlrs=[keys, wkt_record(other)])
    assert (header_crs(read_header(src))[1] == ()) == agree


@pytest.mark.parametrize("unit", [9001, 9002, 9003])
@pytest.mark.parametrize("code", [5703, 8228, 6360])
def test_a_unit_of_heights_counts_more_than_a_vertical_crs_that_contradicts_it(
    tmp_path: Path, code: int, unit: int
) -> None:
    by_unit = {9001: 5703, 9002: 8228, 9003: 6360}
    record = keys_record((1024, 1), (3072, 26915), (4096, code), (4099, unit))
    crs, warnings = header_crs(read_header(write_las(tmp_path / "a.las", vlrs=[record])))
    assert crs is not None
    assert vertical(crs).to_epsg() == by_unit[unit]
    assert len(warnings) == (by_unit[unit] != code)
    units = [Units.of(CRS(named)).vertical for named in (code, by_unit[unit])]
    assert all(
        f"EPSG:{code}" in text and all(in_words(one) in text for one in units) for text in warnings
    )


@pytest.mark.parametrize("point_format", [1, 6])
@pytest.mark.parametrize(
    ("heights", "other", "wanted"),
    [
        ({4096: 5703, 4099: 9001}, "EPSG:2278", (1.0, 1.0)),
        ({4096: 6360, 4099: 9003}, "EPSG:2278", (US_FOOT_M, US_FOOT_M)),
        ({4096: 5019, 4099: 9001}, "EPSG:2278", (1.0, 1.0)),
        ({}, "EPSG:2278+5703", (1.0, 1.0)),
        ({4099: 9003}, "EPSG:2278+5703", (US_FOOT_M, 1.0)),
    ],
)
def test_heights_that_one_record_alone_states_count_else_the_header_decides(
    tmp_path: Path,
    heights: dict[int, int],
    other: str,
    wanted: tuple[float, float],
    point_format: int,
) -> None:
    keys = keys_record((1024, 1), (3072, 2278), (3076, 9003), *heights.items())
    records = [keys, wkt_record(other)]
    src = write_las(tmp_path / "a.las", point_format=point_format, vlrs=records)
    classify(src, tmp_path / "b.laz")
    for path in (src, tmp_path / "b.laz"):
        crs, warnings = header_crs(read_header(path))
        assert Units.of(crs).vertical_m == wanted[point_format == 6]
        assert bool(warnings) == (path == src and wanted[0] != wanted[1])
    for record in laspy.read(tmp_path / "b.laz").header.vlrs:
        if record.record_id == 2112:
            assert Units.of(CRS(record.string)).vertical_m == wanted[point_format == 6]


def test_the_record_of_liblas_takes_no_heights_from_keys(tmp_path: Path) -> None:
    records = [wkt_record("EPSG:32615", "liblas")]
    for wanted in (2, 0):
        src = write_las(tmp_path / "a.las", version="1.2", point_format=1, vlrs=records)
        crs, warnings = header_crs(read_header(src))
        assert crs is not None
        assert (len(crs.sub_crs_list), warnings) == (2 - wanted, ())
        records.append(keys_record(*UTM, (4096, 5703)))


@pytest.mark.parametrize("code", [5019, 5030])
def test_heights_above_an_ellipsoid_are_written_as_wkt2(tmp_path: Path, code: int) -> None:
    record = keys_record(*UTM, (4096, code))
    src = write_las(tmp_path / "a.las", version="1.2", point_format=1, vlrs=[record])
    classify(src, tmp_path / "b.laz")
    crs = header_crs(read_header(tmp_path / "b.laz"))[0]
    assert crs is not None
    assert len(crs.axis_info) == 3
    assert horizontal(crs).to_epsg() == 32615


def test_damaged_input_leaves_nothing_and_keeps_the_old(tmp_path: Path) -> None:
    src, dst = write_las(tmp_path / "a.laz", n=60_000), tmp_path / "out" / "b.laz"
    classify(src, dst)
    old = dst.read_bytes()
    content = bytearray(src.read_bytes())
    start = int.from_bytes(content[96:100], "little") + 8 + 40
    content[start : start + 3000] = b"\xff" * 3000
    src.write_bytes(content)
    with pytest.raises(InputError):
        classify(src, dst)
    assert dst.read_bytes() == old
    assert list(dst.parent.iterdir()) == [dst]


def test_points_of_a_tile(tmp_path: Path) -> None:
    threes = np.full(700, 3)
    src = write_las(
        tmp_path / "a.laz", n=700, values={"return_number": threes, "scan_angle": threes}
    )
    tables = list(iter_points(src, channel_dimension="user_data", source=1))
    table = concat(tables, SOURCE_COLUMNS)
    path = tmp_path / "tiles" / "1_2.laz"
    crs = CRS.from_epsg(32615)
    extra = {"height": np.arange(700, dtype=np.float32)}
    labelled = table.with_columns(classification=np.full(700, 2), noise_class=np.full(700, 1))
    assert write_points(path, labelled, crs=crs, extra=extra) == 700
    cloud = laspy.read(path)
    assert cloud.header.parse_crs().to_epsg() == 32615
    np.testing.assert_array_equal(cloud["height"], extra["height"])
    np.testing.assert_array_equal(cloud["input_classification"], table["input_class"])
    again = concat(list(iter_points(path, channel_dimension="user_data", source=1)), SOURCE_COLUMNS)
    for name in SOURCE_COLUMNS:
        expected = np.full(700, 2) if name == "input_class" else table[name]
        if name != "flags":  # the vendor's noise class gave way to ours
            np.testing.assert_array_equal(again[name], expected, err_msg=name)


def test_points_far_from_zero_and_too_far_apart(tmp_path: Path) -> None:
    far = np.array([7_000_000_123, 7_000_000_124], np.int64)
    columns = {"x": far, "y": -far, "z": np.array([-2_000_000_000, 2_000_000_000], np.int32)}
    write_points(tmp_path / "a.laz", PointTable(columns), crs=None)
    table = next(iter_points(tmp_path / "a.laz", channel_dimension=None, source=0))
    for name, values in columns.items():
        np.testing.assert_array_equal(table[name], values)
    columns["x"] = np.array([0, 5_000_000_000], np.int64)
    with pytest.raises(WorkflowError, match="2000 km"):
        write_points(tmp_path / "b.laz", PointTable(columns), crs=None)


BROKEN = {
    "WKT of no text": ("LASF_Projection", 2112, b"PROJCS[\xff\xfe\x00"),
    "GeoTIFF text of no text": ("LASF_Projection", 34737, b"UTM \xff\xfe|"),
    "classes cut off": ("LASF_Spec", 0, b"\x01abc"),
}


@pytest.mark.parametrize("which", BROKEN)
@pytest.mark.parametrize("extended", [False, True])
def test_a_record_that_no_reader_parses_is_left_out(
    tmp_path: Path,
    which: str,
    extended: bool,  # noqa: FBT001
) -> None:
    user, number, data = BROKEN[which]
    good = laspy.VLR("ours", 7, "kept", b"whole")
    listed = [good, laspy.VLR(user, number, "broken", data)]
    given: dict[str, Any] = {"evlrs": listed} if extended else {"vlrs": listed}
    src, dst = write_las(tmp_path / "a.laz", **given), tmp_path / "out.laz"
    (text,) = broken_records(read_header(src))
    assert text.startswith(f"header record {user} {number} cannot be parsed (")
    crs = CRS.from_epsg(32615)
    assert classify(src, dst, crs=crs) == 1000
    with laspy.open(dst) as reader:
        records = [*reader.header.vlrs, *(reader.header.evlrs or [])]
        assert reader.header.parse_crs() == crs
    kept = [record for record in records if record.user_id == "ours"]
    assert [bytes(record.record_data) for record in kept] == [b"whole"]
    assert not [record for record in records if bytes(record.record_data_bytes()) == data]
