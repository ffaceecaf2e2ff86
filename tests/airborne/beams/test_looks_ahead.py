"""A trajectory whose times are off is noticed: its sensor is not above what it sees."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pyproj import CRS, Transformer

from spl_batch.airborne.beams.geometry import look_ahead
from spl_batch.airborne.beams.sensor_path import Lines, other_unit
from spl_batch.airborne.plan.inputs import findings
from spl_batch.airborne.tasks.line_findings import times_off
from spl_batch.engine.watch.events import Event, Note
from spl_batch.formats.gps_clock import leap_seconds
from spl_batch.lattice.tables import BeamTable
from tests import surveys


def notes(workflow: Path) -> list[str]:
    """What a run up to its shots says."""
    events: list[Event] = []
    surveys.run(workflow, until="shots", listener=events.append)
    return [event.text for event in events if isinstance(event, Note)]


def two_lines(folder: Path) -> Path:
    """A survey of two flightlines; its trajectory is still to be written."""
    for k in (1, 2):
        line = surveys.flightline(shots=1500, psid=k, seed=k)
        surveys.write_cloud(folder / "lines" / f"line_{k}.laz", line)
    return folder / "trajectory.csv"


def test_times_that_are_off_are_reported_once_for_all_lines(tmp_path: Path) -> None:
    surveys.write_trajectory(two_lines(tmp_path), shift_m=-90.0)
    texts = notes(surveys.write_workflow(tmp_path))
    (text,) = [text for text in texts if "trajectory's times" in text]
    for part in ("00001_371000000", "00002_371000000", "ahead of", "1.5 s late"):
        assert part in text


@pytest.mark.parametrize(
    ("leap_s", "late", "margin_s"), [(18, "18 s early, as UTC is", 40.0), (-18, "18 s late", 1.0)]
)
def test_leap_seconds_are_reported_as_such(
    tmp_path: Path, leap_s: int, late: str, margin_s: float
) -> None:
    path, start = two_lines(tmp_path), surveys.START_S - leap_s
    surveys.write_trajectory(
        path, start_s=start - margin_s, stop_s=start + 1.5 + margin_s,
        shift_m=leap_s * surveys.SPEED_M_S,
    )  # fmt: skip
    # Further on in the day the trajectory goes on, over another line: it is not refused whole.
    place = f"{surveys.ORIGIN_M[0]},{surveys.ORIGIN_M[1]},{surveys.HEIGHT_M}"
    head, *rows = path.read_text().splitlines()
    before, after = (f"{surveys.START_S + far},{place}" for far in (-500, 500))
    path.write_text("\n".join([head, before, *rows, after, ""]))
    texts = notes(surveys.write_workflow(tmp_path))
    (text,) = [text for text in texts if "the trajectory's times are" in text]
    assert "00001_371000000, 00002_371000000: the trajectory's times are " in text
    assert late in text
    assert not [other for other in texts if "N01" in other], "what follows from it"


def test_leap_seconds() -> None:
    for time_s, leap_s in (
        (371_000_000.0, 18), (1_167_264_017.0 - 1e9, 17), (1_167_264_018.0 - 1e9, 18),
        (1_371_000_000.0, 18), (1_100_000_000.0 - 1e9, 16), (90_000.0, 18),
    ):  # fmt: skip
        assert leap_seconds(time_s) == leap_s


@pytest.mark.parametrize(
    ("crs", "height_unit_m", "seem"),
    [
        (None, 0.3048, "feet"),
        ("EPSG:2278", 1.0, "metres"),
        ("EPSG:2278+5703", 1.0, None),
    ],
)
def test_heights_of_a_trajectory_in_another_unit_are_named(
    tmp_path: Path, crs: str | None, height_unit_m: float, seem: str | None
) -> None:
    line = surveys.flightline(shots=1500)
    surveys.write_cloud(tmp_path / "lines" / "line.laz", line)
    surveys.write_trajectory(tmp_path / "trajectory.csv")
    time, x, y, z = np.loadtxt(tmp_path / "trajectory.csv", delimiter=",", skiprows=1).T
    given = CRS.from_user_input(crs or surveys.CRS_NAME)
    flat = given.sub_crs_list[0] if given.is_compound else given
    to_given = Transformer.from_crs(surveys.CRS_NAME, flat, always_xy=True)
    rows = np.column_stack([time, *to_given.transform(x, y), z / height_unit_m])
    np.savetxt(
        tmp_path / "trajectory.csv", rows, "%.6f", delimiter=",", header="gps_time,x,y,z",
        comments="",
    )  # fmt: skip
    texts = notes(surveys.write_workflow(tmp_path, survey={"trajectory_crs": crs}))
    texts = [text for text in texts if text.startswith("T02 trajectory.csv: puts the sensor")]
    assert len(texts) == (seem is not None)
    assert all(f"seem to be in {seem};" in text for text in texts)


@pytest.mark.parametrize(
    ("times", "named"), [(1.0, 0), (3.28, 1), (0.305, 1), (23.0, 0), (0.04, 0)]
)
def test_only_what_feet_explain_is_another_unit(times: float, named: int) -> None:
    n, height = 200, 2000.0
    rng = np.random.default_rng(0)
    slope = rng.uniform(-0.3, 0.3, (n, 2))
    lines = Lines(
        across=-slope * height, slope=slope, height=np.zeros(n), spread=np.ones(n),
        time_s=np.arange(n, dtype=float),
    )  # fmt: skip
    sensor = np.column_stack([np.zeros((n, 2)), np.full(n, height * times)])
    assert (other_unit(lines, sensor) is not None) == bool(named)


@pytest.mark.parametrize(("others", "found"), [(["adjusted"], []), (["week", "none"], ["week 0"])])
def test_files_of_another_clock_are_named(others: list[str], found: list[str]) -> None:
    clocks = ["adjusted", *others]
    files = {
        k: SimpleNamespace(points=100 - k, facts={"standard": clock, "name": f"{clock} {k - 1}"})
        for k, clock in enumerate(clocks)
    }
    survey: Any = SimpleNamespace(of=lambda _: files)
    named = list(findings.other_clocks(survey))
    assert [one.subject for one in named] == found
    assert [one.values["main"] for one in named] == ["adjusted standard time"] * len(found)


@pytest.mark.parametrize(("astern", "off"), [(300_000, []), (60_000, [8.0])])
def test_a_stretch_that_sees_the_survey_ahead_makes_up_for_one_that_sees_it_astern(
    astern: int, off: list[float]
) -> None:
    looks = [(610.0, 200_000), (570.0, 100_000), (-590.0, astern)]
    receipts: list[Any] = [SimpleNamespace(points=50_000, facts={})]
    for ahead_m, points in looks:
        receipts.append(SimpleNamespace(points=points, facts={"ahead": [ahead_m, 2500.0, 49.8]}))
    seconds = [one.values["seconds"] for one in times_off("a", receipts)]
    assert seconds == pytest.approx(off, rel=0.01)


def a_scan(seconds: float, speed_m_s: float, ahead_m: float) -> tuple[BeamTable, np.ndarray]:
    """A cone of 300 m around a place so far ahead of the sensor, flying north-east at 1 km."""
    time = np.linspace(0.0, seconds, 50_000)
    flown = (time * speed_m_s)[:, None] * np.array([[np.sqrt(0.5), np.sqrt(0.5), 0.0]])
    turn = 2 * np.pi * 11.0 * time
    to_return = np.column_stack(
        [300 * np.cos(turn), 300 * np.sin(turn), np.full(len(time), -1000.0)]
    )
    to_return[:, :2] += ahead_m * np.sqrt(0.5)
    length = np.linalg.norm(to_return, axis=1)
    known = np.ones(len(time), np.bool_)
    return BeamTable(flown, to_return / length[:, None], length, known), time


def test_the_mean_of_a_scan_is_where_it_was_put() -> None:
    beams, time = a_scan(4.0, 80.0, 55.0)
    found = look_ahead(beams, time)
    assert found is not None
    assert found == pytest.approx((55.0, 1000.0, 80.0), abs=2.0)
    beams.known[: len(time) // 2] = False
    assert look_ahead(beams, time) is not None
    beams.known[: 4 * len(time) // 5] = False
    assert look_ahead(beams, time) is None, "too short to tell"
    assert look_ahead(*a_scan(4.0, 0.1, 55.0)) is None, "a sensor that stands has no direction"


def test_shots_that_share_one_time_are_told(small: Path) -> None:
    step_s = 0.02
    for k in (1, 2):
        line = surveys.flightline(shots=120, psid=k, start_s=surveys.START_S + 3 * (k - 1), seed=k)
        line["gps_time"] = np.round(line["gps_time"] / step_s) * step_s
        surveys.write_cloud(small.parent / "lines" / f"line_{k}.laz", line)
    (text,) = [text for text in notes(small) if "not lie on one beam" in text]
    assert "rounded to more than the time between shots" in text
