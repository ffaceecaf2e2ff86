"""What tasks of the space domain go without where a task that they need has failed.

Its points have no labels then. Each function turns a task's arguments and what is finished of its
needs into the arguments that it is done with, or None where it is left out.
"""

from collections.abc import Collection, Mapping
from typing import Any

from spl_batch.engine.tasks.task import Need

Found = Collection[Need]


def labelled(args: Mapping[str, Any], found: Found) -> dict[str, Any]:
    """A cell with the labels that there are."""
    there = {
        key: {
            tile: [unit for unit in units if (step, unit[1]) in found]
            for tile, units in args[key].items()
        }
        for key, step in (("noise", "denoise"), ("ground", "ground"))
        if key in args
    }
    return {**args, **there}


def on_ground(args: Mapping[str, Any], found: Found) -> dict[str, Any] | None:
    """A cell likewise, if its ground is there."""
    return labelled(args, found) if ("ground", args["cell"]) in found else None


def delivered(args: Mapping[str, Any], found: Found) -> dict[str, Any]:
    """A file with the labels that there are of its tiles."""
    return {**args, "tiles": {t: _units(units, found) for t, units in args["tiles"].items()}}


def delivered_tile(args: Mapping[str, Any], found: Found) -> dict[str, Any]:
    """A tile with the labels that there are."""
    return {**args, "units": _units(args["units"], found)}


def _units(units: Mapping[str, list[str]], found: Found) -> dict[str, list[str]]:
    steps = {"noise": "denoise", "classes": "surface"}
    return {key: [n for n in names if (steps[key], n) in found] for key, names in units.items()}
