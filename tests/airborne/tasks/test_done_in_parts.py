"""What does not fit in memory is done in parts, and no byte tells."""

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow.parquet as pq
import pytest

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan.block_size import Sizes, count_blocks
from spl_batch.airborne.plan.ground_cells import GroundCells
from spl_batch.airborne.plan.memory.block_parts import parts_of
from spl_batch.airborne.plan.memory.cell_memory import Spread, cell_parts, looks_at
from spl_batch.airborne.plan.memory.heaviest_tasks import needs
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import task_bytes
from spl_batch.airborne.settings.workflow import Workflow, parse_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.airborne.tasks import space_domain, surfaces
from spl_batch.engine.plan.worker_memory import USABLE_SHARE
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.tasks.task import Task
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.lattice.density import Box, from_boxes, from_counts
from spl_batch.lattice.eastings import Eastings, Slabs
from spl_batch.lattice.tiles import Bounds, CellId, parse_cell

FLAGS: Final = ("building", "overlap", "withheld")

CORE = Bounds(0, 0, 40_000, 100_000)


def even(density_m2: float) -> Spread:
    """Points that lie evenly for ever."""

    def spread(region: Bounds) -> Eastings:
        return Eastings.even(density_m2 * region.area_m2, region)

    return spread


def evenly(per_m2: float) -> Callable[[Bounds], float]:
    """Points that lie evenly for ever."""
    return lambda region: region.area_m2 * per_m2


def test_parts_are_halves_and_cover_the_whole() -> None:
    whole, parts = (
        [part.core for part in parts_of(CORE, evenly(100), plain(), limit)]
        for limit in (8 << 30, 1 << 30)
    )
    assert whole == [CORE]
    assert parts == [Bounds(0, 0, 40_000, 50_000), Bounds(0, 50_000, 40_000, 100_000)]
    # what needs too much at any size is cut down to the least side, and no further
    least = parts_of(CORE, evenly(10_000), plain(), 1 << 30)
    assert {(p.core.xmax - p.core.xmin, p.core.ymax - p.core.ymin) for p in least} == {
        (20_000, 12_500)
    }
    assert sum(p.core.area_m2 for p in least) == CORE.area_m2
    assert min(p.memory_bytes for p in least) > 1 << 30


def test_parts_of_150_returns_per_m2_fit_into_one_gibibyte() -> None:
    block = Bounds(0, 0, 100_000, 100_000)
    parts = parts_of(block, evenly(150), plain(), 1 << 30)
    assert len(parts) > 1
    assert max(part.memory_bytes for part in parts) <= 0.9 * 2**30


def test_points_that_the_filter_looks_at_cost_more_than_those_far_away() -> None:
    """All of a clump is near; of even points most are in the outer halo, seen for air alone."""
    clump = Slabs.of([((40_000, 40_000, 60_000, 60_000), 5_000_000)]).within
    even_ = evenly(5_000_000 / 210**2)
    most = [
        max(part.memory_bytes for part in parts_of(CORE, points, plain(), 1 << 30))
        for points in (clump, even_)
    ]
    assert most[0] > 0.9 * 2**30 > most[1]


def test_a_slab_shares_its_points_by_area() -> None:
    slabs = Slabs.of([((0, 0, 100, 40), 800), ((100, 0, 100, 40), 9)])
    assert slabs.within(Bounds(0, 0, 101, 40)) == 809
    assert slabs.within(Bounds(50, 10, 100, 20)) == 100
    assert slabs.within(Bounds(-90, -90, -1, -1)) == 0
    assert Slabs.of([]).within(CORE) == 0


@pytest.fixture(scope="module")
def finished(tiny_output: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Survey, Context]:
    """The tiny survey with the receipts of its run, in a store that a test may write to."""
    prepared = prepare(tiny_output.parent / "workflow.yaml", ["outputs.diagnostics=true"])
    survey, context = prepared.ledger, prepared.context
    copied = tmp_path_factory.mktemp("parts") / "out"
    shutil.copytree(tiny_output / "store", copied / "store")
    for kind in ("index_file", "scatter", "build_tile", "denoise", "ground", "surface"):
        for receipt in read_receipts(context.store, kind):
            survey.of(kind).put(receipt)
    return survey, replace(context, output=copied)


def only_task(survey: Survey, kind: str) -> Task:
    return max(STEPS[kind].planned(survey), key=lambda task: task.points)


