"""Processor time of what was added to the stages of the airborne chain, within its tasks.

Run ``python -m benchmarks.airborne.parts_cost WORKFLOW [ROUNDS]``.

Runs a workflow as :mod:`benchmarks.engine.task_times` does, and adds up what each of some functions
takes, the least of all rounds but the first, which compiles. Reading that only serves one of them
is part of it where the function reads.
"""

import argparse
import importlib
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from benchmarks.engine.task_times import round_of

PARTS: Final = {
    "haze and cloud in the air of a block": ("filter.air:look_at_air",),
    "crosstalk": ("beams.crosstalk:observe", "beams.crosstalk:set_off"),
    "bloom": ("afterpulse.candidates:find_bloom", "tasks.time_domain:find_bloom"),
    "strips beside each other": (
        "lines.comparison:strip_patches",
        "lines.comparison:strip_pairs",
    ),
    "mist and sheets near the ground, kept noise": (
        "products.air.near_ground:placed",
        "products.air.near_ground:filled_places",
        "products.air.near_ground:low_places",
        "products.air.thin_haze:filled_blocks",
        "products.air.thin_sheets:sheets",
        "filter.kept_noise:within_signal",
    ),
    "pulses, swaths, steady heights, with their read": ("tasks.surfaces:_pulses",),
    "doubts about the terrain": (
        "products.surface_rasters:doubts",
        "tasks.surfaces:block_facts",
        "tasks.surfaces:doubt_facts",
    ),
    "standard deviation of the terrain": ("products.surface_rasters:terrain_sigma",),
    "noise around raster cells": ("products.surface_rasters:support_of",),
}
"""What is timed, and the functions that do it, as ``module:name`` where they are called."""


def watched(spent: defaultdict[str, float]) -> None:
    """Have each function add its seconds to what its part has spent."""
    for part, places in PARTS.items():
        for place in places:
            module, name = place.split(":")
            home = importlib.import_module(f"spl_batch.airborne.{module}")
            setattr(home, name, _timed(getattr(home, name), part, spent))


def _timed(
    function: Callable[..., Any], part: str, spent: defaultdict[str, float]
) -> Callable[..., Any]:
    def timed(*args: Any, **given: Any) -> Any:
        begin = time.process_time()
        try:
            return function(*args, **given)
        finally:
            spent[part] += time.process_time() - begin

    return timed


def main(workflow: Path, rounds: int) -> None:
    """Print the table."""
    spent: defaultdict[str, float] = defaultdict(float)
    watched(spent)
    least: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            spent.clear()
            _, returns = round_of(workflow, Path(folder, "out"))
            shutil.rmtree(Path(folder, "out"))
            for part in PARTS if number else ():
                least[part] = min(spent[part], least.get(part, spent[part]))
    for part, seconds in least.items():
        print(f"{part:50s}{1e3 * seconds / (returns / 1e6):8.0f} ms / million")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("workflow", type=Path)
    parser.add_argument("rounds", nargs="?", type=int, default=3, help="at least 2")
    given = parser.parse_args()
    main(given.workflow, max(given.rounds, 2))
