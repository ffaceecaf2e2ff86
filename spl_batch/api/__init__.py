"""The verbs of the project, usable from a notebook; the command line only calls these.

A verb is imported when it is asked for: planning needs no pictures, say.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spl_batch.engine.watch.status import Follower, RunStatus, StageStatus, status

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
    "ExpectedNoise": "spl_batch.airborne.arrays.labels",
    "Labels": "spl_batch.airborne.arrays.labels",
    "expected_noise": "spl_batch.airborne.arrays.filtering",
    "filter_points": "spl_batch.airborne.arrays.filtering",
    "Rasters": "spl_batch.airborne.arrays.surfaces",
    "ground_points": "spl_batch.airborne.arrays.surfaces",
    "rasterize": "spl_batch.airborne.arrays.surfaces",
    "ComparisonResult": "spl_batch.engine.verbs.comparing",
    "compare": "spl_batch.engine.verbs.comparing",
    "RunResult": "spl_batch.engine.verbs.running",
    "run": "spl_batch.engine.verbs.running",
    "PlanSummary": "spl_batch.engine.verbs.planning",
    "plan": "spl_batch.engine.verbs.planning",
    "report": "spl_batch.engine.verbs.reporting",
    "Beginning": "spl_batch.engine.verbs.beginning",
    "init": "spl_batch.engine.verbs.beginning",
    "denoise": "spl_batch.airborne.first_use.one_file",
    "quickstart": "spl_batch.airborne.quickstart",
    "simulate": "spl_batch.engine.verbs.simulation",
    "watching": "spl_batch.cli.view",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
