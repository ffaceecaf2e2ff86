"""A plan tells from both ends of the files what a run would find out."""

from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from spl_batch import api
from spl_batch.airborne.plan.inputs import first_look
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats.las.reader import read_ends
from spl_batch.formats.trajectory.records import SBET_RECORD, ends
from tests import surveys

DAY_S = 86_400.0


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    surveys.write_trajectory(tmp_path / "trajectory.csv")
    return surveys.small_survey(tmp_path)


def test_a_survey_that_is_well_is_told_nothing(survey: Path) -> None:
    plan = api.plan(survey)
    assert plan.faults == ()
    assert not [one for one in plan.findings if one.severity != "note"]


def refused(survey: Path, *settings: str) -> str:
    """What a plan and a run say alike of what neither starts."""
    said = []
    for verb in (["plan"], ["run", "--workers", "0"]):
        ended = surveys.command(*verb, survey, *(w for one in settings for w in ("--set", one)))
        assert ended.status == 2, ended.text
        assert ended.out == ""
        lines = [line for line in ended.err.splitlines() if not line.startswith("info: ")]
        assert all(line.startswith("  ") for line in lines[1:]), "one sentence, wrapped"
        said.append(" ".join(map(str.strip, lines)).removeprefix("spl-batch: "))
    assert said[0] == said[1]
    assert not (survey.parent / "out").exists()
    return said[0]


def test_files_of_which_every_point_is_withheld_show_before_a_run(survey: Path) -> None:
    def withhold(path: Path) -> None:
        with laspy.open(path) as reader:
            cloud = reader.read()
        cloud.withheld[:] = 1
        cloud.write(path)

    first, *others = sorted((survey.parent / "lines").glob("*.laz"))
    withhold(first)
    assert surveys.found(api.plan(survey).findings, "I01", "withheld")
    for path in others:
        withhold(path)
    assert "withheld" in refused(survey)


def test_what_is_refused_names_all_that_is_wrong(survey: Path) -> None:
    later_s = surveys.START_S + 2 * DAY_S
    path = survey.parent / "trajectory.csv"
    surveys.write_trajectory(path, start_s=later_s, stop_s=later_s + 10)
    (survey.parent / "lines" / "line_3.laz").write_bytes(b"LASF" + bytes(20))
    said = refused(survey, "survey.trajectory=trajectory.csv")
    assert "lines/line_3.laz" in said
    assert "survey.trajectory: " in said


@pytest.mark.parametrize(
    ("dimension", "spoilt", "fault"),
    [
        ("user_data", 0, "survey.channel_dimension: user_data holds only 0 in "),
        ("beamlets", 1, "survey.channel_dimension: no dimension 'beamlets' in "),
        ("intensity", 300, "dimension 'intensity' is 300 at point 0"),
        ("gps_time", 7.0, "lines/line_1.laz, lines/line_2.laz: no point has a usable gps_time"),
        ("x", None, "the file holds no points; name files that hold some"),
    ],
)
def test_plan_and_run_refuse_alike(
    survey: Path, dimension: str, spoilt: float | None, fault: str
) -> None:
    for k in (1, 2):
        columns = surveys.flightline(shots=120, psid=k, start_s=surveys.START_S + 3 * (k - 1))
        if spoilt is None:
            columns = surveys.take(columns, slice(0, 0))
        else:
            columns[dimension] = np.full(len(columns["x"]), spoilt)
        surveys.write_cloud(survey.parent / "lines" / f"line_{k}.laz", columns)
    named = dimension if dimension not in {"gps_time", "x"} else "channel"
    said = refused(survey, f"survey.channel_dimension={named}")
    assert fault in said
    assert said.count(fault) == 1


