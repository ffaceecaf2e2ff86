"""Seconds by stage over a search for 15 neighbours in the same run, and kernels that compile."""

import os
from collections.abc import Iterator
from typing import Final
from unittest import mock

from benchmarks.airborne import peers
from benchmarks.engine import task_times
from benchmarks.held import surveys
from benchmarks.held.figures import Figure, figure
from benchmarks.held.surveys import Given
from benchmarks.numerics import compiling
from spl_batch.receivers import steps

ROUNDS: Final = 2
"""Rounds of tasks and of searches of which the least counts; kernels are compiled before."""


def stages(given: Given) -> Iterator[Figure]:
    """Processor time of each stage of the quickstart's survey by that of a search.

    The search of each library that is installed has figures of its own.
    """
    survey = surveys.quickstart(given)
    cloud = max((survey / "flightlines").glob("*.laz"), key=lambda path: path.stat().st_size)
    xyz = peers.middle(cloud, peers.SEARCHED)
    stage_of = {kind: of.stage for kind, of in steps("imaging").items()}
    seconds: dict[str, float] = {}
    searches: dict[str, float] = {}
    with mock.patch.dict(os.environ, OMP_NUM_THREADS="1"):
        for number in range(ROUNDS):
            spent: dict[str, float] = {}
            output = given.scratch / f"timed_{number}"
            cost, returns = task_times.round_of(survey / "workflow.yaml", output)
            for kind, (processor_s, *_) in cost.items():
                stage = stage_of[kind]
                spent[stage] = spent.get(stage, 0.0) + processor_s / returns * 1e6
            spent["all"] = sum(spent.values())
            for found, least in ((spent, seconds), (dict(peers.searches(xyz)), searches)):
                least |= {k: min(v, least.get(k, v)) for k, v in found.items()}
    for search, search_s in searches.items():
        for stage, value in seconds.items():
            ratio = value / search_s
            yield figure(f"{stage} / {search}", ratio, "", "more", max(0.1, 0.1 * ratio))


def kernels(given: Given) -> Iterator[Figure]:
    """Kernels that the first start compiles, and what that takes."""
    with mock.patch.dict(os.environ, NUMBA_CACHE_DIR=str(given.scratch / "numba")):
        number, processor_s, _ = compiling.measure([(0, 2), (1, 2)])
    yield figure("compiled on the first start", number, "", "more", 0.0)
    yield figure("processor time of compiling", processor_s, "s", "more", 0.15 * processor_s)
