"""What handing out tasks costs: ``python -m benchmarks.scheduler client|cluster|timeline``.

``client --tiles N`` takes a made-up survey of N tiles through the phases of the space domain
with tasks that end at once, and prints the client's time for a task and its memory.
``cluster`` hands tasks to two local workers: empty ones a second for several settings, the
share of the time that workers are busy with longer ones, and the scheduler's memory over many.
``timeline OUTPUT`` prints at which stage each worker of a run was, by the log of its output.
"""

import argparse
import hashlib
import itertools
import json
import pickle
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import dask
from distributed import Client, LocalCluster, as_completed

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, Source
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.graph import Worklist
from spl_batch.engine.watch.status import LOG, seconds
from spl_batch.formats.las.reader import LasFacts

SPACE = ("build_tile", "denoise", "ground", "surface", "deliver_file", "mosaic")
"""Phases that are gone through."""

TILE_M = 100
TILE_POINTS = 200_000
"""Points of a tile: 20 for each square metre."""

SWATH_TILES = 20
"""Tiles across a flightline; half of them overlap the next one."""

FILES_PER_LINE = 20


REPEATS = 3
"""Times that each speed is measured [count]."""

TASK_S = (0.03, 0.3, 1.0)
"""How long tasks last that stand for work [s]."""

WORK_S = 2.0
"""Work of each worker in one measurement, about [s]."""

MEASURED = 100
"""Of so many tasks one is pickled to see how large it is in a message [count]."""


