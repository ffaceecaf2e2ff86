"""What each kind of evidence finds under roofs and ground, in a small survey with truth."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.airborne.afterpulse import afterpulse_tables
from benchmarks.airborne.afterpulse.afterpulse_bound import Best
from benchmarks.airborne.afterpulse.afterpulse_scenes import WATERS, scene
from benchmarks.airborne.afterpulse.afterpulses import AFTERPULSE, BOTTOM, GROUND, ROOF, labels
from spl_batch.airborne.afterpulse import afterpulse_decision
from spl_batch.airborne.settings import AfterpulseSettings
from spl_batch.lattice.tables import PointTable

SCENE = scene(
    "hard", 3, (0.15, 0.7), extent_m=[36, 36], terrain={"relief_m": 2},
    buildings={"list": [{"centre_m": [12, 18], "size_m": [18, 14], "roof": "gable"},
                        {"centre_m": [28, 10], "size_m": [10, 10], "roof": "flat"}]},
)  # fmt: skip


def no_bound(_: object, time: NDArray[np.float64], *__: object) -> Best:
    """What is known of the simulation is not asked for here."""
    return Best(np.zeros(len(time)), np.zeros(len(time)))


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> afterpulse_tables.Prepared:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(afterpulse_tables, "echo_chance", no_bound)
        return afterpulse_tables.prepare(SCENE, Path(tmp_path_factory.mktemp("hard")))


def resolved(survey: afterpulse_tables.Prepared, table: PointTable) -> NDArray[np.bool_]:
    return afterpulse_decision.resolve(table, survey.density, AfterpulseSettings()).echo


@pytest.mark.parametrize(("of", "by_planes"), [(ROOF, 0.8), (GROUND, 0.95)])
def test_under_hard_surfaces_parents_and_planes_each_find_them(
    survey: afterpulse_tables.Prepared, of: int, by_planes: float
) -> None:
    mine, surface = (survey.kind == AFTERPULSE) & (survey.parent == of), survey.kind == of
    assert mine.sum() > 1000
    # Whatever is an afterpulse has a parent in its own channel.
    assert (survey.table["afterpulse_rate"][mine] > 0).mean() > 0.99
    # The shot's planes are withheld: parent, lag and what other beamlets see are left.
    withheld = survey.table.with_columns(afterpulse=survey.table["afterpulse"].clip(max=0.49))
    without = resolved(survey, withheld)
    assert without[mine].mean() >= 0.95
    planes = afterpulse_decision.believed(survey.table).echo
    assert planes[mine].mean() >= by_planes
    together = resolved(survey, survey.table)
    assert together[mine].mean() >= 0.97
    for found in (without, planes, together):
        assert found[surface].mean() <= 0.001


@pytest.mark.parametrize("polygons", [True, False])
def test_true_bottoms_of_clear_water_stay(tmp_path: Path, *, polygons: bool) -> None:
    # A true bottom has an afterpulse's signature: a return of its beamlet a short way in front.
    content = WATERS[1] | {"extent_m": [36, 36], "trees": {"cover": 0.0}}
    water = {**content["water"][0], "ring_m": [[6, 6], [31, 7], [30, 31], [7, 30]]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(afterpulse_tables, "echo_chance", no_bound)
        lake = afterpulse_tables.prepare(content | {"water": [water]}, tmp_path, polygons=polygons)
    found = labels(lake)
    assert (lake.kind == BOTTOM).sum() > 500
    assert found["bottom kept"] >= 95
    assert found["ground kept"] >= 99.5
    assert found["afterpulses of ground removed"] >= 97


def test_lags_that_the_sensor_does_not_state_are_followed(tmp_path: Path) -> None:
    tail = {"share": 1.0, "scale_m": 0.5, "power": 1.5}
    detector = {"afterpulse_probability": 0.25, "afterpulse_lag_max_m": 15.0, "tail": tail}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(afterpulse_tables, "echo_chance", no_bound)
        survey = afterpulse_tables.prepare(SCENE | {"detector": detector}, tmp_path)
    mine = (survey.kind == AFTERPULSE) & (survey.parent == GROUND)
    late = mine & (survey.table["afterpulse_rate"] > 0) & (survey.table["afterpulse_rate"] < 8e-3)
    assert late.sum() > 100
    found = resolved(survey, survey.table)
    assert found[mine].mean() >= 0.95
    assert found[late].mean() >= 0.9
    assert found[survey.kind == GROUND].mean() <= 0.001


def test_surfaces_are_as_thick_as_the_ranging_noise(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(afterpulse_tables, "echo_chance", no_bound)
        survey = afterpulse_tables.prepare(SCENE | {"detector": {"range_sigma_m": 0.15}}, tmp_path)
    sigma = float(survey.table["range_sigma"].max())
    assert sigma == pytest.approx(0.15, abs=0.02)
    found = resolved(survey, survey.table)
    for of in (GROUND, ROOF):
        assert found[survey.kind == of].mean() <= 0.005
        mine = (survey.kind == AFTERPULSE) & (survey.parent == of)
        assert found[mine].mean() > 0.8
