"""Trajectories: three formats give the same positions, PROJ and a hand formula agree."""

import re
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from spl_batch.errors import InputError, WorkflowError, counted
from spl_batch.formats.crs import compound
from spl_batch.formats.gps_clock import clock, time_standard
from spl_batch.formats.trajectory import positions
from spl_batch.formats.trajectory.positions import (
    PointExtent,
    gathering,
    read_slice,
    write_trajectory,
)
from spl_batch.formats.trajectory.records import COLUMNS, SBET_RECORD, read_records
from spl_batch.lattice.tables import Trajectory

UTM = CRS.from_epsg(32615)
NAMELESS = compound(
    UTM, CRS('VERT_CS["unknown",VERT_DATUM["unknown",2005],UNIT["metre",1]]')
).to_wkt()
ADJUSTED = 2.5e8
WEEK = 604_800


def flight(n: int = 50, start: float = 1000.0) -> NDArray[np.float64]:
    """A straight line at 4 km: (n, 4) time, x, y, z."""
    t = np.arange(n) / 10
    return np.column_stack([start + t, 500_000 + 80 * t, 4_000_000 - 5 * t, 4000 + 0.1 * t])


def write_csv(path: Path, rows: NDArray[np.float64], head: str = "gps_time,x,y,z") -> Path:
    delimiter = ";" if ";" in head else ","
    lines = [delimiter.join(repr(float(v)) for v in row) for row in rows]
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def write_sbet(path: Path, rows: NDArray[np.float64]) -> Path:
    back = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True)
    longitude, latitude = back.transform(rows[:, 1], rows[:, 2])
    records = np.zeros(len(rows), SBET_RECORD)
    records["time"], records["altitude"] = rows[:, 0], rows[:, 3]
    records["longitude"], records["latitude"] = np.radians(longitude), np.radians(latitude)
    records.tofile(path)
    return path


class Loaded(NamedTuple):
    trajectory: Trajectory
    standard: str
    warnings: list[str]
    notes: list[str]


def read(*paths: Path, crs: str | None = None, survey: CRS | None = UTM, **given: Any) -> Loaded:
    """Trajectory files as one, all of it in memory."""
    with gathering(paths, survey_crs=survey, trajectory_crs=crs, **given) as found:
        times, positions = zip(*found, strict=True)
    whole = Trajectory(np.concatenate(times), np.concatenate(positions))
    return Loaded(whole, found.standard, found.warnings, found.notes)


def test_csv_parquet_and_sbet_agree(tmp_path: Path) -> None:
    rows = flight()
    table = pa.table({k: rows[:, i] for i, k in reversed(list(enumerate(COLUMNS)))})
    pq.write_table(table, tmp_path / "a.parquet")
    for path in (
        write_csv(tmp_path / "a.csv", rows),
        write_sbet(tmp_path / "a.out", rows),
        tmp_path / "a.parquet",
    ):
        loaded = read(path)
        assert loaded.standard == "week"
        assert loaded.warnings == []
        np.testing.assert_array_equal(loaded.trajectory.time_s, rows[:, 0])
        np.testing.assert_allclose(loaded.trajectory.xyz_m, rows[:, 1:], atol=1e-6)


def test_order_and_cut_do_not_matter(tmp_path: Path) -> None:
    rows = flight()
    mixed = np.random.default_rng(0).permutation(rows)
    parts = [write_csv(tmp_path / f"{i}.csv", mixed[i::3]) for i in range(3)]
    loaded = read(*parts)
    np.testing.assert_array_equal(loaded.trajectory.xyz_m, rows[:, 1:])
    again = read(*parts, parts[0])
    np.testing.assert_array_equal(again.trajectory.time_s, rows[:, 0])
    assert again.warnings == ["trajectory: 17 records repeat a time: left out"]


@pytest.mark.parametrize("latitude", [np.nan, np.inf, 1e300, -1.7e308])
def test_a_record_that_cannot_be_is_left_out_of_any_format(tmp_path: Path, latitude: float) -> None:
    rows = flight()
    table = {k: rows[:, i].tolist() for i, k in enumerate(COLUMNS)}
    table["y"][7] = None
    pq.write_table(pa.table(table), tmp_path / "a.parquet")
    sbet = np.fromfile(write_sbet(tmp_path / "a.sbet", rows), SBET_RECORD)
    sbet["latitude"][7] = latitude
    sbet.tofile(tmp_path / "a.sbet")
    for name in ("a.parquet", "a.sbet"):
        loaded = read(tmp_path / name)
        assert len(loaded.trajectory.time_s) == 49
        (remark,) = loaded.warnings
        assert remark.startswith(f"trajectory {name}: 1 of 50 records left out (no finite number")
        assert remark.endswith("; the first is record 7")