def test_points_in_order_of_their_channel_are_not_refused(tmp_path: Path) -> None:
    survey = surveys.small_survey(tmp_path, survey={"channel_dimension": "user_data"})
    line = surveys.flightline(shots=120)
    for k in (1, 2):
        columns = surveys.take(line, np.resize(np.arange(len(line["x"])), 300_000))
        columns["user_data"] = (np.arange(300_000) // 3_000).astype(np.uint8)
        columns["gps_time"] = surveys.START_S + np.arange(300_000.0)
        surveys.write_cloud(tmp_path / "lines" / f"line_{k}.laz", columns)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(first_look, "WHOLE_POINTS", 0)
        plan = api.plan(survey)
    (one,) = surveys.found(plan.findings, "I04", "few")
    assert one.subjects == ("lines/line_1.laz", "lines/line_2.laz")


def test_a_trajectory_of_another_day_is_refused(survey: Path) -> None:
    start = surveys.START_S + DAY_S
    surveys.write_trajectory(survey.parent / "trajectory.csv", start_s=start, stop_s=start + 10)
    fault = refused(survey)
    assert fault.startswith("survey.trajectory: lines/line_1.laz, lines/line_2.laz: gps_time ")
    assert "86 396.9 s or more outside trajectory.csv" in fault
    assert fault.endswith("name the trajectory of this flight, or none")


def test_a_file_beside_the_trajectory_is_a_warning(survey: Path) -> None:
    surveys.write_trajectory(survey.parent / "trajectory.csv", stop_s=surveys.START_S + 2)
    plan = api.plan(survey)
    assert plan.faults == ()
    (one,) = surveys.found(plan.findings, "T02", "ends")
    assert one.subjects == ("lines/line_2.laz",)


def test_seconds_of_the_week_are_no_other_day(survey: Path) -> None:
    start = (surveys.START_S + 1e9 - 1) % 604_800
    path, back_m = survey.parent / "trajectory.csv", surveys.SPEED_M_S * (surveys.START_S - start)
    surveys.write_trajectory(path, start_s=start, stop_s=start + 11, shift_m=back_m)
    assert api.plan(survey).faults == ()
    start += 2 * DAY_S
    surveys.write_trajectory(path, start_s=start, stop_s=start + 11, shift_m=back_m)
    with pytest.raises(WorkflowError, match="gps_time of the first and last points"):
        api.plan(survey)


@pytest.mark.parametrize("wrong", [77])
def test_one_wrong_time_leaves_no_week_open(survey: Path, wrong: int) -> None:
    start = (surveys.START_S + 1e9 - 1) % 604_800
    path, back_m = survey.parent / "trajectory.csv", surveys.SPEED_M_S * (surveys.START_S - start)
    surveys.write_trajectory(path, start_s=start, stop_s=start + 11, shift_m=back_m)
    line = surveys.flightline(shots=120, psid=2, start_s=surveys.START_S + 3, seed=2)
    line["gps_time"][wrong] += 8 * DAY_S
    surveys.write_cloud(survey.parent / "lines" / "line_2.laz", line)
    assert surveys.run(survey, until="shots").exit_status == 0


def test_a_trajectory_without_its_columns_is_a_fault(survey: Path) -> None:
    (survey.parent / "trajectory.csv").write_text("time,x,y,z\n1,2,3,4\n")
    fault = refused(survey)
    assert fault.startswith("survey.trajectory: ")
    assert "has no column gps_time" in fault


def test_files_without_times_are_told_by_their_headers(survey: Path) -> None:
    line = surveys.flightline(shots=120, psid=2)
    lines = survey.parent / "lines"
    surveys.write_cloud(lines / "line_2.laz", line, version="1.2", point_format=0)
    plan = api.plan(survey)
    assert plan.faults == ()
    (one,) = surveys.found(plan.findings, "I02", "format")
    assert one.subject == "lines/line_2.laz"
    surveys.write_cloud(lines / "line_1.laz", line, version="1.2", point_format=0)
    assert "lines/line_1.laz, lines/line_2.laz: point format 0" in refused(survey)
    settings = ["filter.method=none", "afterpulse.enabled=false"]
    assert api.plan(survey, overrides=settings).faults == ()


def test_points_that_cannot_be_decoded_are_a_fault(survey: Path) -> None:
    path = survey.parent / "lines" / "line_2.laz"
    held = api.plan(survey).points
    content = bytearray(path.read_bytes())
    with laspy.open(path) as reader:
        held -= reader.header.point_count
        start = reader.header.offset_to_point_data + 8
    content[start : start + 400] = bytes(400)
    path.write_bytes(content)
    made = api.plan(survey)
    assert (made.files, made.unusable, made.points) == (1, 1, held)
    assert "files 1 of 2, 1 unusable" in " ".join(surveys.command("plan", survey).out.split())
    (fault,) = made.faults
    assert str(path) in fault
    assert "copy it again" in fault
    # a run says it once more, with what is to be done after that
    result = surveys.run(survey)
    assert result.report is not None
    (failure,) = result.report.failures
    assert failure.place == "lines/line_2.laz"
    assert failure.code == "F01"


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("n", [0, 30, 120_000])
def test_both_ends_of_a_file_are_looked_at(tmp_path: Path, suffix: str, n: int) -> None:
    line = surveys.flightline(shots=2)
    rows = np.arange(n) % len(line["x"])
    columns = surveys.take(line, rows)
    columns["gps_time"] = np.arange(n, dtype=np.float64)
    columns["user_data"] = (np.arange(n) % 200).astype(np.uint8)
    path = surveys.write_cloud(tmp_path / f"cloud.{suffix}", columns)
    found = read_ends(path, "user_data", 20)
    assert np.array_equal(found.channel, found.gps_time.astype(np.int64) % 200)
    assert np.array_equal(found.gps_time, np.unique(found.gps_time)), "no point comes twice"
    if n:
        assert found.gps_time[0] == 0
    if n == 120_000:
        last = 119_980 if suffix == "las" else 100_000  # where the last LAZ chunk starts
        assert found.gps_time[20:].tolist() == list(range(last, last + 20))


@pytest.mark.parametrize("records", [1, 9000])
def test_ends_of_trajectories(tmp_path: Path, records: int) -> None:
    time = 1000.0 + np.arange(records) / 4
    expected = (float(time[0]), float(time[-1]))
    rows = np.column_stack([time, *np.zeros((3, records))])
    path = tmp_path / "t.csv"
    np.savetxt(path, rows, "%.4f", delimiter=";", header="GPS_Time;x;y;z")
    assert ends(path) == expected
    path = tmp_path / "t.parquet"
    table = pa.table(dict(zip(("gps_time", "x", "y", "z"), rows.T, strict=True)))
    pq.write_table(table, path, row_group_size=1000)
    assert ends(path) == expected
    path = tmp_path / "t.sbet"
    sbet = np.zeros(records, SBET_RECORD)
    sbet["time"] = time
    sbet.tofile(path)
    assert ends(path) == expected


def test_ends_that_do_not_tell(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("gps_time,x,y,z\n")
    assert ends(path) is None
    path.write_text("gps_time,x,y,z\n1,2,3,4\n\nend,,,\n")
    assert ends(path) is None
    path.write_text("gps_time,x,y,z\n5,2,3,4\n1,2,3,4\n7,2,3,4\n6,2,3,4\n")
    assert ends(path) is None, "rows in no order may go on anywhere"
    (tmp_path / "t.sbet").write_bytes(b"short")
    assert ends(tmp_path / "t.sbet") is None
    with pytest.raises(InputError, match="no such file"):
        ends(tmp_path / "none.csv")
