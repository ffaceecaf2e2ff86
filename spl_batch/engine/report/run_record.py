"""Record of a run beside its receipts, and the parts that every receiver's report has."""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import pydantic

from spl_batch import __version__
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.parts import (
    Failure,
    InputFile,
    Performance,
    Provenance,
    StagePerformance,
)
from spl_batch.engine.report.reported import reported
from spl_batch.engine.store.working_store import Store, read_json, write_json
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.runner import LIBRARIES, build_version, library_version
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import StoreError
from spl_batch.formats.files.atomic import checksum
from spl_batch.imports import content_hash, imported, module_file
from spl_batch.receivers import HOMES

REPORT_FILES: Final = ("report.json", "report.html")
"""Files of a report, below the output."""

RUN: Final = "run.json"
"""File of the store that a report is written from."""

_CONTENT: Final = "content"

Receipts = Mapping[str, Mapping[str, Receipt]]
"""Finished tasks by kind and name."""


@dataclass
class StageCost:
    """What one stage has cost, what earlier runs have finished of it included."""

    wall_s: float = 0.0
    tasks: int = 0
    skipped: int = 0
    failed: int = 0
    points: dict[str, int] = field(default_factory=dict)  #: By kind of task [count].
    peak_rss_mb: float = 0.0

    def add(self, receipt: Receipt) -> None:
        """Count a task that was done."""
        self.tasks += 1
        self.failed += receipt.failed
        self._count(receipt)

    def skip(self, receipt: Receipt) -> None:
        """Count a task of an earlier run, with its cost then."""
        self.skipped += 1
        self._count(receipt)

    def _count(self, receipt: Receipt) -> None:
        self.wall_s += receipt.wall_s
        self.points[receipt.kind] = self.points.get(receipt.kind, 0) + receipt.points
        self.peak_rss_mb = max(self.peak_rss_mb, receipt.peak_rss_mb)


@pydantic.dataclasses.dataclass(frozen=True)
class RunFacts:
    """What the receipts do not have."""

    wall_s: float  #: Duration of the run so far [s].
    workers: int
    costs: dict[str, StageCost] = field(default_factory=dict)
    failures: tuple[Failure, ...] = ()  #: What did not make it.
    findings: tuple[Finding, ...] = ()  #: What the run has warned of.
    reference: tuple[str, ...] = ()
    not_read: int = 0  #: Points that unreadable files promise [count].
    #: Time that tasks waited for kernels [s]; None where nothing was left to compile, or tasks did
    #: it.
    compile_s: float | None = None


FACTS: Final = pydantic.TypeAdapter(RunFacts)
"""Turns them into plain JSON values and back."""


def remember(done: Receipts, context: RunContext[Any], facts: RunFacts) -> None:
    """Keep what a later ``report`` needs."""
    content = {
        "workflow": context.workflow.model_dump(mode="json"),
        "base": str(context.base),
        "crs_wkt": context.crs_wkt,
        "code": context.code,
        "facts": FACTS.dump_python(facts, mode="json"),
        "done": {kind: list(names) for kind, names in done.items()},
    }
    # As a text: the order of stages and kinds counts.
    write_json(context.store.local / RUN, {_CONTENT: json.dumps(content)})


@cache
def report_code(receiver: str) -> str:
    """Hash of the code that makes a receiver's plan and report, which decides no result."""
    entries = (HOMES[receiver].receiver, HOMES[receiver].summarise)
    files = (module_file(entry.partition(":")[0]) for entry in entries)
    modules = frozenset[Path]().union(*(imported(file) for file in files if file is not None))
    pages = {page for folder in {file.parent for file in modules} for page in folder.glob("*.j2")}
    return f"{content_hash({*modules, *pages})} matplotlib {version('matplotlib')}"


def recall(output: Path) -> dict[str, Any]:
    """What :func:`remember` kept.

    Raises
    ------
    StoreError
        If no run has finished there.
    DamagedError
        If it is not what was written.
    """
    path = Store(output).local / RUN
    if not path.exists():
        raise StoreError(f"{output}: no finished run here; `spl-batch run` comes first")
    content: dict[str, Any] = json.loads(read_json(path)[_CONTENT])
    return content


def common_parts(
    context: RunContext[Any], facts: RunFacts, points: int, inputs: Sequence[InputFile]
) -> dict[str, Any]:
    """What a receiver's report has of the run as such, by the name of its part.

    ``points``: points, photons, detections or frames of all inputs [count].
    """
    return {
        "performance": performance(facts, points),
        "failures": facts.failures,
        "findings": reported(
            facts.findings, context.workflow.report.ignore, units=context.shown_units
        ),
        "provenance": provenance(context, inputs),
    }


def performance(facts: RunFacts, points: int) -> Performance:
    """Cost of a run, for its report."""
    whole = facts.wall_s > 0 and not any(cost.skipped for cost in facts.costs.values())
    return Performance(
        wall_s=facts.wall_s,
        compile_s=facts.compile_s,
        points_per_s=points / max(facts.wall_s - (facts.compile_s or 0.0), 0.001)
        if whole
        else None,
        peak_rss_mb=max((c.peak_rss_mb for c in facts.costs.values()), default=None),
        workers=facts.workers,
        stages={
            # Of a stage's kinds of task each handles the points once more.
            stage: StagePerformance(
                points_per_s=points / cost.wall_s if cost.wall_s > 0 else None,
                **{name: value for name, value in asdict(cost).items() if name != "points"},
            )
            for stage, cost in facts.costs.items()
        },
    )


def provenance(context: RunContext[Any], inputs: Sequence[InputFile]) -> Provenance:
    """Enough to do a run again, for its report."""
    return Provenance(
        version=build_version(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        python=platform.python_version(),
        platform=f"{platform.system()} {platform.machine()}",
        libraries={"spl-batch": __version__, **{n: library_version(n) for n in LIBRARIES}},
        parameters=context.workflow.model_dump(mode="json"),
        inputs=tuple(inputs),
    )


def input_file(path: Path, role: str, digest: str | None = None) -> InputFile:
    """Identity of an input file, for the report.

    ``digest``: its checksum, where a task has taken it already.
    """
    found = digest if digest is not None else checksum(path)
    return InputFile(path=path.name, role=role, size=path.stat().st_size, hash=f"blake2b:{found}")


def indexed_file(facts: Mapping[str, Any], role: str, points: int | None = None) -> InputFile:
    """Identity of an input file as it was read, which may be gone by now.

    ``facts``: of the task that read it, with ``name``, ``size`` [byte] and ``hash``; ``points``:
    points, detections or frames in it [count].
    """
    digest = f"blake2b:{facts['hash']}"
    return InputFile(path=facts["name"], role=role, size=facts["size"], hash=digest, points=points)