def test_faults(tmp_path: Path) -> None:
    rows = flight()
    cases = {
        "no such file": tmp_path / "missing.csv",
        "no column gps_time": write_csv(tmp_path / "a.csv", rows, "time,x,y,z"),
        "at least 2": write_csv(tmp_path / "c.csv", rows[:1]),
        "multiple of 136": tmp_path / "d.sbet",
        "not an SBET": tmp_path / "e.sbet",
        "not a Parquet": tmp_path / "f.parquet",
        "no column gps_time, x, y, z": tmp_path / "h.csv",
    }
    (tmp_path / "d.sbet").write_bytes(bytes(137))
    np.full(17 * 4, 45.0).tofile(tmp_path / "e.sbet")
    (tmp_path / "f.parquet").write_bytes(b"PAR1 and then nonsense")
    (tmp_path / "h.csv").write_bytes(bytes(range(256)) * 10)
    for words, path in cases.items():
        with pytest.raises(InputError) as caught:
            read(path)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="matches no file"):
        read()


@pytest.mark.parametrize(
    ("survey", "warned"),
    [
        ("EPSG:6344+5703", "not of .*NAVD88 height.*: PROJ lacks .*us_noaa_g2018u0.tif"),
        (NAMELESS, ""),
        ("EPSG:6344", ""),
    ],
)
def test_heights_that_cannot_be_converted_are_named_with_the_grid(
    tmp_path: Path, survey: str, warned: str
) -> None:
    sbet = write_sbet(tmp_path / "a.sbet", flight())
    loaded = read(sbet, crs="EPSG:6319", survey=CRS(survey))
    assert bool(loaded.warnings) == bool(warned)
    assert all(re.search(warned, text) for text in loaded.warnings)
    np.testing.assert_allclose(loaded.trajectory.xyz_m[:, 2], flight()[:, 3], atol=1e-6)


def test_crs_faults(tmp_path: Path) -> None:
    sbet, table = write_sbet(tmp_path / "a.sbet", flight()), write_csv(tmp_path / "a.csv", flight())
    with pytest.raises(InputError, match=r"survey has no CRS.*survey\.crs"):
        read(sbet, survey=None)
    with pytest.raises(InputError, match="geographic"):
        read(sbet, crs="EPSG:32615")
    with pytest.raises(WorkflowError, match=r"survey\.trajectory_crs"):
        read(table, crs="EPSG:nonsense")
    assert len(read(table, survey=None).trajectory.time_s) == 50


def load(path: Path, span: tuple[float, float], **given: Any) -> Any:
    box = {"bounds_m": (500_000, 3_999_000, 501_000, 4_001_000), **given}
    points = PointExtent(span, **box)
    return read(path, points=points)