def cuts_of(task: Task, context: Context, count: int) -> dict[str, Any]:
    """Cuts that make about so many strips of each look at a cell, as a plan would say."""
    core, cuts = Bounds(*task.args["core"]), {}
    looks = looks_at(task.kind, core, even(1.0), context.workflow)
    for name, (region, step_q, _) in looks.items():
        cuts[name] = list(region.cut(step_q, 0, region.total / count).ends[1:-1])
    return {"cuts": cuts}


def held_in(survey: Survey, task: Task, kind: str) -> int:
    """Memory limit in which a task of a ground cell just fits [byte]."""
    points = sum(survey.counts[parse_cell(tile)] for tile in task.args["tiles"])
    return math.ceil(task_bytes(kind, points) / USABLE_SHARE)


@pytest.mark.parametrize(
    ("kind", "how"),
    [
        ("denoise", {"parts": None}),
        ("ground", {"parts": 3}),
        ("ground", {"parts": 200}),
        ("surface", {"parts": 8}),
    ],
)
def test_parts_give_the_same_labels(
    finished: tuple[Survey, Context], kind: str, how: dict[str, object]
) -> None:
    survey, context = finished
    task = only_task(survey, kind)
    if kind == "denoise":
        west, south, east, north = task.args["core"]
        middle, third = (west + east) // 2 + 7, south + (north - south) // 3
        how = {"parts": [[west, south, middle, north], [middle, south, east, third],
                         [middle, third, east, north]]}  # fmt: skip
    else:
        how = cuts_of(task, context, int(str(how["parts"])))
    labels = {"denoise": "noise", "ground": "ground", "surface": "classes"}[kind]
    work = {"surface": surfaces.surface}.get(kind) or getattr(space_domain, kind)
    path = context.store.labels(labels, task.args.get("block") or task.args["cell"])
    before = path.read_bytes()
    path.unlink()
    produced = work({**task.args, **how}, context)
    assert path.read_bytes() == before
    assert produced.points == task.points
    (receipt,) = (r for r in read_receipts(context.store, kind) if r.name == task.name)
    facts = json.loads(json.dumps(produced.facts))  # as a receipt keeps them
    assert {k: v for k, v in facts.items() if k != "layers"} == {
        k: v for k, v in receipt.facts.items() if k != "layers"
    }


def test_a_surface_cell_has_the_same_bytes_in_any_strips(finished: tuple[Survey, Context]) -> None:
    _, context = finished
    asked = ["products.maps=true", *(f"classes.{name}=true" for name in FLAGS),
             "classes.vegetation.low=0.3", "products.void_max_m=2"]  # fmt: skip
    prepared = prepare(context.base / "workflow.yaml", asked)
    for kind in ("index_file", "scatter", "build_tile", "denoise", "ground"):
        for receipt in read_receipts(context.store, kind):
            prepared.ledger.of(kind).put(receipt)
    task = only_task(prepared.ledger, "surface")
    context = replace(context, workflow=prepared.context.workflow)
    found: list[dict[str, Any]] = []
    for how in ({"held": True}, {"cuts": {}}, cuts_of(task, context, 5)):
        produced = surfaces.surface({**task.args, **how}, context)
        files = {path.name: path.read_bytes() for path in produced.outputs}
        found.append({**files, **produced.facts, "points": produced.points})
    held, whole, strips = found
    assert set(whole["rasters"]) >= {"dtm", "dsm", "intensity", "noise", "swaths", "voids"}
    labels = pq.read_table(context.store.labels("classes", task.args["cell"]))
    assert {1, 2, 6} <= set(labels["classification"].to_pylist())
    assert len(set(labels["set_flags"].to_pylist())) > 2
    for other in (held, strips):
        assert {k: v for k, v in other.items() if v != whole[k]} == {}


def test_memory_decides_on_the_parts_and_is_in_no_key(finished: tuple[Survey, Context]) -> None:
    survey, _ = finished
    short = replace(survey, memory_bytes=450 << 20)
    wet = only_task(short, "ground")
    dry = replace(short, workflow=survey.workflow.model_copy(update={"water": None}))
    assert only_task(survey, "ground").how == {"cuts": {}}
    assert set(wet.how["cuts"]) == {"ground", "water"}
    assert set(only_task(dry, "ground").how["cuts"]) == {"ground"}
    assert only_task(dry, "ground").args == wet.args
    wide = only_task(survey, "surface")
    assert wide.how == {"cuts": {}, "held": True}
    tight = replace(survey, memory_bytes=held_in(survey, wide, "surface"))
    assert only_task(tight, "surface").how["cuts"], "its raster cells take more than its points"
    assert only_task(tight, "surface").args == wide.args
    assert len(only_task(short, "denoise").how["parts"]) > 1


