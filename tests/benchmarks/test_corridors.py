"""The wire metric of the benchmarks: regions around catenaries, and what is counted in them."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.airborne.filter.methods import AFTERPULSE, BACKGROUND, OTHER, WIRE, Columns
from benchmarks.airborne.published import corridors
from benchmarks.airborne.published.table_setups import set_up
from benchmarks.airborne.published.twins import TWINS

ORIGIN = (1000.0, 2000.0, 50.0)


def _survey(folder: Path) -> Path:
    """Two cables above each other on the same towers, 100 m due east, hardly sagging."""
    level = 1e6
    rows = [[10.0, 20.0, 1.0, 0.0, 100.0, level, 50.0, z - level, 0.01, 0.4] for z in (60.0, 62.0)]
    entry = {"kind": "distribution", "points_m": [[10, 20], [110, 20]], "conductors": 1,
             "shield": False}  # fmt: skip
    content = {"scene": {"origin_m": ORIGIN, "wires": [entry, entry]}, "wires": rows}
    (folder / "truth").mkdir()
    (folder / "truth" / "scene.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


def _points(rows: list[tuple[float, float, float, int]]) -> Columns:
    east, north, z, kind = (np.array(column) for column in zip(*rows, strict=True))
    return {"x": east + 1010.0, "y": north + 2020.0, "z": z, "kind": kind}


def test_cables_on_the_same_towers_are_one_line(tmp_path: Path) -> None:
    ((kind, spans),) = corridors.lines(_survey(tmp_path))
    assert kind == "distribution"
    assert len(spans) == 1
    assert len(spans[0].strands) == 2


def test_region_is_seven_by_seven_metres_around_the_middle(tmp_path: Path) -> None:
    ((_, spans),) = corridors.lines(_survey(tmp_path))
    rows = [(50, 3.4, 61.0, 0), (50, 3.6, 61.0, 0), (50, 0, 64.4, 0), (50, 0, 64.6, 0),
            (50, 0, 57.6, 0), (50, 0, 57.4, 0), (-1, 0, 61.0, 0), (101, 0, 61.0, 0)]  # fmt: skip
    within = corridors.region(spans, _points([(float(e), float(n), z, k) for e, n, z, k in rows]))
    assert within.tolist() == [True, False, True, False, True, False, False, False]


def test_distance_is_to_the_nearest_strand(tmp_path: Path) -> None:
    ((_, spans),) = corridors.lines(_survey(tmp_path))
    points = _points([(50.0, 0.3, 60.4, 0), (50.0, 0.0, 62.2, 0), (150.0, 0.0, 60.0, 0)])
    assert corridors.nearest_m(spans, points) == pytest.approx([0.5, 0.2, np.inf], abs=2e-3)


def test_poles_count_as_neither_wire_nor_noise() -> None:
    kinds = [WIRE, WIRE, BACKGROUND, AFTERPULSE, OTHER]
    points = _points([(50.0, 0.0, 61.0, kind) for kind in kinds])
    kept = np.array([True, False, True, False, True])
    found = corridors.count(points, kept, np.ones(5, dtype=np.bool_))
    assert found == corridors.Counts(wire=2, wire_kept=1, noise=2, noise_kept=1)
    assert found.detection == pytest.approx(50.0)
    assert found.false_alarm == pytest.approx(50.0)


@pytest.mark.parametrize("name", TWINS)
def test_twins_are_scenes_that_differ_by_seed(name: str) -> None:
    first, again, other = TWINS[name](1), TWINS[name](1), TWINS[name](2)
    assert first == again
    assert first.flights != other.flights


@pytest.mark.parametrize(
    ("name", "said"),
    [("easton", (3, 3500.0, 9.0, 60e3, 300.0)), ("lufkin", (3, 2000.0, 15.0, 50e3, 85.0))],
)
def test_twins_are_flown_as_the_source_says(name: str, said: tuple[float, ...]) -> None:
    assert set_up(TWINS[name](1))[:5] == said  # [W18] 2.1
    assert set_up(TWINS["houston"](1)).altitude_m == 4200.0  # [W17] 7.3


def test_flightlines_flown_apart_have_no_common_set_up() -> None:
    scene = TWINS["easton"](1)
    lower = scene.flights[0].model_copy(update={"altitude_agl_m": 900.0})
    with pytest.raises(ValueError, match="differ in altitude"):
        set_up(scene.model_copy(update={"flights": (lower, *scene.flights[1:])}))
