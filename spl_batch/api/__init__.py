"""The verbs of the project, usable from a notebook; the command line only calls these.

A verb is imported when it is asked for: planning needs no pictures, for instance.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spl_batch.airborne.arrays.filtering import expected_noise, filter_points
    from spl_batch.airborne.arrays.labels import ExpectedNoise, Labels
    from spl_batch.airborne.arrays.surfaces import Rasters, ground_points, rasterize
    from spl_batch.airborne.first_use.one_file import denoise
    from spl_batch.airborne.quickstart import quickstart
    from spl_batch.cli.view import watching
    from spl_batch.engine.verbs.beginning import Beginning, init
    from spl_batch.engine.verbs.comparing import ComparisonResult, compare
    from spl_batch.engine.verbs.planning import PlanSummary, plan
    from spl_batch.engine.verbs.reporting import report
    from spl_batch.engine.verbs.running import RunResult, run
    from spl_batch.engine.verbs.simulation import simulate
    from spl_batch.engine.watch.status import Follower, RunStatus, StageStatus, status

__all__ = [
    "Beginning",
    "ComparisonResult",
    "ExpectedNoise",
    "Follower",
    "Labels",
    "PlanSummary",
    "Rasters",
    "RunResult",
    "RunStatus",
    "StageStatus",
    "compare",
    "denoise",
    "expected_noise",
    "filter_points",
    "ground_points",
    "init",
    "plan",
    "quickstart",
    "rasterize",
    "report",
    "run",
    "simulate",
    "status",
    "watching",
]

_HOMES = {
    "spl_batch.airborne.arrays.filtering": ("expected_noise", "filter_points"),
    "spl_batch.airborne.arrays.labels": ("ExpectedNoise", "Labels"),
    "spl_batch.airborne.arrays.surfaces": ("Rasters", "ground_points", "rasterize"),
    "spl_batch.airborne.first_use.one_file": ("denoise",),
    "spl_batch.airborne.quickstart": ("quickstart",),
    "spl_batch.cli.view": ("watching",),
    "spl_batch.engine.verbs.beginning": ("Beginning", "init"),
    "spl_batch.engine.verbs.comparing": ("ComparisonResult", "compare"),
    "spl_batch.engine.verbs.planning": ("PlanSummary", "plan"),
    "spl_batch.engine.verbs.reporting": ("report",),
    "spl_batch.engine.verbs.running": ("RunResult", "run"),
    "spl_batch.engine.verbs.simulation": ("simulate",),
    "spl_batch.engine.watch.status": ("Follower", "RunStatus", "StageStatus", "status"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