def test_loaded_into_the_points_time(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", flight())
    week = np.floor((ADJUSTED + 1e9) / WEEK) * WEEK - 1e9
    loaded = load(path, (week + 1000.5, week + 1001.5))
    np.testing.assert_allclose(loaded.trajectory.time_s, flight()[:, 0] + week, atol=1e-6)
    assert loaded.standard == "adjusted"
    assert loaded.notes == ["trajectory: week time converted to adjusted time"]
    assert loaded.warnings == []
    short = load(path, (900.0, 1001.0), bounds_m=(500_000, 3_999_000, 0, 501_000, 4_001_000, 9))
    assert "covers 1000.000 to 1004.900 s" in short.warnings[0]


def test_trajectory_in_another_crs_is_found_out(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", flight())
    with pytest.raises(InputError, match=r"different CRS.*survey\.trajectory_crs"):
        load(path, (1000.0, 1001.0), bounds_m=(700_000, 6_000_000, 701_000, 6_001_000))


def test_week_that_cannot_be_derived(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", flight())
    with pytest.raises(InputError, match="ambiguous"):
        load(path, (ADJUSTED, ADJUSTED + 2 * WEEK))


def test_slices_interpolate_like_the_whole(tmp_path: Path) -> None:
    rows = flight(200_000)
    whole = Trajectory(rows[:, 0], rows[:, 1:])
    write_trajectory(tmp_path / "t.parquet", [(whole.time_s, whole.xyz_m)])
    first, last = rows[0, 0], rows[-1, 0]
    spans = [
        (first, last),
        (first + 6553.55, first + 6553.65),
        (first - 9, first - 5),
        (last + 5, last + 9),
        (first + 3.33, first + 3.34),
        (first - 1, first + 1),
    ]
    for start, stop in spans:
        part = read_slice(tmp_path / "t.parquet", start, stop)
        times = np.linspace(start, stop, 50)
        for got, wanted in zip(part.position(times), whole.position(times), strict=True):
            np.testing.assert_array_equal(got, wanted)
        assert stop - start > 100 or len(part.time_s) < 30


@pytest.mark.parametrize(
    ("values", "standard"),
    [
        ([], "none"),
        ([np.nan, 0.0, 0.0], "none"),
        ([0.0, 3.5], "week"),
        ([604_799.0, 604_850.0, np.nan], "week"),
        ([700_000.0], "adjusted"),
        ([-3e8], "adjusted"),
        ([246_539_563.0, 281_629_030.0], "adjusted"),
        ([1.48e9], "unix_or_gps"),
        ([1e3, 2e9], "other"),
        ([1e18], "other"),
    ],
)
def test_time_standard(values: list[float], standard: str) -> None:
    assert time_standard(np.array(values, dtype=np.float64)) == standard


@given(
    start=st.integers(7 * 10**8, 15 * 10**8),
    length=st.integers(10, 80_000),
    given_standard=st.sampled_from(["week", "adjusted", "unix_or_gps"]),
    wanted=st.sampled_from(["week", "adjusted", "unix_or_gps"]),
)
def test_any_clock_into_any_other(
    start: int,
    length: int,
    given_standard: Literal["week", "adjusted", "unix_or_gps"],
    wanted: Literal["week", "adjusted", "unix_or_gps"],
) -> None:
    """Whole GPS seconds in every standard; week seconds may wrap within the flight."""
    gps = np.linspace(start, start + length, 11).round()
    clocks = {
        "adjusted": gps - 1e9,
        "unix_or_gps": gps,
        "week": gps - start // WEEK * WEEK,
    }
    times = clocks[given_standard] % WEEK if given_standard == "week" else clocks[given_standard]
    if time_standard(times) != given_standard or time_standard(clocks[wanted]) != wanted:
        return
    span = (float(clocks[wanted][3]), float(clocks[wanted][7]))
    convert = clock(given_standard, (float(times.min()), float(times.max())), span, wanted)
    if given_standard == wanted:
        assert convert is None
        return
    assert convert is not None
    np.testing.assert_array_equal(convert(times), clocks[wanted])


# Files of any length, in any order


@settings(deadline=None)
@given(data=st.data(), count=st.integers(2, 400), files=st.integers(1, 4))
def test_records_of_many_batches_come_in_order_once(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, count: int, files: int
) -> None:
    folder = tmp_path_factory.mktemp("t")
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    rows = rng.integers(0, 9, (count, 4)).astype(np.float64)
    rows[:, 0] = 1000 + rng.integers(0, count, count)
    rows[:2, 0] = 900, 901
    overlap = data.draw(st.sampled_from([0.0, 30.0, 1e4]))
    owner = np.clip(rows[:, 0] + rng.uniform(0, overlap, count), 900, 1000 + count)
    owner = ((owner - 900) / (101 + count) * files).astype(np.int64)
    paths = [write_csv(folder / f"{k}.csv", rows[owner == k]) for k in set(owner.tolist())]
    by_time = rows[np.lexsort(rows.T[::-1])]
    first = np.concatenate([[True], np.diff(by_time[:, 0]) > 0])
    with pytest.MonkeyPatch.context() as patch:
        batch = data.draw(st.integers(1, 50))
        patch.setattr(positions, "read_records", cut(read_records, batch))
        with gathering(paths, survey_crs=None, trajectory_crs=None) as found:
            got = np.concatenate([np.column_stack(piece) for piece in found])
    np.testing.assert_array_equal(got, by_time[first])
    assert found.records == len(got)
    dropped = count - len(got)
    warning = f"trajectory: {counted(dropped, 'records', 'repeat')} a time: left out"
    assert found.warnings == ([warning] if dropped else [])


def cut(read: Any, size: int) -> Any:
    """The same reader, in batches of so many records."""

    def smaller(path: Path, watch: Any) -> Any:
        for time, position in read(path, watch):
            for start in range(0, len(time), size):
                yield time[start : start + size], position[start : start + size]

    return smaller


@pytest.mark.parametrize(("end", "refused"), [("", True), ("25", True), ("25.125", False)])
def test_a_csv_that_ends_within_a_number_is_refused(
    tmp_path: Path, *, end: str, refused: bool
) -> None:
    path = tmp_path / "track.csv"
    path.write_text("gps_time,x,y,z\n1.5,10.000,20.000,25.125\n2.5,11.000,20.500," + end)
    if refused:
        with pytest.raises(InputError, match=r"cut off: copy it again|empty values"):
            list(read_records(path))
    else:
        ((time, _),) = read_records(path)
        assert time.tolist() == [1.5, 2.5]
    path.write_text(path.read_text() + "25\n")
    assert sum(len(time) for time, _ in read_records(path)) == 2, "a line that ends is believed"