SQUARE: Final = Bounds(0, 0, 200_000, 200_000)


def plain(**sections: object) -> Workflow:
    return parse_workflow({"survey": {"flightlines": "a"}, "output": "o", **sections}, "w")


@pytest.mark.parametrize(
    ("kind", "density_m2"), [("ground", 280), ("surface", 150), ("strip_patches", 200)]
)
def test_150_returns_per_m2_fit_into_one_gibibyte(kind: str, density_m2: float) -> None:
    parts = cell_parts(kind, SQUARE, even(density_m2), plain(), 1 << 30)
    assert parts.strips > 1
    assert parts.memory_bytes <= 0.9 * 2**30
    assert cell_parts(kind, SQUARE, even(density_m2), plain(), 8 << 30).strips == 1
    assert cell_parts(kind, SQUARE, even(2_500), plain(), 1 << 30).memory_bytes > 2**30


def test_a_surface_that_took_959_mib_of_a_worker_is_planned_with_as_much() -> None:
    """Of 3.43 million returns, all in one cell, at once, after other tasks of a worker."""
    box = Bounds(0, 0, 160_000, 160_000)
    spread = partial(Eastings.of_slabs, [(box, 3_430_634)])
    assert cell_parts("surface", box, spread, plain(), 8 << 30).memory_bytes >= 959 << 20
    short = cell_parts("surface", box, spread, plain(), 1 << 30)
    assert short.strips > 1
    assert short.memory_bytes <= 0.9 * 2**30


@pytest.mark.parametrize(("kind", "fits"), [("ground", 3_600_000), ("surface", 4_800_000)])
def test_a_corridor_is_cut_within_its_width_or_refused(kind: str, fits: int) -> None:
    """As many returns as in an even cell, in a tenth of its width."""
    low, high = (
        cell_parts(kind, SQUARE, partial(Eastings.of_slabs, [((west, -60_000, east, 260_000), n)]),
                   plain(), 1 << 30)
        for west, east, n in ((90_000, 122_000, fits), (90_000, 122_000, 30_000_000))
    )  # fmt: skip
    assert low.strips > 1
    assert low.memory_bytes <= 0.9 * 2**30
    assert all(any(90_000 < cut < 122_000 for cut in cuts) for cuts in low.cuts.values())
    assert high.memory_bytes > 2**30, "too much is refused, no worker is killed"


def test_a_plan_counts_what_a_cell_with_strips_of_its_neighbours_owns() -> None:
    box = Box(Bounds(-13_000, -13_000, 213_000, 213_000), 7_500_000)
    limit, workflow = 1 << 30, plain()
    pieces = list(from_boxes([box], 100_000))
    found = needs(pieces, workflow, 2_000_000, files=[7_500_000], limit=limit, boxes=[box])
    core = GroundCells.of_workflow([box.bounds], workflow).core(CellId(0, 0))
    assert core == Bounds(-200_000, -200_000, 400_000, 400_000)
    told = {need.kind: (need.memory_bytes, need.parts) for need in found if need.kind}
    assert set(told) == {"ground", "surface", "strip_patches"}
    for kind, planned in told.items():
        parts = cell_parts(kind, core, partial(Eastings.of_slabs, [box]), workflow, limit)
        assert planned == (parts.memory_bytes, parts.strips)


def test_the_halo_of_buildings_counts() -> None:
    asked = plain(classes={"building": True})
    alone, with_roofs = (
        cell_parts("surface", SQUARE, even(110), workflow, 1 << 30) for workflow in (plain(), asked)
    )
    assert len(with_roofs.cuts["classes"]) > len(alone.cuts["classes"])
    dense = cell_parts("surface", SQUARE, even(150), asked, 1 << 30)
    assert dense.memory_bytes <= 0.9 * 2**30


def test_a_plan_counts_what_parts_read() -> None:
    counts = {CellId(i, j): 1_000_000 for i in range(2) for j in range(2)}
    pieces = list(from_counts(counts, 100_000))
    workflow = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "w")
    reads = [count_blocks(pieces, workflow, memory, Sizes(1)).read for memory in (8 << 30, 3 << 28)]
    assert reads[1] > 2 * reads[0]
