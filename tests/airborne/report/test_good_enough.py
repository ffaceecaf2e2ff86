"""Findings of the page "Is it good enough?", and what they rest on, added up by hand."""

import math
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import pytest

from spl_batch.airborne.lines.pair_table import StripPair
from spl_batch.airborne.report.good_enough import (
    _swaths,
    _time_standard,
    checkpoint_findings,
    sparse_vegetation,
)
from spl_batch.airborne.report.model import (
    Checkpoint,
    Checkpoints,
    CheckpointStatistics,
    Density,
)
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.settings.requirements import RequirementSettings
from spl_batch.engine.findings import Finding


def pair(first: str, second: str, patches: int, rmsd: float | None) -> StripPair:
    return StripPair(
        first=first, second=second, patches=patches, area_m2=1.0, centre_m=(0.0, 0.0), up_m=0.0,
        up_sd_m=0.01, east_m=None, north_m=None, horizontal_sd_m=None, flat_patches=patches,
        rmsd_z_m=rmsd, noise_m=0.02, squares=1,
    )  # fmt: skip


def test_pairs_count_by_their_places() -> None:
    pairs = [pair("1", "2", 10, 0.03), pair("2", "3", 30, 0.05)]
    found = _swaths([*pairs, pair("1", "3", 0, None)])
    assert found is not None
    squares = 10 * 0.03**2 + 30 * 0.05**2
    assert found.rmsd_m == pytest.approx(math.sqrt(squares / 40))
    assert (found.pairs, found.places) == (2, 40)
    assert _swaths([pair("1", "3", 0, None)]) is None


def test_a_file_in_week_time_among_adjusted_ones_shows() -> None:
    adjusted, week = ((3.7e8, 3.7e8 + 60), (2e5, 2e5 + 60))
    spans = [SimpleNamespace(first_s=first, last_s=last) for first, last in (adjusted, week)]
    flown: Any = spans
    assert _time_standard(flown) == "adjusted and week"
    assert _time_standard(flown[:1]) == "adjusted"


CONTEXT: Any = SimpleNamespace(workflow=SimpleNamespace(requirements=RequirementSettings()))


def found_at(rows: Iterable[tuple[float, float]], odd: int = -1) -> list[Finding]:
    """Findings of open checkpoints, by the height and the error of each and which is an outlier."""
    points = [
        Checkpoint(
            id=f"{k}", x_m=1.0, y_m=2.0, z_m=z, surface="open", error_m=error, outlier=k == odd
        )
        for k, (z, error) in enumerate(rows)
    ]
    at = CheckpointStatistics(n=3), CheckpointStatistics(n=0)
    tested = Checkpoints(statement="", nva=at[0], vva=at[1], points=tuple(points))
    return list(checkpoint_findings(tested, CONTEXT))


@pytest.mark.parametrize(("unit_m", "feet"), [(0.3048, True), (1.0, False)])
def test_checkpoints_in_feet_are_named(unit_m: float, *, feet: bool) -> None:
    given = [(z, (z + 0.02) / unit_m) for z in (99.0, 101.5, 104.0)]
    found = found_at((z, terrain - z) for terrain, z in given)
    assert [one.values["kind"] for one in found] == ["feet"] * feet


@pytest.mark.parametrize(("error_m", "warned"), [(-2.5, True), (0.31, True), (0.25, False)])
def test_a_checkpoint_with_a_blunder_is_warned_of(error_m: float, *, warned: bool) -> None:
    said = found_at(((3.0, error) for error in (0.01, -0.02, error_m)), odd=2)
    assert len(said) == warned
    assert all(one.values["worst"] == "2" for one in said)
    assert all(one.values["error_m"] == pytest.approx(error_m) for one in said)
    assert not list(checkpoint_findings(None, CONTEXT))


@pytest.mark.parametrize(
    ("per_m2", "few"), [(0.24, True), (0.99, True), (1.0, False), (None, False)]
)
def test_vegetation_of_few_returns_is_warned_of(per_m2: float | None, *, few: bool) -> None:
    asked = ClassSettings.model_validate({"vegetation": {}})
    found = sparse_vegetation(Density(mean_per_m2=per_m2), asked)
    assert [one.code for one in found] == ["G03"] * few
    assert sparse_vegetation(Density(mean_per_m2=per_m2), ClassSettings()) == ()
