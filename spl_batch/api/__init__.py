"""The verbs of the project, usable from a notebook; the command line only calls these."""

from spl_batch.api.alone import AloneResult, run_alone
from spl_batch.api.comparison import ComparisonResult, compare
from spl_batch.api.pipeline import RunResult, run
from spl_batch.api.planning import PlanSummary, plan
from spl_batch.api.reporting import report
from spl_batch.api.simulation import quickstart, simulate
from spl_batch.api.status import Follower, RunStatus, StageStatus, status

__all__ = [
    "AloneResult",
    "ComparisonResult",
    "Follower",
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
