"""Pairs of flightlines with a known shift, aligned ones, and what is said of them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne import receiver
from spl_batch.airborne.lines.alignment import AlignedLine
from spl_batch.airborne.lines.comparison import done_sentence, offset_warnings
from spl_batch.airborne.lines.pair_table import (
    DETERMINED_M,
    FEWEST,
    StripPair,
    pair_table,
)
from spl_batch.airborne.lines.patches import Patches, find_patches, rows_of
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.report.reported import reported
from spl_batch.formats.units import METRES, US_FOOT, Units
from tests.airborne.lines.two_strips import (
    CORE,
    NAMES,
    Heights,
    Shift,
    hills,
    two_strips,
)

SEEDS = range(6)


@dataclass(frozen=True)
class Scene:
    """What was flown over, and with which noise."""

    heights: Heights = hills
    noise_m: float = 0.05


def patches_of(shift: Shift, scene: Scene = Scene(), seed: int = 0) -> Patches:
    points = two_strips(shift, noise_m=scene.noise_m, heights=scene.heights, seed=seed)
    return find_patches(points, CORE)[0]


def pair(shift: Shift, scene: Scene = Scene(), seed: int = 0) -> StripPair:
    (found,) = pair_table(patches_of(shift, scene, seed), NAMES)
    return found


@pytest.mark.parametrize("shift", [Shift(), Shift(0.3, -0.2, 0.2), Shift(-0.1, 0.4, -0.05)])
@pytest.mark.parametrize("noise_m", [0.05, 0.15])
def test_known_shifts_are_found_within_their_errors(shift: Shift, noise_m: float) -> None:
    found = [pair(shift, Scene(noise_m=noise_m), seed) for seed in SEEDS]
    for wanted, name, error in (
        (shift.east, "east_m", "horizontal_sd_m"),
        (shift.north, "north_m", "horizontal_sd_m"),
        (shift.up, "up_m", "up_sd_m"),
    ):
        values = np.array([getattr(one, name) for one in found])
        promised = np.array([getattr(one, error) for one in found])
        assert abs(values.mean() - wanted) < 4 * promised.mean() / np.sqrt(len(values)) + 0.002
        assert np.abs(values - wanted).max() < 5 * promised.max()
    assert np.mean([one.noise_m for one in found]) == pytest.approx(noise_m, rel=0.12)
    assert found[0].horizontal_sd_m < DETERMINED_M  # type: ignore[operator]


def test_aligned_flightlines_are_null_and_nothing_is_said() -> None:
    for seed in range(20):
        found = pair(Shift(), seed=seed)
        assert abs(found.up_m) < 4 * found.up_sd_m
        assert list(offset_warnings([found])) == []


def test_few_patches_make_no_pair_and_the_lesser_name_comes_first() -> None:
    patches = patches_of(Shift(up=0.2))
    few = rows_of(patches, np.arange(FEWEST))
    (found,) = pair_table(few, NAMES)
    assert found.patches == FEWEST
    assert pair_table(rows_of(patches, np.arange(FEWEST - 1)), NAMES) == []
    assert pair_table(rows_of(patches, np.arange(0)), NAMES) == []
    (turned,) = pair_table(few, {1: "two", 2: "one"})
    assert (turned.first, turned.second, turned.up_m) == ("one", "two", -found.up_m)
    third = {**few, "second": np.full(FEWEST, 3)}
    three = {name: np.concatenate([few[name], third[name]]) for name in few}
    names = {1: "two", 2: "one", 3: "three"}
    assert [(one.first, one.second) for one in pair_table(three, names)] == [
        ("one", "two"),
        ("three", "two"),
    ]


@pytest.mark.parametrize(
    ("east_m", "squares", "told"),
    [(0.11, 1, False), (0.11, 4, False), (0.11, 40, True), (0.25, 1, True), (0.25, 4, True)],
)
def test_few_squares_tell_no_small_horizontal_difference(
    east_m: float,
    squares: int,
    told: bool,  # noqa: FBT001 - a parameter of the test
) -> None:
    found = replace(
        pair(Shift()), east_m=east_m, north_m=0.0, horizontal_sd_m=0.015, squares=squares
    )
    assert found.is_off_horizontally == told
    assert len(list(offset_warnings([found]))) == told


def test_the_worst_pair_is_named_with_number_and_place() -> None:
    (one,) = offset_warnings([pair(Shift(0.3, -0.2, 0.2))])
    assert (one.code, one.values["second"]) == ("S01", "two")
    assert one.values["up_m"] == pytest.approx(0.2, abs=0.01)
    assert one.values["offset_m"][0] == (pytest.approx(0.2, abs=0.01), "higher")
    assert "0.2" in reported([one])[0].sentence
    assert one.place is not None
    assert one.place[0] == pytest.approx(10_040, abs=5)
    many = [replace(pair(Shift(up=0.2)), second=f"s{k}") for k in range(6)]
    (worst,) = offset_warnings([*many, pair(Shift())])
    assert worst.values["pairs"] == 6


FEET = Units(US_FOOT, 1200 / 3937, US_FOOT, 1200 / 3937)


def test_a_run_names_shifts_in_the_unit_of_delivery(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [AlignedLine("one", 0.0, None, stays="kept"), AlignedLine("two", 0.2, 0.2, stays="")]
    monkeypatch.setattr(receiver, "shifts_of", lambda _: lines)
    survey: Any = SimpleNamespace(
        of=lambda _: {},
        workflow=SimpleNamespace(survey=SimpleNamespace(align="vertical")),
    )
    prepared: Any = SimpleNamespace(ledger=survey, context=SimpleNamespace(shown_units=FEET))
    (note,) = receiver.RECEIVER.after(STEPS["align"], prepared, [])
    assert "up to 0.656 ft (20.0 cm) in height" in note.values["what"]


@pytest.mark.parametrize(
    ("units", "up", "east"),
    [(METRES, "20.0 cm", "30.0 cm"), (FEET, "0.656 ft (20.0 cm)", "0.984 ft (30.0 cm)")],
)
def test_differences_and_shifts_are_in_the_unit_of_delivery(
    units: Units, up: str, east: str
) -> None:
    found = replace(pair(Shift(0.3, -0.2, 0.2)), up_m=0.2, east_m=0.3, north_m=-0.2)
    (said,) = reported(offset_warnings([found]), units=units)
    offset = f"{up} higher and {east} farther east and {up} farther south"
    assert f"at worst two lies {offset} than one (" in said.sentence
    shifts = [AlignedLine("one", 0.0, None, stays="kept"), AlignedLine("two", -0.2, -0.2, stays="")]
    assert f"1 of 2 flightlines was shifted by up to {up} in height" in done_sentence(shifts, units)
