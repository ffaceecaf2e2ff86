"""The page "Is it good enough?": limits, verdicts, and nothing that passes for want of evidence."""

from dataclasses import replace

import pytest

from spl_batch.airborne.accuracy.checkpoint_errors import CheckpointError, at_checkpoints
from spl_batch.airborne.accuracy.evidence import Evidence, PulseTotals, SwathDifferences
from spl_batch.airborne.accuracy.requirements import answers, requirements
from spl_batch.airborne.pulses.swaths import SwathTotals
from spl_batch.airborne.settings.standards import LEVELS
from spl_batch.engine.report.number_format import as_ascii
from spl_batch.formats.units import Units

NOTHING = Evidence(
    level="QL2",
    rmse_v_m=0.10,
    pulses_per_m2=2.0,
    nva=None,
    vva=None,
    pulses=None,
    single=True,
    by_swath={},
    water_known=True,
    swaths=None,
    flightlines=3,
    classes={1: 10, 2: 20, 7: 3, 18: 4},
    withheld_unclassified=0,
    filtered=True,
    has_crs=True,
    vertical_datum="NAVD88 height",
    time_standard="adjusted",
)
GOOD = PulseTotals(pulses=2000, area_m2=1000.0, squares=500, filled=450, void_m2=0.0, bare_m2=0.0)
LAKES, SPARSE = (replace(GOOD, pulses=n, void_m2=580.0) for n in (840, 839))
DENSITY, EVEN = "Aggregate nominal pulse density", "Spatial distribution"
SWATH = SwathTotals(700.0, 1500, 600.0, 1200, 300, 270)
THIN, PATCHY = SWATH._replace(middle_pulses=1199), SWATH._replace(filled=269)
TINY = SwathTotals(5.0, 2, 5.0, 2, 9, 1)


def of(*swaths: SwathTotals) -> dict[str, SwathTotals]:
    return {f"0000{k}_1": swath for k, swath in enumerate(swaths)}


def verdict(known: Evidence, name: str) -> str:
    return next(row.verdict for row in requirements(known) if row.name == name)


def checkpoints(n: int, error: float, accuracy: float | None = 0.0):
    return at_checkpoints([CheckpointError(str(k), error * (-1) ** k, accuracy) for k in range(n)])


def test_the_limits_are_those_of_the_specification() -> None:
    # USGS Lidar Base Specification, in centimetres, pulses per m2 and metres
    table = {
        "QL0": (5, 8, 0.35, 4),
        "QL1": (10, 8, 0.35, 8),
        "QL2": (10, 2, 0.71, 8),
        "QL3": (20, 0.5, 1.41, 16),
    }
    for name, (rmse, density, spacing, overlap) in table.items():
        level = LEVELS[name]
        assert level.rmse_v_m == pytest.approx(rmse / 100)
        assert level.pulses_per_m2 == density
        assert level.spacing_m == spacing == pytest.approx(density**-0.5, abs=0.006)
        assert level.overlap_rmsd_m == pytest.approx(overlap / 100) == pytest.approx(0.008 * rmse)


def test_what_nobody_measured_cannot_be_told() -> None:
    measured = ("Points never classified", "Noise", "Overlap by flag", "Vertical datum", "GPS time")
    for row in requirements(NOTHING):
        assert row.verdict == ("pass" if row.name in measured else "cannot tell"), row.name
        assert row.why
        assert row.standard
        assert row.section
    assert answers(row.verdict for row in requirements(NOTHING)) == {
        "pass": 5,
        "fail": 0,
        "cannot tell": 7,
    }


