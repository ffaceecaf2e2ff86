"""What the tasks of a ground cell hold in memory, in more and more strips.

``python -m benchmarks.engine.memory strips`` prints it.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks.engine.peak import Peak
from spl_batch import api
from spl_batch.airborne.context import Context
from spl_batch.airborne.lines import comparison
from spl_batch.airborne.plan import space_tasks
from spl_batch.airborne.plan.memory.cell_memory import looks_at
from spl_batch.airborne.plan.phases import PHASES
from spl_batch.airborne.tasks import space_domain, surfaces
from spl_batch.airborne.tasks.cells import cell_classes
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.tasks.task import Task
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.lattice.eastings import Cut, Eastings
from spl_batch.lattice.tiles import Bounds, parse_cell

STRIPS = (1, 4, 8, 16, 28)
"""Into how many strips a cell is cut, where they may be as narrow [count]."""

CELL_TASKS = {
    "ground": space_domain.ground,
    "strip_patches": comparison.strip_patches,
    "surface": surfaces.surface,
}
"""Tasks of a cell that may be done in strips."""

LOOKS = (
    (surfaces, "_reflectance", "tops"),
    (surfaces, "_surfaces", "tops"),
    (surfaces, "_pulses", "pulses"),
    (cell_classes, "classes", "classes"),
)
"""What looks at a surface cell: module, function, name of the look."""


def strips(workflow: Path, overrides: Sequence[str]) -> None:
    """Print the memory of the tasks of the fullest ground cell, in more and more strips."""
    result = api.run(workflow, workers=0, until="surfaces", overrides=overrides)
    if result.exit_status:
        raise SystemExit(f"{workflow}: the run failed")
    print(f"{'task':14s}{'strips':>7s}{'look':>9s}{'cell':>12s}{'strip':>12s}{'MiB':>7s}{'s':>7s}"
          "  bytes")  # fmt: skip
    for kind, function in CELL_TASKS.items():
        task, parts, context = _fullest(kind, workflow, overrides)
        whole = None
        for count in (0, *STRIPS) if kind == "surface" else STRIPS:
            # 0: all looks share what is read once.
            cuts = {look: cut(max(count, 1)) for look, cut in parts.items()}
            seen: dict[str, int] = {}
            begin_s = time.process_time()
            with Peak().watching() as peak, _looking(seen, peak.before):
                ends = {look: list(found.ends[1:-1]) for look, found in cuts.items()}
                how = {"cuts": ends, "held": count == 0}
                produced = function({**task.args, **how}, context)
            spent_s = time.process_time() - begin_s
            found = [path.read_bytes() for path in produced.outputs], produced.facts
            whole = whole or found
            same = "same" if found == whole else "OTHERS"
            for look, cut in cuts.items():
                most = seen.get(look, peak.highest - peak.before)
                print(f"{kind:14s}{cut.strips:7d}{look:>9s}{task.points:12,d}{cut.fullest:12,d}"
                      f"{most / 2**20:7.0f}{spent_s:7.1f}  {same}", flush=True)  # fmt: skip


@contextlib.contextmanager
def _looking(seen: dict[str, int], before: int) -> Iterator[None]:
    """Note the memory above what there was before, by look at a surface cell."""

    def watched(function: Callable[..., Any], look: str) -> Callable[..., Any]:
        def work(*args: Any) -> Any:
            with Peak().watching() as peak:
                found = function(*args)
            seen[look] = max(seen.get(look, 0), peak.highest - before)
            return found

        return work

    with contextlib.ExitStack() as stack:
        for home, name, look in LOOKS:
            function = watched(getattr(home, name), look)
            stack.enter_context(mock.patch.object(home, name, function))
        yield


def _fullest(
    kind: str, workflow: Path, overrides: Sequence[str]
) -> tuple[Task, dict[str, Callable[[int], Cut]], Context]:
    """The task of a kind that holds most points, how its looks are cut, and what it runs in."""
    prepared = prepare(workflow, overrides)
    survey, context = prepared.ledger, prepared.context
    for done in ("index_file", "scatter", "build_tile", "denoise", "ground"):
        for receipt in read_receipts(context.store, done):
            survey.of(done).put(receipt)
    phase = next(phase for phase in PHASES if phase.kind == kind)
    task = max(phase.tasks(survey), key=lambda task: len(task.args["tiles"]))
    spread = space_tasks.spread_over(list(map(parse_cell, task.args["tiles"])), survey)
    core = Bounds(*task.args["core"])
    task = replace(task, points=round(spread(core).total))

    def cut_by(region: Eastings, step: int, reach: int) -> Callable[[int], Cut]:
        return lambda count: region.cut(step, reach, region.total / count)

    found = looks_at(kind, core, spread, context.workflow)
    return task, {look: cut_by(*how) for look, how in found.items()}, context
