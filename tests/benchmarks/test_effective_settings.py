"""Rows of the sources' tables are what they claim to be; no run is needed to tell."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from benchmarks.airborne.published.methods import (
    AS_W17,
    BY_PLANE,
    Method,
    check,
    effective,
    known_methods,
    unmet,
)
from benchmarks.airborne.published.table_surfaces import roof_methods
from benchmarks.airborne.published.table_terrain import terrain_methods
from benchmarks.airborne.published.twins import houston_deep
from spl_batch.airborne.settings.workflow import load_workflow

ROWS: Mapping[str, Method] = {
    f"{table}: {name}": method
    for table, rows in (
        ("filters", known_methods()), ("roofs", roof_methods()), ("terrain", terrain_methods()),
    )
    for name, method in rows.items()
}  # fmt: skip
KEYS = {"filter.method", "noise.correction", "afterpulse.enabled"}
"""What every row says of itself."""


@pytest.fixture(scope="module")
def workflow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workflow of defaults."""
    path = Path(tmp_path_factory.mktemp("rows")) / "workflow.yaml"
    path.write_text("survey:\n  flightlines: a.laz\noutput: out\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_what_it_claims(row: str, workflow: Path) -> None:
    method = ROWS[row]
    assert method.claims.keys() >= KEYS
    assert method.claims["filter.method"] != "vsaes" or "filter.neighbours" in method.claims
    assert "terrain" not in row or "ground.method" in method.claims
    assert not unmet(workflow, (*method.shots, *method.settings), method.claims)


def test_without_channel_numbers_the_rule_is_still_ours(workflow: Path) -> None:
    before = ("filter.test=published", "noise.correction=published",
              "survey.channel_dimension=null")  # fmt: skip
    assert unmet(workflow, before, AS_W17 | BY_PLANE) == {"afterpulse.method": "beamlet"}
    with pytest.raises(SystemExit, match=r"afterpulse\.method"):
        check(workflow, before, AS_W17 | BY_PLANE)


def test_settings_of_a_ground_that_is_not_chosen_have_no_effect(workflow: Path) -> None:
    before = ("ground.ptd.layer_m=0.001", "ground.ptd.seed_cell_m=20")
    found = unmet(workflow, before, {"ground.method": "ptd"})
    assert found == {
        "ground.method": "multiscale", "ground.ptd.layer_m": None, "ground.ptd.seed_cell_m": None,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("overrides", "idle"),
    [
        (("filter.method=aes", "filter.neighbours=15"), "filter.neighbours"),
        (("filter.test=published", "filter.wires.alpha=0.0001"), "filter.wires.alpha"),
        (("afterpulse.enabled=false", "afterpulse.method=published"), "afterpulse.method"),
        (("afterpulse.method=published", "afterpulse.lag_max_m=3"), "afterpulse.lag_max_m"),
    ],
)
def test_what_does_not_act_is_not_effective(
    overrides: tuple[str, ...], idle: str, workflow: Path
) -> None:
    assert idle not in effective(load_workflow(workflow, overrides))
    assert unmet(workflow, overrides, {}) == {idle: None}


def test_lags_of_the_deep_twin_reach_as_far_as_the_terrain_is_off() -> None:
    assert houston_deep(1).detector.afterpulse_lag_max_m == 5.0
