"""Rows of the sources' page are what they claim to be, and the page is that of its figures."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from benchmarks.geiger.coincidence import known_scene
from benchmarks.geiger.water import water_surface
from benchmarks.sources import coincidence, page, tank, tracks
from benchmarks.sources.__main__ import GROUPS
from benchmarks.sources.methods import (
    AS_W17,
    BY_PLANE,
    Method,
    check,
    effective,
    known_methods,
    unmet,
)
from benchmarks.sources.surfaces import roof_methods
from benchmarks.sources.terrain import terrain_methods
from benchmarks.sources.twins import TWINS
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.simulate import simulate
from spl_batch.geiger.coincidence.settings import CoincidenceSettings

ROWS: Mapping[str, Method] = {
    f"{table}: {name}": method
    for table, rows in (
        ("filters", known_methods()), ("roofs", roof_methods()), ("terrain", terrain_methods()),
    )
    for name, method in rows.items()
}  # fmt: skip
KEYS = {"filter.method", "noise.correction", "afterpulse.enabled"}
"""What every row claims of itself."""


@pytest.fixture(scope="module")
def workflow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Workflow of a tiny twin, as each row runs it."""
    folder = Path(tmp_path_factory.mktemp("rows"))
    simulate(TWINS["canopy matched"](1, 0.15), folder)
    return folder / "workflow.yaml"


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


def test_twins_are_what_the_page_states_of_them() -> None:
    assert TWINS["houston deep"](1).detector.afterpulse_lag_max_m == 5.0
    for name in ("easton", "lufkin", "canopy"):
        assert TWINS[name](1).detector.afterpulse_probability is None
        assert TWINS[f"{name} matched"](1).detector.afterpulse_probability == 0.04
    assert TWINS["canopy matched"](1).sky.background_per_m3 == 0.12


def test_rows_of_other_receivers_are_what_they_claim() -> None:
    found = {name: one.signal for name, one in tracks.settings().items()}
    methods = {name: one.method for name, one in found.items()}
    assert methods == {
        "bayes": "published", "mdbscan": "mdbscan", "scaled": "mdbscan", "ours": "likelihood",
    }  # fmt: skip
    assert not found["mdbscan"].mdbscan.scaled
    assert found["scaled"].mdbscan.scaled
    chosen = [
        CoincidenceSettings.model_validate(known_scene.SETTINGS[name]).method
        for name in coincidence.METHODS
    ]
    assert chosen == ["published", "bridge_sign"]
    assert water_surface.SOURCE_WAY.method == "windowed"
    assert water_surface.OURS.method != "windowed"
    assert tank.WAYS.keys() == {"source", "ours"}


def test_the_page_is_that_of_its_figures() -> None:
    known = page.load()
    text = page.text(known)
    assert page.PAGE.read_text(encoding="utf-8") == text
    assert len(text.splitlines()) <= 150
    rows = [line for line in text.splitlines() if line.endswith(tuple(f" {g} |" for g in GROUPS))]
    assert {row.rsplit("| ", 1)[1].removesuffix(" |") for row in rows} == set(GROUPS)
