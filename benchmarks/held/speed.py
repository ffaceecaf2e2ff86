"""Seconds by stage over a search for 15 neighbours in the same run, and kernels that compile."""

import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final
from unittest import mock

from benchmarks import peers
from benchmarks.held import surveys
from benchmarks.held.figures import Figure, figure
from benchmarks.held.surveys import Given
from spl_batch.engine.tasks.runner import run_task
from spl_batch.engine.verbs.planning import prepare

ROUNDS: Final = 2
"""Rounds of tasks and of searches of which the least counts; kernels are compiled before."""


def stages(given: Given) -> Iterator[Figure]:
    """Processor time of each stage of the quickstart's survey by that of a search.

    The search of each library that is installed has figures of its own.
    """
    survey = surveys.quickstart(given)
    cloud = max((survey / "flightlines").glob("*.laz"), key=lambda path: path.stat().st_size)
    xyz = peers.middle(cloud, peers.SEARCHED)
    seconds: dict[str, float] = {}
    searches: dict[str, float] = {}
    with mock.patch.dict(os.environ, OMP_NUM_THREADS="1"):
        for number in range(ROUNDS):
            spent = by_stage(survey / "workflow.yaml", given.scratch / f"timed_{number}")
            spent["all"] = sum(spent.values())
            for found, least in ((spent, seconds), (dict(peers.searches(xyz)), searches)):
                least |= {k: min(v, least.get(k, v)) for k, v in found.items()}
    for search, search_s in searches.items():
        for stage, value in seconds.items():
            ratio = value / search_s
            yield figure(f"{stage} / {search}", ratio, "", "more", max(0.1, 0.1 * ratio))


def by_stage(workflow: Path, output: Path) -> dict[str, float]:
    """Processor time of each stage in this process, a million returns of the inputs [s]."""
    prepared = prepare(workflow, [f"output={output}"])
    survey, context = prepared.ledger, prepared.context
    context.store.local.mkdir(parents=True)
    spent: dict[str, float] = {}
    for step in prepared.steps.values():
        start = time.process_time()
        for task in list(step.planned(survey)):
            found = {(kind, name) for kind, name in task.needs if name in survey.of(kind)}
            bound = step.bound(task, found)
            if bound is None:
                continue
            receipt = run_task(bound, "", context)
            if receipt.failed:
                sys.exit(f"{task.kind} {task.name}: {receipt.reason}")
            survey.of(task.kind).put(receipt)
        spent[step.stage] = spent.get(step.stage, 0.0) + time.process_time() - start
    millions = sum(source.facts.n_points for source in survey.inputs.sources) / 1e6
    return {stage: value / millions for stage, value in spent.items()}


def kernels(given: Given) -> Iterator[Figure]:
    """Kernels that the first start compiles, and what that takes in two processes."""
    folder = mock.patch.dict(os.environ, NUMBA_CACHE_DIR=str(given.scratch / "numba"))
    with folder, multiprocessing.get_context("spawn").Pool(1) as pool:
        number, processor_s = pool.apply(compile_all)
    yield figure("compiled on the first start", number, "", "more", 0.0)
    yield figure("processor time of compiling", processor_s, "s", "more", 0.15 * processor_s)


def compile_all() -> tuple[int, float]:
    """Compile in two processes: kernels that were compiled, and processor time of both [s]."""
    # numba looks for the folder when it is imported.
    from spl_batch.airborne import precompile  # noqa: PLC0415

    made = precompile.compile_all(processes=2)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return made, children.ru_utime + children.ru_stime
