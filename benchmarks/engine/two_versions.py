"""Processor time of this version over that of another, task by task.

Run ``python -m benchmarks.engine.two_versions WORKFLOW CHECKOUT [--turns 2] [--rounds 3]``.

Both versions run :mod:`benchmarks.engine.task_times` of their own on the same files, in turns, with
the settings for malloc and Arrow that workers have. Of each kind of task the least of all turns
counts: what other work on the machine adds is left out. Check points of the reference are, as older
versions know none. The last lines are the ratio, and the highest memory of the process.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.airborne.other_version import without_checkpoints
from spl_batch.engine.flow.cluster import SETTINGS

_ENVIRON = "distributed.nanny.pre-spawn-environ."


def times(checkout: Path, workflow: Path, rounds: int) -> tuple[dict[str, float], float]:
    """Seconds of a processor per million returns by kind of task, and highest memory [MiB]."""
    workers = {
        key.removeprefix(_ENVIRON): str(value)
        for key, value in SETTINGS.items()
        if key.startswith(_ENVIRON)
    }
    table = subprocess.run(  # noqa: S603
        [sys.executable, "-m", "benchmarks.engine.task_times", str(workflow), str(rounds)],
        cwd=checkout,
        env={**os.environ, **workers, "PYTHONPATH": str(checkout)},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    ).stdout.splitlines()
    *rows, last = (row.split() for row in table[2:])
    return {row[0]: float(row[1]) for row in rows}, float(last[-2])


def main() -> None:
    """Run in turns and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("workflow", type=Path)
    parser.add_argument("checkout", type=Path, help="folder of the other version")
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    workflow = without_checkpoints(given.workflow.resolve())
    versions = [given.checkout.resolve(), Path(__file__).resolve().parents[2]]
    least: list[dict[str, float]] = [{}, {}]
    peak_mb = [0.0, 0.0]
    for turn in range(given.turns):
        for k, (version, known) in enumerate(zip(versions, least, strict=True)):
            found, most = times(version, workflow, given.rounds)
            peak_mb[k] = max(peak_mb[k], most)
            for kind, seconds in found.items():
                known[kind] = min(seconds, known.get(kind, seconds))
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
