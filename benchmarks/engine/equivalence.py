"""The same bytes, however a survey is run.

Run ``python -m benchmarks.engine.equivalence [FOLDER] [KILLS]``.

Simulates a small survey into FOLDER (a temporary one by default), runs it once as it is, and
then with other tiles, other numbers of workers, its tasks in another order, on a cluster by its
address, and killed with SIGKILL at KILLS moments each (default 3): the whole process group, one
worker, the client alone, the cluster's scheduler. Labels (the delivered clouds) and rasters must
be the same files, byte for byte; a killed run, continued by the same command, must do nothing
again of what was finished. Prints a line for each way and exits with 1 if one of them fails.
"""

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import psutil

from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.cli import main as command_line
from spl_batch.engine.flow.executor import Job
from spl_batch.engine.tasks.worklist import Worklist

SCENE: dict[str, Any] = {
    "extent_m": [220, 180],
    "seed": 11,
    "buildings": {"count": 4},
    "trees": {"cover": 0.25},
    "wires": [{"kind": "transmission", "points_m": [[-60, 30], [110, 60], [290, 90]]}],
    "flights": [{"heading_deg": 0, "offset_m": 300}, {"heading_deg": 90, "offset_m": -280}],
    "sky": {"background_per_m3": 0.1},
    "acquisition": {"prf_hz": 15_000, "gate_m": 200},
}
MEMORY = "2GiB"
LIMIT_S = 900.0


def main(folder: Path, kills: int) -> int:
    """Run every way and print how each compares; gives the number that fail."""
    simulate(parse_scene(SCENE, "benchmarks.engine.equivalence"), folder / "survey")
    base = _fresh(folder, "as it is")
    _run(base)
    expected, finished = _digest(base.parent / "out"), len(_receipts(base.parent / "out"))
    count = len(list((base.parent / "out" / "laz").rglob("*.laz")))
    print(
        f"{finished} tasks, {count} clouds; SHA-256 of clouds and rasters {expected[:16]}",
        flush=True,
    )
    print(f"{'way':44s}{'same':>6s}{'done / done again':>20s}{'wall s':>8s}")
    differ = 0
    for name, way in _ways(finished, kills):
        workflow = _fresh(folder, name)
        start = time.perf_counter()
        before = way(workflow)
        same = _digest(workflow.parent / "out") == expected
        after = _receipts(workflow.parent / "out")
        again = sum(after.get(name) != content for name, content in before.items())
        differ += not same or again > 0
        shown = f"{len(before)} / {again}" if before else ""
        wall_s = time.perf_counter() - start
        print(f"{name:44s}{'yes' if same else 'NO':>6s}{shown:>20s}{wall_s:8.1f}", flush=True)
        shutil.rmtree(workflow.parent)
    return differ


Receipts = dict[str, bytes]
"""Receipts of finished tasks, by name."""

Way = Callable[[Path], Receipts]
"""Runs a workflow to its end; gives what was finished when it was killed."""


def _ways(tasks: int, kills: int) -> Iterator[tuple[str, Way]]:
    """Every way, by name."""
    for edge in (60, 250):
        yield (
            f"tiles of {edge} m, 1 worker",
            _with("--workers", "1", "--set", f"tiling.tile_m={edge}"),
        )
    yield (
        "tiles of 60 m, blocks of one tile",
        _with("--set", "tiling.tile_m=60", "--set", "tiling.block_tiles=1"),
    )
    yield "4 workers", _with("--workers", "4")
    yield "in one process", _with("--workers", "0")
    yield "shuffled task order", _shuffled
    yield "half of the memory", _with("--memory", "1GiB")
    yield "cluster by its address", _on_cluster
    moments = random.Random(7)  # noqa: S311 - moments, no secret
    for victim in ("the process group", "a worker", "the client"):
        for _ in range(kills):
            after = moments.randrange(1, tasks - 1)
            yield f"SIGKILL of {victim} after {after} tasks", _killed(victim, after)
    for _ in range(kills):
        after = moments.randrange(1, tasks - 1)
        yield f"SIGKILL of the scheduler after {after} tasks", _scheduler_killed(after)


def _with(*options: str) -> Way:
    def way(workflow: Path) -> Receipts:
        _run(workflow, *options)
        return {}

    return way


def _shuffled(workflow: Path) -> Receipts:
    """Run by this script, as :func:`shuffle` says."""
    command = [sys.executable, "-m", "benchmarks.engine.equivalence", "shuffled", "5", "run"]
    options = (str(workflow), "--memory", MEMORY, "--set", "tiling.tile_m=60")
    done = subprocess.run([*command, *options], check=False, capture_output=True, timeout=LIMIT_S)  # noqa: S603
    if done.returncode:
        sys.exit(f"shuffled: ended with {done.returncode}: {done.stderr.decode()[-2000:]}")
    return {}


def shuffle(seed: int, arguments: Sequence[str]) -> None:
    """Be the command line, but hand out the tasks of each phase in another order."""
    mixing, in_order = random.Random(seed), Worklist.jobs  # noqa: S311 - an order, no secret

    def jobs(self: Worklist) -> Iterator[Job]:
        found = list(in_order(self))
        mixing.shuffle(found)
        yield from found

    with mock.patch.object(Worklist, "jobs", jobs):
        command_line(list(arguments))


def _on_cluster(workflow: Path) -> Receipts:
    with _cluster(workflow.parent) as (address, _):
        _run(workflow, "--scheduler", address)
    return {}


