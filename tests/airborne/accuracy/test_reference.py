"""Reference points by square: what is said of a point does not depend on the cutting."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch import api
from spl_batch.airborne.accuracy.differences import surface_differences, terrain_differences
from spl_batch.airborne.accuracy.error_tally import Tallies, accuracy_report, tallies
from spl_batch.airborne.accuracy.raster_and_reference import Raster, Reference
from spl_batch.airborne.plan import reference_tasks as planned
from spl_batch.airborne.store.label_tables import labelled
from spl_batch.airborne.tasks.accuracy import compared
from spl_batch.constants import NODATA
from spl_batch.engine.tasks.runner import run_task
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.planning import prepare
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.verified.parquet_npz import read_arrays
from tests import surveys

SIDE_M = 120

Columns = dict[str, np.ndarray[Any, Any]]


@pytest.fixture(scope="module")
def points() -> Columns:
    """Ground with plants and roofs on it, in no order: 4 000 points on 120 m."""
    rng = np.random.default_rng(5)
    n = 4000
    kind = rng.choice([2, 5, 6, 9, 7], n, p=[0.6, 0.2, 0.12, 0.06, 0.02])
    return {
        "x": np.round(1000.0 + rng.uniform(0, SIDE_M, n), 3),
        "y": np.round(2000.0 + rng.uniform(0, SIDE_M, n), 3),
        "z": np.round(10 + rng.normal(0, 0.2, n) + np.where(kind == 2, 0, 4), 3),
        "classification": kind.astype(np.uint8),
    }


@pytest.fixture(scope="module")
def rasters() -> dict[str, Raster]:
    """Rough rasters with voids."""
    rng = np.random.default_rng(6)
    found = {}
    for name, mean_m, spread_m in (("dtm", 10, 1), ("dsm", 11, 1), ("chm", 0.2, 0.2)):
        values = rng.normal(mean_m, spread_m, (140, 140)).astype(np.float32)
        values[rng.random(values.shape) < 0.05] = NODATA
        found[name] = Raster(values, 990.0, 2130.0, 1.0)
    return found


def whole(points: Columns, rasters: dict[str, Raster]) -> tuple[Tallies, Tallies]:
    """What all points at once say: the oracle."""
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    known = Reference(xyz, points["classification"])
    terrain = terrain_differences(rasters["dtm"], known, chm=rasters["chm"])
    return tallies(terrain), tallies(surface_differences(rasters["dsm"], known))


@pytest.mark.parametrize("files", [1, 3])
def test_squares_say_what_all_points_at_once_say(
    files: int,
    points: Columns,
    rasters: dict[str, Raster],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(planned, "STRETCH_POINTS", 300)
    for k in range(files):
        part = surveys.take(points, slice(k, None, files))
        surveys.write_cloud(tmp_path / f"ref_{k}.laz", part, channel=False)
    surveys.small_survey(tmp_path, reference={"points": "ref_*.laz"})
    prepared = prepare(tmp_path / "workflow.yaml", [])
    survey, context = prepared.ledger, prepared.context
    survey.of("surface").put(Receipt("surface", "0_0", "", "d", "", {}, {}, 0, 0.0, 0.0))
    for name, raster in rasters.items():
        write_cog(
            context.output / f"{name}.tif",
            raster.values,
            shape=raster.values.shape,
            origin_xy_m=(raster.left_m, raster.top_m),
            cell_m=raster.cell_m,
            crs=None,
            description=name,
        )
        mosaic = Receipt("mosaic", name, "", "d", "", {}, {}, 0, 0.0, 0.0)
        survey.of("mosaic").put(mosaic)
    for kind in ("reference", "accuracy"):
        for task in list(getattr(planned, kind)(survey)):
            bound = replace(task, args=labelled(task.args, task.needs))
            receipt = run_task(bound, "", context)
            assert not receipt.failed, receipt.reason
            survey.of(kind).put(receipt)
    assert len(survey.of("reference")) == files
    assert len(survey.of("accuracy")) > 9
    assert sum(r.points for r in survey.of("accuracy").values()) == len(points["x"])
    assert max(sum(read_arrays(path)["count"]) for path in squares(context.output)) < 800
    found = compared(survey.done, context)
    assert found is not None
    assert found.accuracy.reference_points == len(points["x"])
    expected = accuracy_report(*whole(points, rasters)).model_dump()
    assert expected["dtm"]["open_ground"]["n"] > 10
    statistics = found.accuracy.model_dump()
    for product in ("dtm", "dsm"):
        assert statistics[product].keys() == expected[product].keys()
        for name, values in expected[product].items():
            assert statistics[product][name] == pytest.approx(values), (product, name)
    seen = found.difference.values != NODATA
    ground = points["classification"] == 2
    assert 500 < np.count_nonzero(seen) <= np.count_nonzero(ground)


def prepared_with(tmp_path: Path, rasters: Sequence[str], memory: str = "4GiB") -> Any:
    """Ledger of a small survey with a reference, as it is when so many rasters are there."""
    cloud = surveys.flightline(shots=60)
    surveys.write_cloud(tmp_path / "ref.laz", cloud)
    surveys.small_survey(tmp_path, reference={"points": "ref.laz"})
    survey = prepare(tmp_path / "workflow.yaml", [], memory=memory).ledger
    survey.of("surface").put(Receipt("surface", "0_0", "", "d", "", {}, {}, 0, 0.0, 0.0))
    for name in rasters:
        survey.of("mosaic").put(Receipt("mosaic", name, "", "d", "", {}, {}, 0, 0.0, 0.0))
    return survey


@pytest.mark.parametrize(
    ("rasters", "squares"), [(("dtm", "dsm", "chm"), 1), (("dtm", "dsm"), 1), (("dtm", "chm"), 0)]
)
def test_nothing_is_compared_with_what_could_not_be_made(
    rasters: tuple[str, ...], squares: int, tmp_path: Path
) -> None:
    survey = prepared_with(tmp_path, rasters)
    tasks = list(planned.reference(survey))
    assert len(tasks) == 1, "it is cut while the rasters are made"
    for task in tasks:
        facts = {"points": 10, "squares": {"0_0": 10}}
        survey.of("reference").put(
            Receipt("reference", task.name, "", "d", "", {}, facts, 10, 0.0, 0.0)
        )
    compared = list(planned.accuracy(survey))
    assert len(compared) == squares
    for task in compared:
        assert task.args["rasters"] == list(rasters)
        assert {name for kind, name in task.needs if kind == "mosaic"} == set(rasters)


def test_a_square_that_fits_into_no_worker_is_refused_alone(tmp_path: Path) -> None:
    survey = prepared_with(tmp_path, ("dtm", "dsm"), memory="1GiB")
    facts = {"points": 10, "squares": {"0_0": 50_000_000, "0_1": 10}}
    survey.of("reference").put(Receipt("reference", "1", "", "d", "", {}, facts, 10, 0.0, 0.0))
    refused = {task.name: task.refused for task in planned.accuracy(survey)}
    assert "--memory" in refused["0_0"]
    assert "cut the reference" in refused["0_0"]
    assert not refused["0_1"]


def squares(output: Path) -> list[Path]:
    return sorted((output / "store" / "accuracy").glob("*.npz"))


def test_a_survey_is_no_reference_of_itself_and_another_is_compared_anew(tmp_path: Path) -> None:
    """A part of its points, in another file, raster and order; then the same, raised."""
    survey = surveys.small_survey(tmp_path, reference={"points": "ref.laz"})
    line = surveys.flightline(
        shots=120, psid=2, start_s=surveys.START_S + 3, seed=2, origin_m=surveys.ORIGIN_M
    )
    part = surveys.take(line, slice(None, None, -3))
    part["classification"] = np.full(len(part["x"]), 2, np.uint8)
    found = []
    for raised_m in (0.0, 2.5):
        surveys.write_cloud(tmp_path / "ref.laz", part | {"z": part["z"] + raised_m})
        result = api.run(survey, workers=0)
        assert result.report is not None
        assert result.report.accuracy is not None
        assert result.report.accuracy.own_points == (raised_m == 0.0)
        own = surveys.found(result.report.findings, "C02", "own")
        assert [one.values["share"] for one in own] == [1.0] * (raised_m == 0.0)
        found.append(result)
    said = dict(found[0].screen)["accuracy"]
    assert said == "the reference holds the survey's own points"
    first, second = (result.report.accuracy.dtm["all"] for result in found)
    assert first.n == second.n > 100
    assert second.mean == pytest.approx(first.mean - 2.5, abs=1e-3)
    stages = found[1].report.performance.stages
    assert {name for name, stage in stages.items() if stage.tasks} == {"report"}
