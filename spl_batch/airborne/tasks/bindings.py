"""What tasks of the space domain go without where a task that they need has failed.

Its points have no labels then. Each function turns a task's arguments and what is finished of its
needs into the arguments that it is done with, or None where it is left out.
"""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, Final

from spl_batch.engine.tasks.task import Need

MADE_BY: Final[Mapping[str, str]] = MappingProxyType(
    {"noise": "denoise", "ground": "ground", "classes": "surface"}
)
"""Step that gives each kind of labels."""


def labelled(args: Mapping[str, Any], found: Collection[Need]) -> dict[str, Any]:
    """A task with the labels that there are."""
    labels = {
        kind: {
            tile: [unit for unit in units if (MADE_BY[kind], unit) in found]
            for tile, units in by_tile.items()
        }
        for kind, by_tile in args.get("labels", {}).items()
    }
    return {**args, "labels": labels} if labels else dict(args)


def on_ground(args: Mapping[str, Any], found: Collection[Need]) -> dict[str, Any] | None:
    """A cell likewise, if its ground is there."""
    return labelled(args, found) if ("ground", args["cell"]) in found else None
