"""Processor time of each kind of task.

Run ``python -m benchmarks.engine.task_times WORKFLOW [ROUNDS]``.

Runs a workflow in this process, into a folder of its own, and prints for each kind of task seconds
of a processor per million input returns, how much of them the kernel took, and page faults: the
least of all rounds but the first, which compiles. Wall time tells little where other work comes
and goes, and two workers share what memory gives.

Workers are started with settings for malloc and Arrow (``spl_batch.engine.flow.cluster.SETTINGS``);
give them to this process too, to see what a worker takes.
"""

import argparse
import resource
import shutil
import sys
import tempfile
from pathlib import Path

from spl_batch.engine.tasks.runner import run_task
from spl_batch.engine.verbs.preparing import prepare

Cost = tuple[float, float, float]


def used() -> Cost:
    """Seconds of a processor, those of the kernel among them, and page faults so far."""
    so_far = resource.getrusage(resource.RUSAGE_SELF)
    return so_far.ru_utime + so_far.ru_stime, so_far.ru_stime, float(so_far.ru_minflt)


def round_of(workflow: Path, output: Path) -> tuple[dict[str, Cost], int]:
    """What each kind of task took, and the returns of the inputs."""
    prepared = prepare(workflow, [f"output={output}"])
    survey, context = prepared.ledger, prepared.context
    context.store.local.mkdir(parents=True)
    cost: dict[str, Cost] = {}
    for step in prepared.steps.values():
        prepared.receiver.before(step, prepared)
        before = used()
        for task in list(step.planned(survey)):
            receipt = run_task(task, "", context)
            if receipt.failed:
                sys.exit(f"{task.kind} {task.name}: {receipt.reason}")
            survey.of(task.kind).put(receipt)
        cost[step.name] = tuple(b - a for a, b in zip(before, used(), strict=True))
    return cost, sum(source.facts.n_points for source in survey.inputs.sources)


def main(workflow: Path, rounds: int) -> None:
    """Print the table."""
    least: dict[str, Cost] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            output = Path(folder, "out")
            cost, returns = round_of(workflow, output)
            shutil.rmtree(output)
            for kind, spent in cost.items() if number else ():
                least[kind] = min(spent, least.get(kind, spent))
    millions = returns / 1e6
    print(f"{workflow}: {millions:.2f} M returns, least of {rounds - 1} rounds")
    print(f"{'kind':12s}{'s / M':>9s}{'kernel':>9s}{'faults':>9s}")
    for kind, (seconds, kernel, faults) in least.items():
        if seconds > 1e-3 * millions:
            row = f"{seconds / millions:9.3f}{kernel / millions:9.3f}{faults / millions:9.0f}"
            print(f"{kind:12s}{row}")
    total = sum(seconds for seconds, _, _ in least.values())
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{'all':12s}{total / millions:9.3f}   peak {peak_mb:.0f} MiB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("workflow", type=Path, help="of a finished run")
    parser.add_argument("rounds", nargs="?", type=int, default=4, help="at least 2")
    given = parser.parse_args()
    main(given.workflow, max(given.rounds, 2))
