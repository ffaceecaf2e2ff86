"""What tasks of the space domain find done: labels and shifts of the points that they read.

They go without those of a task that has failed: its points have no labels then. Each function turns
a task's arguments and what is finished of its needs into the arguments that it is done with, or
None where it is left out.
"""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, Final

from spl_batch.engine.tasks.task import Need

MADE_BY: Final[Mapping[str, str]] = MappingProxyType(
    {"noise": "denoise", "ground": "ground", "classes": "surface"}
)
"""Step that gives each kind of labels."""

SHIFTED: Final[Need] = ("align", "all")
"""Task that finds by how much heights are shifted."""


def labelled(args: Mapping[str, Any], found: Collection[Need]) -> dict[str, Any]:
    """A task with the labels that there are, by kind, and whether heights are shifted."""
    labels = {
        kind: sorted(name for step, name in found if step == made_by)
        for kind, made_by in MADE_BY.items()
    }
    return {**args, "labels": labels, "aligned": SHIFTED in found}


def on_ground(args: Mapping[str, Any], found: Collection[Need]) -> dict[str, Any] | None:
    """A cell likewise, if its ground is there."""
    return labelled(args, found) if ("ground", args["cell"]) in found else None
