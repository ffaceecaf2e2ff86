"""Tasks are made one by one, finished ones are kept small, and what cannot fit is refused."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan import task_memory
from spl_batch.airborne.plan.cost import estimate
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import (
    needs,
    refusal,
    task_bytes,
)
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.constants import FOOT_M
from spl_batch.engine.plan import budget, worker_memory
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.report.run_record import RunFacts, StageCost, performance
from spl_batch.engine.store.working_store import Store, write_receipt
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.ledger import StepReceipts
from spl_batch.engine.tasks.task import Job, Outcome, Receipt, Task
from spl_batch.engine.verbs.graph import Worklist
from spl_batch.formats.units import METRES, Units
from spl_batch.lattice.density import from_counts
from spl_batch.lattice.tiles import CellId

WORKFLOW = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "w")
NAMES = ("a", "b", "c", "heavy")


def receipt(kind: str, name: str, key: str = "", **facts: Any) -> Receipt:
    return Receipt(kind, name, key, f"d{name}", "", {}, facts, 5, 1.0, 9.0)


def survey(memory_bytes: int = 2**32) -> Survey:
    return Survey(Inputs((), (), (), (), None, ()), WORKFLOW, memory_bytes, 2)


def context(folder: Path) -> Context:
    return Context(WORKFLOW, folder, folder, "", "code")


def tasks(_: Survey) -> Iterator[Task]:
    for name in NAMES:
        yield Task("ground", name, {"cell": name}, (), 10, "too large" if name == "heavy" else "")


def test_what_is_left_is_done_and_what_is_finished_is_not(tmp_path: Path) -> None:
    known = survey()
    work = Worklist(replace(STEPS["ground"], tasks=tasks, bind=None), known, context(tmp_path))
    key = runner.task_key(Task("ground", "b", {"cell": "b"}), context(tmp_path), ())
    write_receipt(Store(tmp_path), receipt("ground", "b", key, ground=3))
    write_receipt(Store(tmp_path), receipt("ground", "c", "of other settings"))
    assert [found.name for found in work.look()] == ["b"]
    assert (work.left, work.ready, work.points) == (3, 1, 30)
    jobs = [work.job(task) for task in work.tasks()]
    assert [(job.task.name, bool(job.key)) for job in jobs if job] == [
        ("a", True),
        ("c", True),
        ("heavy", True),
    ]
    assert [job.task.name for job in jobs if job and job.task.refused] == ["heavy"]


def test_a_worker_keeps_the_settings_of_one_workflow(tmp_path: Path) -> None:
    """Each task brings a workflow of its own: a night has a million."""
    task, known = Task("ground", "a", {}), context(tmp_path)
    keys = set()
    for _ in range(3):
        own = replace(known, workflow=known.workflow.model_copy(deep=True))
        keys.add(runner.task_key(task, own, ()))
    assert len(keys) == 1
    other = known.workflow.model_copy(
        update={"ground": known.workflow.ground.model_copy(update={"cell_m": 77.0})}
    )
    assert runner.task_key(task, replace(known, workflow=other), ()) not in keys
    assert [step for step in runner._SETTINGS if "ground" in step] == ["ground"]
    assert runner._SETTINGS["ground"][0] is other


def test_what_a_task_needs_decides_whether_it_waits_or_is_left_out(tmp_path: Path) -> None:
    known, over = survey(), False
    step = replace(STEPS["ground"], tasks=tasks, bind=None)
    work = Worklist(step, known, context(tmp_path), is_over=lambda _: over)
    task = Task("ground", "a", {}, (("denoise", "0_0"), ("denoise", "1_0")))
    known.of("denoise").put(receipt("denoise", "0_0"))
    job = work.job(task)
    assert job is not None
    assert (job.key, job.open, job.found) == ("", (task.needs[1],), {task.needs[0]: "d0_0"})
    over = True
    assert work.job(task) is None
    known.of("denoise").put(receipt("denoise", "1_0"))
    job = work.job(task)
    assert job is not None
    assert job.key == runner.task_key(task, context(tmp_path), ("d0_0", "d1_0"))


def test_a_job_goes_back_only_where_what_it_waits_for_is_done_again(tmp_path: Path) -> None:
    needs = (("denoise", "0_0"), ("denoise", "1_0"))
    job = Job(Task("ground", "a", {}, needs), "", needs[:1])
    for need, again in ((needs[0], ("failed",)), (needs[0], None), (needs[1], ("failed",))):
        outcome = runner.do(job, context(tmp_path), [Outcome(need, None, again=again)])
        assert (outcome.again is not None) == (again is not None and need in job.open)
        assert not outcome.again, "its own tries, none"


def test_a_cell_goes_without_labels_of_what_failed(tmp_path: Path) -> None:
    known = survey()
    work = Worklist(STEPS["surface"], known, context(tmp_path))
    needs = (("denoise", "a"), ("denoise", "b"), ("ground", "0_0"), ("ground", "1_0"))
    task = Task("surface", "0_0", {"cell": "0_0"}, needs)
    known.of("denoise").put(receipt("denoise", "b"))
    assert work.job(task) is None, "its own ground is missing"
    known.of("ground").put(receipt("ground", "0_0"))
    job = work.job(task)
    assert job is not None
    assert job.task.args["labels"] == {"denoise": ["b"], "ground": ["0_0"], "surface": []}
    assert job.task.args["aligned"] is False
    assert job.task.needs == (needs[1], needs[2])


def test_what_others_of_a_batch_wait_for_is_in_no_key(tmp_path: Path) -> None:
    known, over = survey(), False
    work = Worklist(STEPS["surface"], known, context(tmp_path), is_over=lambda _: over)
    needs = (("denoise", "a"), ("ground", "0_0"))
    task = Task("surface", "0_0", {"cell": "0_0"}, needs)
    job = work.job(task)
    assert job is not None
    beside = (("denoise", "far"), ("ground", "1_0"))
    outcome = runner.do(job, context(tmp_path), [Outcome(n, receipt(*n)) for n in needs + beside])
    for need in needs:
        known.of(need[0]).put(receipt(*need))
    over = True
    alone = work.job(task)
    assert outcome.receipt is not None
    assert alone is not None
    assert outcome.receipt.key == alone.key


def test_another_need_is_another_key(tmp_path: Path) -> None:
    known = survey()
    work = Worklist(replace(STEPS["ground"], tasks=tasks), known, context(tmp_path))
    task = Task("ground", "a", {}, (("build_tile", "0_0"),))
    keys = []
    for name in ("x", "y"):
        known.of("build_tile").put(Receipt("build_tile", "0_0", "", name, "", {}, {}, 0, 0.0, 0.0))
        job = work.job(task)
        assert job is not None
        keys.append(job.key)
    assert keys[0] != keys[1]


def test_a_shelf_keeps_what_later_phases_read() -> None:
    facts = {"points": 3, "sources": ["7", "9"], "share": 0.1}
    outputs = {"store/tiles/0_0.parquet": "c"}
    given = Receipt("build_tile", "0_0", "key", "0fd", "", outputs, facts, 3, 1.0, 9.0)
    receipts = StepReceipts(STEPS["build_tile"])
    receipts.put(given)
    kept = receipts["0_0"]
    assert (kept.digest, receipts.digest("0_0"), kept.points) == ("0fd", "0fd", 3)
    assert kept.facts == facts
    assert (kept.outputs, len(receipts), "0_0" in receipts, "1_0" in receipts) == (
        {},
        1,
        True,
        False,
    )
    delivered = StepReceipts(STEPS["mosaic"])
    delivered.put(Receipt("mosaic", "dtm", "", "d", "", {"dtm.tif": "c"}, {}, 0, 0.0, 0.0))
    assert delivered["dtm"].outputs == {"dtm.tif": "c"}
    with pytest.raises(KeyError):
        receipts.digest("1_0")


def test_only_the_unit_that_cannot_fit_is_refused() -> None:
    limit = 2**30
    full = int((usable_bytes(limit) - worker_memory.LOADED_BASE_BYTES) / 0.9)
    known = survey(limit)
    bounds = [0, 0, 0, 5_099_999, 5_099_999, 1]
    none = {"points": 0, "excluded": 0, "spans": {}}
    known.of("index_file").put(receipt("index_file", "1", bounds=bounds, **none))
    for name, points in (
        ("0_0", 1000),
        ("50_50", full // STEPS["ground"].bytes_per_point * 60),
    ):
        tile = {"points": points, "sources": [], "outside_aoi": 0, "no_beam": 0}
        known.of("build_tile").put(receipt("build_tile", name, **tile))
    for kind in ("denoise", "ground", "surface"):
        refused = {task.name: task.refused for task in STEPS[kind].planned(known)}
        told = [text for text in refused.values() if text]
        assert 0 < len(told) < len(refused), kind
        assert all("--memory 1 024 MiB" in text and "lower" in text for text in told)
        for name in refused:
            known.of(kind).put(receipt(kind, name))


@pytest.mark.parametrize("kind", ["build_tile", "denoise", "ground", "surface"])
def test_a_refusal_begins_where_the_limit_ends(kind: str) -> None:
    fits = task_memory.points_within(kind, 2**32)
    assert task_bytes(kind, fits) <= usable_bytes(2**32)
    assert refusal(kind, fits, 2**32) == ""
    assert "needs about" in refusal(kind, fits + 10_000, 2**32)


def test_a_surface_cell_of_many_raster_cells_asks_for_larger_ones() -> None:
    pieces = list(from_counts({CellId(3, 5): 10**6}, 100_000))
    given = {"survey": {"flightlines": "a"}, "output": "o", "products": {"cell_m": 0.01}}
    fine = parse_workflow(given, "w")
    for workflow, remedy in ((WORKFLOW, STEPS["surface"].remedy), (fine, "raise products.cell_m")):
        (surface,) = (n for n in needs(pieces, workflow, [10**6], 1) if "surface" in n.task)
        assert surface.remedy == remedy


def test_the_fullest_place_is_named_in_the_unit_of_the_survey() -> None:
    pieces = list(from_counts({CellId(3, 5): 10**6}, 100_000))
    foot = Units("foot", FOOT_M, "foot", FOOT_M)
    for units, place in (
        (METRES, "tile around x 350, y 550 with"),
        (foot, "tile around x 1148, y 1804 ft (x 350, y 550 m) with"),
    ):
        found = needs(pieces, WORKFLOW, [10**6], 1, units=units)
        assert any(place in one.task for one in found), found


def test_a_tile_needs_what_its_task_is_given() -> None:
    pieces = list(from_counts({CellId(3, 5): 10**6, CellId(900, 5): 10**5}, 100_000))
    found = needs(pieces, WORKFLOW, [10**9], 1)
    assert task_bytes("build_tile", 10**6) in {need.memory_bytes for need in found}
    assert len(found) >= 7


def test_rates_are_those_of_the_last_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cost = {"wall_s": 30.0, "points": {"scatter": 120, "build_tile": 120}}
    typical = {"shuffle": 1.0, "ground": 7.0}
    assert budget.measured_rates(typical, context(tmp_path)) == (typical, False)
    monkeypatch.setattr(budget, "recall", lambda _: {"costs": "of another version"})
    assert budget.measured_rates(typical, context(tmp_path)) == (typical, False)
    monkeypatch.setattr(budget, "recall", lambda _: {"facts": {"costs": {"shuffle": cost}}})
    found = {"shuffle": 4.0, "ground": 7.0}
    assert budget.measured_rates(typical, context(tmp_path)) == (found, True)


def test_the_speed_of_a_stage_counts_each_point_once() -> None:
    cost = StageCost()
    for kind, wall_s in (("scatter", 18.0), ("build_tile", 12.0)):
        cost.add(Receipt(kind, "a", "", "", "", {}, {}, 120, wall_s, 9.0))
    told = performance(RunFacts(60.0, 2, {"shuffle": cost}), 120)
    assert told.stages["shuffle"].points_per_s == 4.0
    assert told.points_per_s == 2.0


def test_a_plan_counts_what_many_small_files_take_beside_their_points() -> None:
    times = []
    for files, points in ((1, 100_000), (2000, 50)):
        facts = SimpleNamespace(n_points=points, mins_m=(0.0, 0.0, 0.0), maxs_m=(99.0, 99.0, 9.0))
        sources = tuple(SimpleNamespace(facts=facts, key=k) for k in range(files))
        inputs = Inputs(sources, (), (), Files(), None, ())  # type: ignore[arg-type]
        times.append(estimate(Survey(inputs, WORKFLOW, 2**32, 2)).time_s)
    assert times[0] < 10
    assert 30 < times[1] < 300
