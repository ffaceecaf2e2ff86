"""Results as one JSON document on standard output, for programs; the rest goes to standard error.

A document has ``exit_status``. One that has ``error`` has nothing else.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:  # each command loads what it needs only
    from spl_batch.api import PlanSummary, RunResult, RunStatus


def print_document(content: Mapping[str, Any]) -> None:
    """Print a document; numbers that are not finite are null."""
    from spl_batch.engine.report.parts import finite_or_none  # noqa: PLC0415 - out of --help

    click.echo(json.dumps(finite_or_none(content), indent=2))


def print_error(text: str, exit_status: int) -> None:
    """Print the document of a command that could not do its work."""
    click.echo(json.dumps({"exit_status": exit_status, "error": text}, indent=2))


def of_plan(summary: "PlanSummary") -> dict[str, Any]:
    """What a run would do."""
    return {
        "exit_status": summary.exit_status,
        "files": summary.files,
        "cost": asdict(summary.cost) | {"time_s": summary.cost.time_s},
        "limit_bytes": summary.limit_bytes,
        "finished": summary.finished,
        "findings": [one.model_dump(mode="json") for one in summary.findings],
        "faults": summary.faults,
    }


def of_result(result: "RunResult") -> dict[str, Any]:
    """How a run ended: its numbers as the report has them, and where the files are."""
    found = {} if result.report is None else result.report.model_dump(mode="json")
    parts = ("counts", "accuracy", "performance", "findings", "failures")
    return {
        "exit_status": result.exit_status,
        "output": str(result.output),
        "results": {
            label: [str(path) for path in paths if path.exists()] for label, paths in result.results
        },
        **{name: found[name] for name in parts if name in found},
    }


def of_status(status: "RunStatus") -> dict[str, Any]:
    """State of a run."""
    names = ("total", "done", "failed", "left", "points", "points_per_s", "elapsed_s", "left_s")
    state = "working" if status.holder is not None else "stopped"
    return {
        "exit_status": 0,
        "state": "ended" if status.ended is not None else state,
        "ended": status.ended and {k: status.ended.get(k) for k in ("exit_status", "reason")},
        "holder": status.holder,
        "left_s": status.left_s,
        "peak_mb": status.peak_mb,
        "stages": {
            stage.stage: {name: getattr(stage, name) for name in names}
            for stage in status.stages.values()
        },
        "running": list(status.running.values()),
        "failures": [asdict(one) for one in (*status.unusable, *status.failures)],
    }
