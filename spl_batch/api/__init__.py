"""The verbs of the project, usable from a notebook; the command line only calls these.

A verb is imported when it is asked for: planning needs no pictures, say.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# At once, for a module has the name of the verb: imported later, that would take its place.
from spl_batch.api.follower import Follower, status
from spl_batch.api.status import RunStatus, StageStatus

if TYPE_CHECKING:
    from spl_batch.api.alone import AloneResult, run_alone
    from spl_batch.api.comparison import ComparisonResult, compare
    from spl_batch.api.conclusion import RunResult
    from spl_batch.api.first_survey import quickstart
    from spl_batch.api.pipeline import run
    from spl_batch.api.planning import Left, PlanSummary, plan
    from spl_batch.api.reporting import report
    from spl_batch.api.simulation import simulate

__all__ = [
    "AloneResult",
    "ComparisonResult",
    "Follower",
    "Left",
    "PlanSummary",
    "RunResult",
    "RunStatus",
    "StageStatus",
    "compare",
    "plan",
    "quickstart",
    "report",
    "run",
    "run_alone",
    "simulate",
    "status",
]

_HOMES = {
    "AloneResult": "alone",
    "run_alone": "alone",
    "ComparisonResult": "comparison",
    "compare": "comparison",
    "RunResult": "conclusion",
    "run": "pipeline",
    "Left": "planning",
    "PlanSummary": "planning",
    "plan": "planning",
    "report": "reporting",
    "quickstart": "first_survey",
    "simulate": "simulation",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"spl_batch.api.{_HOMES[name]}"), name)
