"""A damaged trajectory or reference file fails alone; the survey is delivered."""

from pathlib import Path

import numpy as np
import pytest

from spl_batch.airborne.tasks.index import check_file
from spl_batch.errors import InputError
from spl_batch.formats.trajectory.positions import PointExtent, gathering
from tests import surveys

HEAD = "gps_time,x,y,z\n"


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """Two flightlines with a trajectory file each, two reference files, checkpoints."""
    folder = tmp_path
    surveys.small_survey(folder)
    start = surveys.START_S
    surveys.write_trajectory(folder / "flight_1.csv", start_s=start - 1, stop_s=start + 2)
    surveys.write_trajectory(folder / "flight_2.csv", start_s=start + 2.5)
    for k in (1, 2):
        known = surveys.flightline(shots=120, seed=k, noise=0.0)
        known["classification"][:] = 2
        surveys.write_cloud(folder / "known" / f"known_{k}.laz", known)
    east, north = surveys.ORIGIN_M
    (folder / "points.csv").write_text(
        f"id,x,y,z,surface,accuracy_m\nA,{east + 3},{north},20.1,open,0.01\n"
    )
    return surveys.write_workflow(
        folder,
        survey={"trajectory": "flight_*.csv"},
        reference={"points": "known/*.laz", "checkpoints": "points.csv"},
    )


def run(survey: Path) -> surveys.Ended:
    return surveys.command("run", survey, "--workers", 0)


def failures(survey: Path) -> dict[str, str]:
    """Names of the files that failed, and why."""
    listed = surveys.report(survey.parent / "out")["failures"]
    return {Path(one["place"]).name: one["reason"] for one in listed}


def test_each_fails_alone_and_is_done_when_it_is_mended(survey: Path) -> None:
    folder = survey.parent
    harmed = [folder / name for name in ("flight_2.csv", "known/known_2.laz")]
    sound = [path.read_bytes() for path in harmed]
    harmed[0].write_bytes(sound[0].replace(b"600.0000\n", b"nan\n", 20))
    harmed[1].write_bytes(sound[1][:200])
    planned = surveys.command("plan", survey)
    assert planned.status == 1, planned.text
    flat = " ".join(planned.text.split())
    assert "known_2.laz" in flat
    ended = run(survey)
    assert ended.status == 1, ended.text
    assert "failed: trajectory file flight_2.csv: " in ended.err
    assert "failed: reference known_2.laz: " in ended.err
    assert "mend or remove it" in ended.out
    told = failures(survey)
    assert told.keys() == {path.name for path in harmed}
    assert "records cannot be used (no finite number" in told["flight_2.csv"]
    # It is told at the start, not only hours later when the reference is read.
    lines = ended.err.splitlines()
    assert next(k for k, line in enumerate(lines) if "known_2.laz" in line) < next(
        k for k, line in enumerate(lines) if "flight_2.csv" in line
    )
    first, second = (
        columns["noise_class"] for columns in surveys.delivered(folder / "out").values()
    )
    assert (first != 255).all()
    assert (second == 255).all()
    assert surveys.report(folder / "out")["accuracy"]["reference_points"] > 0
    # A report that is written again says of the run what the run said.
    assert surveys.command("report", folder / "out").status == 1
    for path, content in zip(harmed, sound, strict=True):
        path.write_bytes(content)
    ended = run(survey)
    assert ended.status == 0, ended.text
    _, second = (columns["noise_class"] for columns in surveys.delivered(folder / "out").values())
    assert (second != 255).all()
    assert failures(survey) == {}


def test_where_no_trajectory_is_sound_nothing_is_started(survey: Path) -> None:
    for k in (1, 2):
        (survey.parent / f"flight_{k}.csv").write_text("time,x\n1,2\n")
    for ended in (surveys.command("plan", survey), run(survey)):
        assert ended.status == 2, ended.text
        assert "flight_1.csv" in ended.text
        assert "flight_2.csv" in ended.text
    assert not (survey.parent / "out").exists()


def test_of_two_trajectories_plan_names_the_unreadable_one(survey: Path) -> None:
    path = survey.parent / "flight_2.csv"
    path.write_text("time,x\n1,2\n")
    ended = surveys.command("plan", survey)
    assert ended.status == 1, ended.text
    assert "flight_2.csv: has no column gps_time, y, z" in " ".join(ended.text.split())
    path.unlink()
    path.symlink_to(survey.parent / "nowhere.csv")
    ended = surveys.command("plan", survey)
    assert ended.status == 1, ended.text
    assert "nowhere.csv" in ended.text


def text(rows: list[str]) -> bytes:
    return (HEAD + "".join(f"{row}\n" for row in rows)).encode()


ROWS = [f"{surveys.START_S + k / 10:.4f},272000,3290000,600" for k in range(100)]


SPOILS = {
    "a time of no clock": "1e300,1,2,3",
    "no time": "nan,1,2,3",
    "no place on Earth": f"{surveys.START_S + 11},1e300,2,3",
    "a time of another decade": "9.5e9,272000,3290000,600",  # a bit of it has flipped
    "an empty value": f"{surveys.START_S + 11},1,,3",
    "a word": f"{surveys.START_S + 11},1,two,3",
    "too few values": "1,2",
}


@pytest.mark.parametrize("row", SPOILS.values(), ids=SPOILS)
def test_a_record_that_cannot_be_is_left_out_and_told(tmp_path: Path, row: str) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(text([*ROWS[:40], row, *ROWS[40:]]))
    assert check_file(path, None, None) == len(ROWS)
    with gathering([path], survey_crs=None, trajectory_crs=None) as found:
        times = np.concatenate([time for time, _ in found])
    (said,) = found.warnings
    assert times.tolist() == [float(one.split(",")[0]) for one in ROWS]
    assert said.startswith("trajectory t.csv: 1 of 101 records left out (no finite number")
    first = "; the first is record 40" if row.count(",") == 3 else ""
    assert said.endswith(f" m){first}")


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            [*ROWS, *["1e300,1,2,3"] * 12],
            "12 of 112 records cannot be used .*; the first is record 100: remove",
        ),
        ([*ROWS, *["a,b,c,d"] * 12], "12 of 112 records cannot be used"),
        ([*ROWS, *["1,2"] * 12], "12 of 112 records cannot be used"),
        ([], "0 trajectory records"),
    ],
)
def test_more_than_a_few_of_them_are_the_files_fault(
    tmp_path: Path, rows: list[str], words: str
) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(text(rows))
    with pytest.raises(InputError, match=words):
        check_file(path, None, None)


def test_files_keep_their_own_clock(tmp_path: Path) -> None:
    """Seconds of the week in one file do not change what those of another mean."""
    start = surveys.START_S
    surveys.write_trajectory(tmp_path / "a.csv", start_s=start, stop_s=start + 5)
    week = (start + 1e9) % 604_800
    back = surveys.SPEED_M_S * (start - week)
    surveys.write_trajectory(tmp_path / "b.csv", start_s=week + 5, stop_s=week + 10, shift_m=back)
    points = PointExtent((start, start + 9), (272_000.0, 3_290_000.0, 273_000.0, 3_291_000.0))
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    with gathering(paths, survey_crs=None, trajectory_crs=None, points=points) as found:
        times = np.concatenate([time for time, _ in found])
    assert times[0] == pytest.approx(start)
    assert times[-1] == pytest.approx(start + 9.9)
    assert found.notes == ["trajectory: week time converted to adjusted time"]
    assert found.warnings == []
