"""Where the denoise stage's time goes.

Run ``python -m benchmarks.airborne.filter.denoise_steps WORKFLOW [BLOCK ...]``.

WORKFLOW is one that ``spl-batch run`` has finished. For each of its blocks, or those named,
prints points read over points owned, and processor seconds per million points owned of each
step, what it calls left out where that is listed too. In the same run, on the same points,
the k = 15 search alone that others offer: pykdtree and pgeof in float32 (if installed) and scipy's
cKDTree, both with the points in the order of our tree. A first round compiles and is not
counted. ``OMP_NUM_THREADS=1`` keeps pykdtree to one core. The last line counts the labels that
differ from those in the store.
"""

import argparse
import functools
import importlib
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.airborne.peers import installed
from spl_batch.airborne.context import Context
from spl_batch.airborne.filter.expected_noise import noise_model
from spl_batch.airborne.plan import space_tasks as places
from spl_batch.airborne.store.label_tables import Labelled
from spl_batch.airborne.tasks import space_domain
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.tasks.task import Task
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.formats.verified.parquet_npz import read_columns
from spl_batch.numerics.neighbours.kdtree import build

STEPS: Final = {
    "spl_batch.airborne.tasks.space_domain": (
        "read_region", "noise_model", "look_at_air", "noise_in_air",
    ),
    "spl_batch.airborne.store.label_tables": ("read_labelled_tile",),
    "spl_batch.airborne.afterpulse.afterpulse_decision": (
        "resolve", "behind_plane", "weigh_around",
    ),
    "spl_batch.airborne.filter.denoise": ("denoise", "follow"),
    "spl_batch.airborne.filter.ellipsoid.evidence": ("build", "count_inside"),
    "spl_batch.airborne.filter.ellipsoid.ellipsoid_test": (
        "judge", "build", "_limit", "_links", "enough_peers",
    ),
    "spl_batch.airborne.filter.wires.wire_scan": (
        "scan", "cube_counts", "columns", "fullest", "refine", "agreeing", "vote",
    ),
}  # fmt: skip
"""Functions that are timed, by module."""

LEAST: Final = 0.005
"""Share of the whole below which a step is not printed."""

SOME: Final = 200_000
"""Points that cKDTree is timed with [count]."""


@contextmanager
def watched(seconds: dict[str, float]) -> Iterator[None]:
    """Add up the processor time of each step."""
    inner: list[float] = []

    def timed(label: str, call: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(call)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            inner.append(0.0)
            start = time.process_time()
            try:
                return call(*args, **kwargs)
            finally:
                spent = time.process_time() - start
                seconds[label] += spent - inner.pop()
                if inner:
                    inner[-1] += spent

        return wrapper

    with ExitStack() as stack:
        for module, names in STEPS.items():
            home = importlib.import_module(module)
            for name in names:
                label = f"{module.rpartition('.')[2]}.{name}"
                stack.enter_context(
                    mock.patch.object(home, name, timed(label, getattr(home, name)))
                )
        yield


def blocks(workflow: Path) -> tuple[list[Task], Context]:
    """Denoise tasks of a finished run."""
    prepared = prepare(workflow, [])
    survey, context = prepared.ledger, prepared.context
    for kind in ("scatter", "build_tile"):
        for receipt in read_receipts(context.store, kind):
            survey.of(kind).put(receipt)
    return list(places.denoise(survey)), context


class Block:
    """One block, done in memory: nothing is written."""

    def __init__(self, task: Task, context: Context) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.labels: dict[str, NDArray[Any]] = {}
        self.xyz = np.empty((0, 3), np.int32)
        self.read = self.owned = 0
        with mock.patch.object(space_domain, "write_labels", self._keep):
            with mock.patch.object(space_domain, "noise_model", self._look):
                space_domain.denoise(task.args, context)
            start = time.process_time()
            with watched(self.seconds):
                space_domain.denoise(task.args, context)
            self.whole = time.process_time() - start

    def _look(self, xyz: list[NDArray[Any]], *args: Any) -> Any:
        self.xyz = np.stack([v - v.min() for v in xyz], axis=1).astype(np.int32)
        self.read = len(self.xyz)
        return noise_model(xyz, *args)

    def _keep(self, _: Path, parts: list[Labelled]) -> None:
        ((origin, labels),) = parts
        tiles, rows = origin.tiles[origin.owner], origin.row
        order = np.lexsort((rows, tiles[:, 0], tiles[:, 1]))
        self.labels = {name: values[order] for name, values in labels.items()}
        self.owned = len(rows)


def print_steps(name: str, block: Block) -> None:
    """One block's table."""
    per_million = 1e6 / max(block.owned, 1)
    print(f"block {name}: {block.owned} owned, halo x {block.read / max(block.owned, 1):.2f}")
    for step, seconds in sorted(block.seconds.items(), key=lambda item: -item[1]):
        if seconds > LEAST * block.whole:
            print(f"  {step:32s}{seconds * per_million:8.3f}")
    print(f"  {'whole stage':32s}{block.whole * per_million:8.3f}")


def print_searches(block: Block) -> None:
    """What the search for 15 neighbours alone takes with other libraries."""
    start = time.process_time()
    places = np.ascontiguousarray(build(block.xyz).points[:3].T)
    print(f"  {'our tree':32s}{(time.process_time() - start) / len(places) * 1e6:8.3f}")
    rates = {}
    single = (places / 1000.0).astype(np.float32)
    for name, search in installed():
        start = time.process_time()
        search(single)
        rates[name] = (time.process_time() - start) / len(single)
    start = time.process_time()
    tree = cKDTree(places)
    built = (time.process_time() - start) / len(places)
    start = time.process_time()
    tree.query(places[:SOME], k=16)
    rates["cKDTree, k = 15"] = built + (time.process_time() - start) / min(SOME, len(places))
    whole = block.whole / block.read
    for name, rate in rates.items():
        print(f"  {name:32s}{rate * 1e6:8.3f}   stage per point read: {whole / rate:5.2f} x")


def main(workflow: Path, names: list[str]) -> None:
    """Print everything."""
    tasks, context = blocks(workflow)
    known = [task.name for task in tasks]
    if unknown := sorted({*names} - {*known}):
        sys.exit(f"no such block: {', '.join(unknown)}; there are {', '.join(known)}")
    differing = compared = owned = 0
    seconds = 0.0
    for task in tasks:
        if names and task.name not in names:
            continue
        block = Block(task, context)
        print_steps(task.name, block)
        if block.read >= SOME:
            print_searches(block)
        before = read_columns(context.store.labels("noise", task.name), ["noise_class", "wire"])
        for label, values in before.items():
            differing += int(np.count_nonzero(values != block.labels[label]))
        compared += len(before["wire"])
        owned, seconds = owned + block.owned, seconds + block.whole
    print(f"all: {seconds / max(owned, 1) * 1e6:.2f} s per million owned")
    print(f"labels that differ from the store's: {differing} of {compared} points")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("workflow", type=Path, help="of a finished run")
    parser.add_argument("blocks", nargs="*", metavar="block", help="all of them by default")
    given = parser.parse_args()
    main(given.workflow, given.blocks)