def _killed(victim: str, after: int) -> Way:
    def way(workflow: Path) -> Receipts:
        output = workflow.parent / "out"
        with _started(workflow) as process:
            _wait_for(output, after, process)
            if victim == "the process group":
                os.killpg(process.pid, signal.SIGKILL)
            elif victim == "the client":
                process.kill()
            else:
                _kill_a_worker(process.pid)
                # a lost worker is no failed task: this very run goes on to its end
                if process.wait(LIMIT_S) != 0:
                    sys.exit(f"a lost worker made the run end with {process.returncode}")
                return {}
            process.wait()
        found = _receipts(output)
        _wait_unlocked(workflow)
        return found

    return way


def _scheduler_killed(after: int) -> Way:
    def way(workflow: Path) -> Receipts:
        with _cluster(workflow.parent) as (address, scheduler):
            with _started(workflow, "--scheduler", address) as process:
                _wait_for(workflow.parent / "out", after, process)
                scheduler.kill()
                status = process.wait(LIMIT_S)
            if status != 3:
                sys.exit(f"a lost scheduler made the run end with {status}, not with 3")
        found = _receipts(workflow.parent / "out")
        _run(workflow)
        return found

    return way


def _wait_unlocked(workflow: Path) -> None:
    """Continue; workers that outlived their client may hold the place for a moment."""
    deadline = time.monotonic() + 60
    while (status := _status(workflow)) == 2 and time.monotonic() < deadline:
        time.sleep(1)
    if status != 0:
        sys.exit(f"continuing ended with {status}")


def _kill_a_worker(client: int) -> None:
    workers = [
        child
        for child in psutil.Process(client).children(recursive=True)
        if "spawn_main" in " ".join(child.cmdline())
    ]
    if not workers:
        sys.exit("no worker process found")
    workers[0].kill()


@contextmanager
def _started(workflow: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(  # noqa: S603
        _command(workflow, *options),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        yield process


def _wait_for(output: Path, receipts: int, process: subprocess.Popen[bytes]) -> None:
    while process.poll() is None and sum(1 for _ in _receipt_files(output)) < receipts:
        time.sleep(0.005)
    if process.poll() is not None:
        sys.exit(f"the run ended with {process.returncode} before it was to be killed")


@contextmanager
def _cluster(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Run scheduler and two workers by dask's own commands, each in a folder of its own."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    dask = [sys.executable, "-m", "dask"]
    scheduler = _start(
        [*dask, "scheduler", "--host", address, "--no-dashboard"], folder / "of_the_scheduler"
    )
    workers = [
        _start([*dask, "worker", address, "--nthreads", "1"], folder / f"of_worker_{k}")
        for k in range(2)
    ]
    try:
        yield address, scheduler
    finally:
        for process in (*workers, scheduler):
            process.terminate()
        for process in (*workers, scheduler):
            process.wait()


def _start(command: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
    folder.mkdir()
    # The package may stand beside this script only: the workers start somewhere else.
    path = os.pathsep.join(filter(None, [str(Path.cwd()), os.environ.get("PYTHONPATH", "")]))
    return subprocess.Popen(  # noqa: S603
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _command(workflow: Path, *options: str) -> list[str]:
    given = () if "--memory" in options else ("--memory", MEMORY)
    return [sys.executable, "-m", "spl_batch", "run", str(workflow), *given, *options]


def _status(workflow: Path, *options: str) -> int:
    done = subprocess.run(  # noqa: S603
        _command(workflow, *options), check=False, capture_output=True, timeout=LIMIT_S
    )
    if done.returncode not in {0, 2}:
        print(done.stderr.decode()[-2000:])
    return done.returncode


def _run(workflow: Path, *options: str) -> None:
    status = _status(workflow, *options)
    if status != 0:
        sys.exit(f"{' '.join(options) or 'the run'}: ended with {status}")


def _fresh(folder: Path, name: str) -> Path:
    """Give the survey an empty output of its own; inputs are links."""
    place = folder / hashlib.sha256(name.encode()).hexdigest()[:12]
    survey = folder / "survey"
    shutil.copytree(survey, place, copy_function=os.link, ignore=shutil.ignore_patterns("truth"))
    return place / "workflow.yaml"


def _receipt_files(output: Path) -> Iterator[Path]:
    return (output / "store" / "receipts").rglob("*.json")


def _receipts(output: Path) -> Receipts:
    """Receipts of what is finished; one that a dying worker takes away is none."""
    found = {}
    for path in list(_receipt_files(output)):
        with contextlib.suppress(FileNotFoundError):
            found[f"{path.parent.name}/{path.name}"] = path.read_bytes()
    return found


def _digest(output: Path) -> str:
    """Hash of every delivered cloud and raster, with their names."""
    digest = hashlib.sha256()
    files = sorted([*(output / "laz").rglob("*.laz"), *output.glob("*.tif")])
    for path in files:
        digest.update(path.relative_to(output).as_posix().encode() + path.read_bytes())
    counts = json.loads((output / "report.json").read_text(encoding="utf-8"))["counts"]
    if counts["points_in"] != counts["points_out"] or not files:
        sys.exit(f"{output}: {counts['points_in']} points in, {counts['points_out']} out")
    return digest.hexdigest()


if __name__ == "__main__":
    if sys.argv[1:2] == ["shuffled"]:
        shuffle(int(sys.argv[2]), sys.argv[3:])
    times = int(sys.argv[2]) if len(sys.argv) > 2 else 3
    if len(sys.argv) > 1:
        Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
        sys.exit(bool(main(Path(sys.argv[1]), times)))
    with tempfile.TemporaryDirectory() as temporary:
        sys.exit(bool(main(Path(temporary), times)))
