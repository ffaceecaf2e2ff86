"""What a plan refuses by headers, and a run once its files are read; both ends of files."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from spl_batch import api
from spl_batch.constants import US_FOOT_M
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats.las.reader import read_ends
from spl_batch.formats.trajectory.records import SBET_RECORD, has_records
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


def refused(survey: Path, *, planned: bool) -> str:
    """Why a run does not go on; by headers alone a plan refuses it as well."""
    with pytest.raises(WorkflowError) as stopped:
        surveys.run(survey)
    if planned:
        with pytest.raises(WorkflowError) as seen:
            api.plan(survey)
        assert str(seen.value) == str(stopped.value)
    else:
        api.plan(survey)
    return str(stopped.value)


@pytest.mark.parametrize(
    ("dimension", "spoilt", "fault", "planned"),
    [
        ("user_data", 0, "survey.channel_dimension: user_data holds only 0 in ", False),
        ("beamlets", 1, "survey.channel_dimension: no dimension 'beamlets' in ", True),
        ("intensity", 300, "dimension 'intensity' is 300 at point 0", False),
        ("gps_time", 7.0, "lines/line_1.laz, lines/line_2.laz: no point has a usable", False),
        ("withheld", 1, "lines/line_1.laz, lines/line_2.laz: every point is withheld", False),
        ("x", None, "the file holds no points; name files that hold some", True),
    ],
)
def test_inputs_of_no_use_are_refused(
    survey: Path, dimension: str, spoilt: float | None, fault: str, *, planned: bool
) -> None:
    named = dimension if dimension in {"user_data", "beamlets", "intensity"} else "channel"
    surveys.write_workflow(survey.parent, survey={"channel_dimension": named})
    for k in (1, 2):
        columns = surveys.flightline(shots=120, psid=k, start_s=surveys.START_S + 3 * (k - 1))
        if spoilt is None:
            columns = surveys.take(columns, slice(0, 0))
        else:
            columns[dimension] = np.full(len(columns["x"]), spoilt)
        surveys.write_cloud(survey.parent / "lines" / f"line_{k}.laz", columns)
    assert fault in refused(survey, planned=planned)


def test_a_trajectory_of_another_day_is_refused(survey: Path) -> None:
    start = surveys.START_S + DAY_S
    surveys.write_trajectory(survey.parent / "trajectory.csv", start_s=start, stop_s=start + 10)
    assert refused(survey, planned=False).startswith("survey.trajectory: ")


def test_a_trajectory_in_metres_beside_points_in_feet_is_refused(survey: Path) -> None:
    for path in (survey.parent / "lines").glob("*.laz"):
        surveys.in_feet(path, path, "EPSG:8782", [US_FOOT_M] * 3)
    text = refused(survey, planned=True)
    assert text.startswith(f"survey.trajectory: {survey.parent / 'trajectory.csv'}: ")
    assert "where they are in metres, and not in US survey feet" in text
    named = [f"survey.trajectory_crs={surveys.CRS_NAME}"]
    assert api.plan(survey, overrides=named).faults == ()


def test_seconds_of_the_week_are_no_other_day(survey: Path) -> None:
    start = (surveys.START_S + 1e9 - 1) % 604_800
    path, back_m = survey.parent / "trajectory.csv", surveys.SPEED_M_S * (surveys.START_S - start)
    surveys.write_trajectory(path, start_s=start, stop_s=start + 11, shift_m=back_m)
    line = surveys.flightline(shots=120, psid=2, start_s=surveys.START_S + 3, seed=2)
    line["gps_time"][77] += 8 * DAY_S  # one wrong time leaves no week open
    surveys.write_cloud(survey.parent / "lines" / "line_2.laz", line)
    assert surveys.run(survey, until="shots").exit_status == 0


def test_files_without_times_are_found_by_their_headers(survey: Path) -> None:
    line = surveys.flightline(shots=120, psid=2)
    lines = survey.parent / "lines"
    surveys.write_cloud(lines / "line_2.laz", line, version="1.2", point_format=0)
    plan = api.plan(survey)
    assert plan.faults == ()
    (one,) = surveys.found(plan.findings, "I02", "format")
    assert one.subject == "lines/line_2.laz"
    surveys.write_cloud(lines / "line_1.laz", line, version="1.2", point_format=0)
    assert "lines/line_1.laz, lines/line_2.laz: the point format" in refused(survey, planned=True)
    settings = ["filter.method=none", "afterpulse.enabled=false"]
    assert api.plan(survey, overrides=settings).faults == ()


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


def test_a_trajectory_is_known_by_its_first_records(tmp_path: Path) -> None:
    rows = np.column_stack([1000.0 + np.arange(9), *np.zeros((3, 9))])
    np.savetxt(tmp_path / "t.csv", rows, "%.4f", delimiter=";", header="GPS_Time;x;y;z")
    names = ("gps_time", "x", "y", "z")
    pq.write_table(pa.table(dict(zip(names, rows.T, strict=True))), tmp_path / "t.parquet")
    sbet = np.zeros(9, SBET_RECORD)
    sbet["time"] = rows[:, 0]
    sbet.tofile(tmp_path / "t.sbet")
    assert all(has_records(tmp_path / f"t.{kind}") for kind in ("csv", "parquet", "sbet"))
    (tmp_path / "t.csv").write_text("gps_time,x,y,z\n")
    assert not has_records(tmp_path / "t.csv")
    (tmp_path / "t.sbet").write_bytes(b"short")
    for name in ("t.sbet", "none.csv"):
        with pytest.raises(InputError):
            has_records(tmp_path / name)


@pytest.mark.parametrize(
    ("outputs", "said"),
    [
        ({"cell": 5000}, "outputs.cell: 5000 is less .* write 0.001 to 50, in the unit"),
        ({"cell": 0.0001, "units": "us-ft"}, "outputs.cell: 0.0001 .* write 0.00328083 to 164.042"),
    ],
)
def test_cells_elsewhere_are_as_large_as_others_may_be(
    tmp_path: Path, outputs: dict[str, Any], said: str
) -> None:
    with pytest.raises(WorkflowError, match=said):
        api.plan(surveys.small_survey(tmp_path, outputs=outputs))


def test_rasters_elsewhere_have_no_more_cells_than_others_may_have(tmp_path: Path) -> None:
    for k in range(2):
        line = surveys.flightline(shots=5)
        line["x"] = line["x"] + 4000.0 * k
        line["y"] = line["y"] + 5000.0 * k
        surveys.write_cloud(tmp_path / "lines" / f"{k}.laz", line)
    with pytest.raises(
        WorkflowError, match=r"outputs\.cell: rasters would have 20 .* cells of 0\.001"
    ):
        api.plan(surveys.write_workflow(tmp_path, outputs={"cell": 0.001}))
    api.plan(surveys.write_workflow(tmp_path, outputs={"cell": 0.5}))
