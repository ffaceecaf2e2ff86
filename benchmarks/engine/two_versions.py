"""Processor time of this version over that of another, task by task.

Run ``python -m benchmarks.engine.two_versions WORKFLOW CHECKOUT [--turns 2] [--rounds 3]``.
On a machine whose speed comes and goes add ``--together``: both run at once, each on a processor of
its own, which they swap from turn to turn, so what else goes on slows both alike.

Both versions run :mod:`benchmarks.engine.task_times` of their own on the same files, in turns, with
the settings for malloc and Arrow that workers have. Of each kind of task the least of all turns
counts: what other work on the machine adds is left out. Check points of the reference are, as older
versions know none. The last lines are the ratio, and the highest memory of the process.
"""

import argparse
import os
import sys
from pathlib import Path
from subprocess import PIPE, Popen

from benchmarks.airborne.other_version import without_checkpoints
from spl_batch.engine.flow.cluster import SETTINGS

_ENVIRON = "distributed.nanny.pre-spawn-environ."


def started(checkout: Path, workflow: Path, rounds: int, processor: int | None) -> Popen[str]:
    """Tasks of a version, timed in a process of its own, on one processor where that is asked."""
    workers = {
        key.removeprefix(_ENVIRON): str(value)
        for key, value in SETTINGS.items()
        if key.startswith(_ENVIRON)
    }
    process = Popen(  # noqa: S603
        [sys.executable, "-m", "benchmarks.engine.task_times", str(workflow), str(rounds)],
        cwd=checkout,
        env={**os.environ, **workers, "PYTHONPATH": str(checkout)},
        stdout=PIPE,
        text=True,
    )
    if processor is not None:
        os.sched_setaffinity(process.pid, [processor])
    return process


def told_by(process: Popen[str]) -> tuple[dict[str, float], float]:
    """Seconds of a processor per million returns by kind of task, and highest memory [MiB]."""
    table = process.communicate()[0].splitlines()
    if process.returncode:
        sys.exit(process.returncode)
    *rows, last = (row.split() for row in table[2:])
    return {row[0]: float(row[1]) for row in rows}, float(last[-2])


def main() -> None:
    """Run in turns and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("workflow", type=Path)
    parser.add_argument("checkout", type=Path, help="folder of the other version")
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--together", action="store_true", help="both at once")
    given = parser.parse_args()
    workflow = without_checkpoints(given.workflow.resolve())
    versions = [given.checkout.resolve(), Path(__file__).resolve().parents[2]]
    least: list[dict[str, float]] = [{}, {}]
    peak_mb = [0.0, 0.0]
    for turn in range(given.turns):
        found = []
        for k, version in enumerate(versions):
            processor = (turn + k) % 2 if given.together else None
            process = started(version, workflow, given.rounds, processor)
            found.append(process if given.together else told_by(process))
        for k, one in enumerate(found):
            seconds, most = told_by(one) if isinstance(one, Popen) else one
            peak_mb[k] = max(peak_mb[k], most)
            for kind, spent in seconds.items():
                least[k][kind] = min(spent, least[k].get(kind, spent))
        sums = [sum(known.values()) for known in least]
        print(f"turn {turn + 1}: {sums[0]:.2f} -> {sums[1]:.2f}", flush=True)
    print(f"{'s / million':20s}{'other':>9s}{'this':>9s}")
    for kind in dict.fromkeys([*least[0], *least[1]]):
        row = "".join(f"{known.get(kind, 0.0):9.3f}" for known in least)
        print(f"{kind:20s}{row}")
    before, after = (sum(known.values()) for known in least)
    print(f"{'all':20s}{before:9.3f}{after:9.3f}   {after / before:.2f} x")
    print(f"{'highest memory [MiB]':20s}{peak_mb[0]:9.0f}{peak_mb[1]:9.0f}")


if __name__ == "__main__":
    main()