def resident_mib() -> float:
    """Memory of this process that is in use now [MiB]."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) / 256


def made_up_survey(side: int, memory_bytes: int) -> Survey:
    """Survey of side x side tiles up to the end of its shuffle."""
    workflow = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "made up")
    lines = max(side // (SWATH_TILES // 2), 1)
    sources = tuple(_source(k, side) for k in range(lines * FILES_PER_LINE))
    survey = Survey(Inputs(sources, (), (), Files(), None, ()), workflow, memory_bytes, 16)
    for source in sources:
        place = {"bounds": _bounds(side), "parts": [{}]}
        facts = {"hash": _hash(source.name), "points": 1, "spans": {}, **place}
        facts |= {"excluded": 0, "standard": "week"}
        survey.of("index_file").put(_receipt("index_file", str(source.key), facts, 10**8))
    for line, k in itertools.product(range(lines), range(side)):
        survey.of("scatter").put(_scatter(f"{line:05d}_371000000/{k}", line, k, side))
    return survey


def _source(k: int, side: int) -> Source:
    facts = LasFacts(
        Path(f"line_{k}.laz"), 1, 10**8, (1, 4), 6, (0.001,) * 3, (0.0,) * 3,
        (0.0,) * 3, (side * TILE_M, side * TILE_M, 100.0), None,
        adjusted_standard_bit=True, has_gps_time=True, dimensions=(), warnings=(), rounding=(),
        layers_can_be_copied=True,
    )  # fmt: skip
    return Source(facts.path, facts.path.name, facts.path.name, k + 10**18, facts)


def _bounds(side: int) -> list[int]:
    return [0, 0, 0, side * TILE_M * 1000, side * TILE_M * 1000, 100_000]


def _scatter(name: str, line: int, k: int, side: int) -> Receipt:
    """Stretch as wide as the swath and a tile long, which touches the next tile too."""
    south = line * SWATH_TILES // 2
    rows = range(south, min(south + SWATH_TILES + 1, side))
    cells = [(i, j) for j in rows for i in (k, k + 1) if i < side]
    low, high = [k * TILE_M, south * TILE_M], [(k + 2) * TILE_M, (south + SWATH_TILES) * TILE_M]
    facts = {
        "tiles": {f"{i}_{j}": [g, TILE_POINTS // 4] for g, (i, j) in enumerate(cells)},
        "voxels": {name: [*(v // 10 for v in low), 0, *(v // 10 for v in high), 40]},
        "fired": [*low, *high],
        "fired_blocks": [12, 0],
    }
    return _receipt("scatter", name, facts, 2_000_000)


def _hash(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _receipt(kind: str, name: str, facts: dict[str, Any], points: int) -> Receipt:
    outputs = {f"store/{kind}/{name}": _hash(name)}
    return Receipt(kind, name, "", _hash(kind + name), "", outputs, facts, points, 1.0, 900.0)


def _done(task: Task, side: int) -> Receipt:
    """What a task of this kind would leave."""
    facts: dict[str, Any] = {"core": [0, 0, 1, 1]}
    if task.kind == "build_tile":
        i, j = map(int, task.name.split("_"))
        line = min(j // (SWATH_TILES // 2), max(side // (SWATH_TILES // 2), 1) - 1)
        here = line * FILES_PER_LINE + i * FILES_PER_LINE // side
        sources = [str(10**18 + max(k, 0)) for k in (here - FILES_PER_LINE, here)]
        facts = {"points": task.points, "z": [0, 9], "outside_aoi": 0, "no_beam": 0, "copies": 0}
        facts["sources"] = sources
    if task.kind == "surface":
        facts["rasters"] = dict.fromkeys(("dtm", "dsm", "chm", "density", "noise"), "0" * 16)
    return _receipt(task.kind, task.name, facts, task.points)


def client(tiles: int, memory_bytes: int) -> None:
    """Print what the client spends on each phase."""
    side = round(tiles**0.5)
    start = time.process_time()
    survey = made_up_survey(side, memory_bytes)
    print(f"{side**2:,} tiles, {len(survey.of('scatter')):,} stretches of", end=" ")
    print(f"{time.process_time() - start:.0f} s; {resident_mib():.0f} MiB before the first phase")
    print(
        f"{'phase':14s}{'tasks':>10s}{'us / task':>12s}{'s':>8s}{'MiB after':>12s}{'peak':>8s}"
        f"{'largest message KiB':>21s}"
    )
    with tempfile.TemporaryDirectory() as folder:
        context = Context(survey.workflow, Path(folder), Path(folder), "", "code")
        for step in map(STEPS.__getitem__, SPACE):
            start = time.process_time()
            work = Worklist(step, survey, context)
            for _ in work.look():
                pass
            largest = 0
            for k, task in enumerate(work.tasks()):
                if k % MEASURED == 0:
                    largest = max(largest, len(pickle.dumps(replace(task, needs=()))))
                survey.of(step.name).put(_done(task, side))
            survey.of(step.name).sort()
            spent = time.process_time() - start
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{step.name:14s}{work.left:10,d}{1e6 * spent / max(work.left, 1):12.0f}"
                f"{spent:8.1f}{resident_mib():12.0f}{peak:8.0f}{largest / 1024:21.1f}",
                flush=True,
            )


def sleeping_task(task: Task, key: str, context: Context, task_s: float) -> Receipt:
    """Receipt of nothing after so long: what a task costs beside its work."""
    if task_s:
        time.sleep(task_s)
    return Receipt(task.kind, task.name, key, key, "", {}, {"code": context.code}, 0, 0.0, 0.0)


def cluster(count: int, many: int) -> None:
    """Print tasks a second by settings, what is lost beside real work, memory over many tasks."""
    workflow = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "made up")
    context = Context(workflow, Path("/"), Path("/"), "PROJCRS" + 4000 * "x", "code")
    print(f"medians of {REPEATS}; two workers of one thread")
    print(f"{'saturation':>12s}{'in flight':>11s}{'empty tasks / s':>17s}   ", end="")
    print("".join(f"{f'busy at {s:g} s':>16s}" for s in TASK_S))
    for saturation in (1.1, 2, "inf"):
        with _workers(saturation) as on:
            _seconds(on, 50, 2, context)
            for flight in (1, 3, 10):
                rates = [count / _seconds(on, count, flight, context) for _ in range(REPEATS)]
                print(f"{saturation!s:>12s}{flight:11d}{median(rates):17.0f}   ", end="")
                for task_s in TASK_S:
                    tasks = max(round(WORK_S / task_s) * 2, 6)
                    wall_s = median(
                        _seconds(on, tasks, flight, context, task_s) for _ in range(REPEATS)
                    )
                    print(f"{tasks * task_s / 2 / wall_s:16.1%}", end="", flush=True)
                print()
    with _workers(1.1) as on:
        print(f"{'tasks':>10s}{'MiB of client and scheduler':>30s}")
        for done in range(0, many, many // 5):
            print(f"{done:10,d}{resident_mib():30.0f}", flush=True)
            _seconds(on, many // 5, 3, context)
        print(f"{many:10,d}{resident_mib():30.0f}")


class _workers:  # noqa: N801 - a context manager
    """Two workers whose scheduler lives in this process."""

    def __init__(self, saturation: object) -> None:
        self.settings = {"distributed.scheduler.worker-saturation": saturation}

    def __enter__(self) -> Client:
        with dask.config.set(self.settings):
            self.cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        self.client = Client(self.cluster)
        return self.client

    def __exit__(self, *_: object) -> None:
        self.client.close()
        self.cluster.close()


def _seconds(
    on: Client, count: int, per_thread: int, context: Context, task_s: float = 0.0
) -> float:
    """Time to hand out tasks and take their receipts, as a run does [s]."""
    limit = per_thread * sum(on.nthreads().values())
    jobs = (
        Task("ground", f"{k}_0", {"tiles": [f"{k}_{n}" for n in range(16)]}) for k in range(count)
    )
    pool, running = as_completed(with_results=False), 0
    start = time.perf_counter()
    left: Iterator[Task] = iter(jobs)
    while True:
        while running < limit and (task := next(left, None)) is not None:
            key = _hash(task.name)
            pool.add(on.submit(sleeping_task, task, key, context, task_s, pure=False))
            running += 1
        if not running:
            return time.perf_counter() - start
        next(pool).result()
        running -= 1


LETTERS = {
    "index": "i", "shots": "s", "shuffle": "h", "denoise": "D", "ground": "G", "surfaces": "S",
    "deliver": "d", "report": "r",
}  # fmt: skip
"""What the timeline shows of each stage; ``.`` is nothing."""


def timeline(output: Path, columns: int) -> None:
    """Print at which stage each worker of the latest run with some was, moment by moment."""
    lines = (output / LOG).read_text(encoding="utf-8").splitlines()
    records = [json.loads(line) for line in lines]
    began: dict[tuple[str, str], tuple[str, float]] = {}
    spans: dict[str, list[tuple[float, float, str]]] = defaultdict(list)
    for record in records:
        if record["event"] == "WorkersReady":
            spans.clear()
        elif record["event"] == "TaskStarted":
            began[record["kind"], record["name"]] = record["worker"], seconds(record)
        elif record["event"] == "TaskEnded" and (record["kind"], record["name"]) in began:
            worker, start_s = began.pop((record["kind"], record["name"]))
            spans[worker].append((start_s, seconds(record), record["stage"]))
    every = [span for found in spans.values() for span in found]
    first_s, last_s = min(s for s, _, _ in every), max(e for _, e, _ in every)
    column_s = (last_s - first_s) / columns
    for number, found in enumerate(spans.values(), start=1):
        row = ["."] * columns
        for start_s, end_s, stage in found:
            first = int((start_s - first_s) / column_s)
            for k in range(first, max(round((end_s - first_s) / column_s), first + 1)):
                row[min(k, columns - 1)] = LETTERS[stage]
        busy = sum(end_s - start_s for start_s, end_s, _ in found) / (last_s - first_s)
        print(f"{number} {''.join(row)} {busy:4.0%}")
    print(f"{last_s - first_s:.1f} s; " + ", ".join(f"{v} {k}" for k, v in LETTERS.items()))


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    of_client = verbs.add_parser("client")
    of_client.add_argument("--tiles", type=int, default=100_000)
    of_client.add_argument("--memory-gib", type=float, default=4.0)
    of_cluster = verbs.add_parser("cluster")
    of_cluster.add_argument("--count", type=int, default=500)
    of_cluster.add_argument("--many", type=int, default=50_000)
    of_timeline = verbs.add_parser("timeline")
    of_timeline.add_argument("output", type=Path)
    of_timeline.add_argument("--columns", type=int, default=90)
    given = parser.parse_args()
    if given.verb == "timeline":
        timeline(given.output, given.columns)
    elif given.verb == "client":
        client(given.tiles, int(given.memory_gib * 2**30))
    else:
        cluster(given.count, given.many)


if __name__ == "__main__":
    main()
