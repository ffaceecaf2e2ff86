"""Picture of a run's graph: ``python -m benchmarks.graph_picture WORKFLOW [FILE]``.

A column for each step and a dot for each task of it; lines lead from what a task needs, as the
scheduler gets it. The run of WORKFLOW has finished.
"""

import sys
from collections import defaultdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from spl_batch.engine.report import style
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.tasks.task import Need
from spl_batch.engine.verbs.planning import prepare

FILE: Final = Path("docs/images/graph.png")
MOST_BYTES: Final = 150_000
SIZE_IN: Final = (10.5, 4.6)

COLOURS: Final = (
    *(style.RAW, style.SIGNAL, "#24786a", style.NOISE, style.GROUND, "#6fae6b"),
    *(style.AFTERPULSE, style.INK),
)
"""Of the stages, in order."""


def tasks(workflow: Path) -> dict[str, list[tuple[str, tuple[Need, ...]]]]:
    """Tasks by step, in order: their names and what they need."""
    prepared = prepare(workflow, ())
    ledger, store = prepared.ledger, prepared.context.store
    for kind in prepared.steps:
        for receipt in read_receipts(store, kind):
            ledger.of(kind).put(receipt)
    planned = {
        name: [(task.name, task.needs) for task in step.planned(ledger)]
        for name, step in prepared.steps.items()
    }
    return {name: found for name, found in planned.items() if found}


def draw(workflow: Path) -> Any:
    """The graph as a figure."""
    steps = prepare(workflow, ()).steps
    found = tasks(workflow)
    stages = list(dict.fromkeys(step.stage for step in steps.values()))
    places: dict[Need, tuple[float, float]] = {}
    for column, (kind, listed) in enumerate(found.items()):
        heights = np.linspace(0.0, 1.0, len(listed) + 2)[1:-1]
        for (name, _), height in zip(listed, heights[::-1], strict=True):
            places[kind, name] = (column, float(height))
    lines: dict[str, list[Any]] = defaultdict(list)
    for kind, listed in found.items():
        for name, needs in listed:
            lines[kind] += [(places[need], places[kind, name]) for need in needs]
    with style.type_context():
        figure = style.figure(*SIZE_IN)
        axes = figure.add_subplot(xlim=(-0.6, len(found) - 0.4), ylim=(-0.02, 1.02))
        for kind, pairs in lines.items():
            colour = COLOURS[stages.index(steps[kind].stage)]
            ends = np.array(pairs).reshape(-1, 2, 2)
            axes.plot(ends[..., 0].T, ends[..., 1].T, color=colour, linewidth=0.4, alpha=0.35)
        for kind in found:
            x, y = np.array([places[kind, name] for name, _ in found[kind]]).T
            stage = steps[kind].stage
            shown = stage if stage not in axes.get_legend_handles_labels()[1] else "_"
            axes.plot(x, y, "o", color=COLOURS[stages.index(stage)], markersize=5, label=shown)
        names = [f"{kind.replace('_', ' ')} {len(listed)}" for kind, listed in found.items()]
        axes.set_xticks(range(len(found)), names, rotation=40, ha="right")
        axes.set_yticks([])
        for side in ("left", "right", "top"):
            axes.spines[side].set_visible(False)
        figure.legend(loc="outside upper center", ncols=len(stages))
    return figure


def main(workflow: Path, file: Path) -> None:
    """Draw the graph of a workflow."""
    file.write_bytes(style.to_png(draw(workflow), MOST_BYTES)[0])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else FILE)