@pytest.mark.parametrize(
    ("change", "name", "expected"),
    [
        ({"nva": checkpoints(30, 0.0999)}, "Absolute vertical accuracy, NVA", "pass"),
        ({"nva": checkpoints(30, 0.1001)}, "Absolute vertical accuracy, NVA", "fail"),
        ({"nva": checkpoints(30, 0.09, 0.05)}, "Absolute vertical accuracy, NVA", "fail"),
        ({"nva": checkpoints(29, 0.01)}, "Absolute vertical accuracy, NVA", "cannot tell"),
        ({"nva": checkpoints(30, 0.01, None)}, "Absolute vertical accuracy, NVA", "cannot tell"),
        ({"vva": checkpoints(30, 0.5)}, "Absolute vertical accuracy, VVA", "pass"),
        ({"nva": checkpoints(31, 0.9)}, "Systematic error", "fail"),
        ({"nva": checkpoints(30, 0.9)}, "Systematic error", "pass"),
        ({"pulses": GOOD}, DENSITY, "cannot tell"),
        ({"pulses": replace(GOOD, pulses=1999)}, DENSITY, "fail"),
        ({"pulses": GOOD, "single": False}, DENSITY, "pass"),
        ({"pulses": GOOD, "single": False, "by_swath": of(THIN)}, DENSITY, "pass"),
        ({"pulses": replace(GOOD, pulses=1999), "single": False}, DENSITY, "fail"),
        ({"pulses": GOOD, "by_swath": of(SWATH, SWATH)}, DENSITY, "pass"),
        ({"pulses": GOOD, "by_swath": of(SWATH, THIN)}, DENSITY, "fail"),
        ({"pulses": GOOD, "by_swath": of(SWATH, TINY)}, DENSITY, "pass"),
        ({"pulses": GOOD, "by_swath": {**of(SWATH), "": TINY}}, DENSITY, "pass"),
        ({"pulses": GOOD, "by_swath": {**of(SWATH), "": SWATH}}, DENSITY, "cannot tell"),
        ({"pulses": GOOD}, EVEN, "cannot tell"),
        ({"pulses": replace(GOOD, filled=449)}, EVEN, "fail"),
        ({"pulses": GOOD, "single": False}, EVEN, "pass"),
        ({"pulses": GOOD, "by_swath": of(SWATH, SWATH)}, EVEN, "pass"),
        ({"pulses": GOOD, "by_swath": of(SWATH, PATCHY)}, EVEN, "fail"),
        ({"pulses": GOOD}, "Data voids", "pass"),
        ({"pulses": replace(GOOD, void_m2=8.0)}, "Data voids", "fail"),
        ({"pulses": replace(GOOD, void_m2=8.0), "water_known": False}, "Data voids", "cannot tell"),
        ({"pulses": LAKES, "water_known": False}, "Data voids", "cannot tell"),
        ({"pulses": SPARSE, "water_known": False}, "Data voids", "fail"),
        ({"pulses": replace(GOOD, bare_m2=11.0)}, "Data voids", "cannot tell"),
        ({"nva": checkpoints(30, 0.05, 0.051)}, "Absolute vertical accuracy, NVA", "cannot tell"),
        ({"swaths": SwathDifferences(0.08, 3, 9)}, "Swath overlap difference", "pass"),
        ({"swaths": SwathDifferences(0.081, 3, 9)}, "Swath overlap difference", "fail"),
        ({"classes": {0: 1}}, "Points never classified", "fail"),
        ({"classes": {0: 3}, "withheld_unclassified": 3}, "Points never classified", "pass"),
        ({"classes": {0: 4}, "withheld_unclassified": 3}, "Points never classified", "fail"),
        ({"classes": {12: 1}}, "Overlap by flag", "fail"),
        ({"filtered": False}, "Noise", "cannot tell"),
        ({"vertical_datum": None}, "Vertical datum", "fail"),
        ({"time_standard": "week"}, "GPS time", "fail"),
        ({"time_standard": None}, "GPS time", "cannot tell"),
    ],
)  # fmt: skip
def test_each_verdict_turns_at_its_limit(change: dict, name: str, expected: str) -> None:
    assert verdict(replace(NOTHING, **change), name) == expected


def test_lengths_are_in_the_unit_of_delivery_with_metres_beside() -> None:
    asked = []
    for units in (Units(), Units("US survey foot", 1200 / 3937, "metre", 1.0)):
        rows = requirements(replace(NOTHING, units=units))
        asked += [as_ascii(row.required) for row in rows if "square" in row.required]
    within = "hold a first return, within the edges of each flightline"
    assert asked == [
        f"90 % of squares of 1.42 m {within}",
        "no empty square of 2.84 m, water excepted",
        f"90 % of squares of 4.66 ft (1.42 m) {within}",
        "no empty square of 9.32 ft (2.84 m), water excepted",
    ]
