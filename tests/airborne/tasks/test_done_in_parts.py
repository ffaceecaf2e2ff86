"""What does not fit in memory is done in parts, and no byte tells."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pyarrow.parquet as pq
import pytest

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan import phases
from spl_batch.airborne.plan.block_size import Sizes, count_blocks
from spl_batch.airborne.plan.space_units import Unit, parts_of
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import surface_strips
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.tasks import space_domain, surfaces
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.tasks.task import Task
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.lattice.density import from_counts
from spl_batch.lattice.tiles import Bounds, CellId

FLAGS: Final = ("building", "overlap", "withheld")

CORE = Bounds(0, 0, 40_000, 100_000)


def test_parts_are_halves_and_cover_the_whole() -> None:
    unit = Unit("u", CellId(0, 0), CORE, (), 0, 0)
    parts = parts_of(
        unit, lambda part: part.xmax - part.xmin + part.ymax - part.ymin, (70_000, 70_000), 25_000
    )
    assert sorted(parts) == [
        Bounds(0, 0, 40_000, 25_000),
        *(Bounds(0, low, 40_000, low + 25_000) for low in (25_000, 50_000, 75_000)),
    ]
    assert parts_of(unit, lambda _: 1, (1, 1), 1) == [CORE]
    # what holds too much at any size is cut down to the least side, and no further
    least = parts_of(unit, lambda _: 2, (1, 1), 20_000)
    assert {(p.xmax - p.xmin, p.ymax - p.ymin) for p in least} == {(20_000, 25_000)}


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
    phase = next(phase for phase in phases.PHASES if phase.kind == kind)
    return max(phase.tasks(survey), key=lambda task: task.points)


@pytest.mark.parametrize(
    ("kind", "how"),
    [
        ("denoise", {"parts": None}),
        ("ground", {"bands": 3}),
        ("ground", {"bands": 200}),
        ("surface", {"strips": 8}),
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
    labels = {"denoise": "noise", "ground": "ground", "surface": "classes"}[kind]
    work = {"surface": surfaces.surface}.get(kind) or getattr(space_domain, kind)
    path = context.store.labels(labels, task.args.get("block") or task.args["cell"])
    before = path.read_bytes()
    path.unlink()
    produced = work({**task.args, **how}, context)
    assert path.read_bytes() == before
    assert produced.points == task.points
    (receipt,) = (r for r in read_receipts(context.store, kind) if r.name == task.name)
    assert {k: v for k, v in produced.facts.items() if k != "layers"} == {
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
    for count in (1, 5):
        produced = surfaces.surface({**task.args, "strips": count}, context)
        files = {path.name: path.read_bytes() for path in produced.outputs}
        found.append({**files, **produced.facts, "points": produced.points})
    whole, strips = found
    assert set(whole["rasters"]) >= {"dtm", "dsm", "intensity", "noise", "swaths", "voids"}
    labels = pq.read_table(context.store.labels("classes", task.args["cell"]))
    assert {1, 2, 6} <= set(labels["classification"].to_pylist())
    assert len(set(labels["set_flags"].to_pylist())) > 2
    assert {k: v for k, v in strips.items() if v != whole[k]} == {}


def test_memory_decides_on_the_parts_and_is_in_no_key(finished: tuple[Survey, Context]) -> None:
    survey, _ = finished
    short = replace(survey, memory_bytes=450 << 20)
    wet = only_task(short, "ground")
    dry = replace(short, workflow=survey.workflow.model_copy(update={"water": None}))
    assert wet.how == only_task(survey, "ground").how == {"bands": 1}, "a level asks for all of it"
    assert only_task(dry, "ground").how["bands"] > 1
    assert only_task(dry, "ground").args == wet.args
    assert len(only_task(short, "denoise").how["parts"]) > 1


def test_a_surface_cell_of_five_million_points_fits_into_one_gibibyte() -> None:
    strips, needed = surface_strips(4_800_000, 280_000, 10_000, 1 << 30)
    assert 1 < strips <= 28
    assert needed <= 0.9 * 2**30
    assert surface_strips(4_800_000, 280_000, 10_000, 2 << 30)[0] == 1
    strips, needed = surface_strips(11_800_000, 280_000, 10_000, 1 << 30)
    assert 1 < strips <= 28, "150 returns per m2"
    assert needed <= 0.9 * 2**30
    assert surface_strips(30_000_000, 280_000, 10_000, 1 << 30)[1] > 2**30, "too much is refused"


def test_a_plan_counts_what_parts_read() -> None:
    counts = {CellId(i, j): 1_000_000 for i in range(2) for j in range(2)}
    pieces = list(from_counts(counts, 100_000))
    workflow = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "w")
    reads = [count_blocks(pieces, workflow, memory, Sizes(1)).read for memory in (8 << 30, 3 << 28)]
    assert reads[1] > 2 * reads[0]
