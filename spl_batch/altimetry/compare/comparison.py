"""Several methods on the same photon profiles, and how they differ.

Each method gets a folder of its own, ``OUTPUT/compare/METHOD``, with everything that a run gives.
Beams are read once, in the store of ``OUTPUT`` itself, and linked into theirs. Receipts decide what
is left to do, so a comparison that was stopped goes on where it was.
"""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, get_args

from spl_batch.altimetry.compare.comparison_page import (
    TrackComparison,
    TrackMethod,
    write_comparison,
)
from spl_batch.altimetry.compare.contrast import contrast
from spl_batch.altimetry.filter.peer_filters import PEERS, require
from spl_batch.altimetry.report.model import METHOD_NAMES, TrackReport
from spl_batch.altimetry.report.summarise import agreement
from spl_batch.altimetry.settings import Method, TrackWorkflow
from spl_batch.altimetry.tasks.kinds import KINDS
from spl_batch.engine.report.number_format import as_ascii, metres, number, percent, significant
from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.engine.store.links import share_finished
from spl_batch.engine.store.output_lock import locked
from spl_batch.engine.store.output_owner import usable
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.verbs.comparing import ComparisonResult
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.reporting import recalled
from spl_batch.engine.verbs.running import run
from spl_batch.engine.watch.earlier_runs import share_time
from spl_batch.engine.watch.events import Listener, Note, ignore
from spl_batch.errors import WorkflowError

FOLDER: Final = "compare"
"""Where the methods' results lie, below the output folder."""

METHODS: Final[tuple[str, ...]] = get_args(Method)

TITLES: Final = ("method", "signal", "of all", "F1", "ground RMSE", "s per million")
"""Columns that the console shows."""


def compare(
    workflow: Path | str,
    methods: str | Sequence[str],
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> ComparisonResult:
    """Run several methods on photons; see :func:`spl_batch.engine.verbs.comparing.compare`."""
    chosen = parse_methods(methods)
    path = Path(workflow)
    settings = load_any(path, overrides)
    if not isinstance(settings, TrackWorkflow):
        raise WorkflowError(f"{path}: kind: {settings.kind}; no photon profiles")
    for method in chosen:
        if method in PEERS:
            require(method)
    output = (path.resolve().parent / settings.output).resolve()
    usable(prepare(path, overrides, memory=memory, workers=workers))  # before the lock's file
    process = partial(run, path, workers=workers, memory=memory, listener=listener)
    with locked(output / FOLDER):
        status = process(until="index", overrides=overrides).exit_status
        reports: dict[str, TrackReport] = {}
        for count, method in enumerate(chosen, start=1):
            listener(Note("info", f"{method}, {count} of {len(chosen)}"))
            folder = output / FOLDER / method
            _share(output, folder, settings)
            result = process(overrides=[*overrides, *_overrides(folder, settings, method)])
            status = max(status, result.exit_status)
            if result.report is not None:
                reports[method] = result.report
        report = _write(output, settings.track.name, reports)
    return ComparisonResult(status, output, report, TITLES, tuple(map(_row, report.methods)))


def parse_methods(methods: str | Sequence[str]) -> list[str]:
    """Methods of a list such as ``"bayes,dbscan"``, each once, in the order given.

    Raises
    ------
    WorkflowError
        If a name is not known, or fewer than two are given.
    """
    listed = methods.split(",") if isinstance(methods, str) else methods
    chosen = list(dict.fromkeys(name.strip() for name in listed if name.strip()))
    known = ", ".join(METHODS)
    for name in chosen:
        if name not in METHODS:
            raise WorkflowError(f"--methods: no method {name!r}; there are {known}")
    if len(chosen) < 2:
        raise WorkflowError(f"--methods: name two or more of {known}, separated by commas")
    return chosen


def _store(output: Path, folder: Path, url: str | None) -> Store:
    """Working store of a method: each has one of its own."""
    return Store(folder, f"{url.rstrip('/')}/{folder.relative_to(output)}" if url else None)


def _overrides(folder: Path, settings: TrackWorkflow, method: str) -> list[str]:
    """Keys of the workflow that make a run one of this method, and of no other beside it."""
    keys = [f"output={json.dumps(str(folder))}", f"signal.method={method}"]
    if settings.reference is not None:
        keys.append("reference.baseline=false")
    url = settings.outputs.store
    if url:
        output = folder.parents[1]
        keys.append(f"outputs.store={json.dumps(_store(output, folder, url).url)}")
    return keys


def _share(output: Path, folder: Path, settings: TrackWorkflow) -> None:
    """Link the beams that are read."""
    url = settings.outputs.store
    kinds = [name for name, kind in KINDS.items() if kind.stage == "index"]
    share_finished(Store(output, url), _store(output, folder, url), kinds)
    share_time(output, folder, {"index"})


def _write(output: Path, name: str, reports: Mapping[str, TrackReport]) -> TrackComparison:
    """Gather the table and the picture, and write them."""
    if not reports:
        raise WorkflowError(f"{output}: no method has finished; nothing can be compared")
    found = contrast({method: output / FOLDER / method for method in reports})
    done = {method: recalled(output / FOLDER / method)[0] for method in reports}
    results = tuple(
        _result(method, report, done[method], found.kept_only[method], found.removed_only[method])
        for method, report in reports.items()
    )
    version = next(iter(reports.values())).provenance.version
    report = TrackComparison(name=name, version=version, methods=results)
    write_comparison(output, report, found.disputed)
    return report


def _result(
    method: str,
    report: TrackReport,
    done: Mapping[str, Any],
    kept_only: int,
    removed_only: int,
) -> TrackMethod:
    labels = [
        receipt.facts["labels"]["ours"]
        for receipt in done.get("compare", {}).values()
        if receipt.facts.get("labels")
    ]
    sums = {key: sum(one[key] for one in labels) for key in labels[0]} if labels else None
    cost = report.performance.stages.get("signal")
    photons = report.counts.points_in
    told = [b.false_signal for b in report.beams if b.false_signal is not None]
    return TrackMethod(
        name=method,
        title=METHOD_NAMES[method],
        folder=f"{FOLDER}/{method}",
        photons=photons,
        signal=report.counts.signal,
        false_signal=sum(told) if told else None,
        kept_only=kept_only,
        removed_only=removed_only,
        labels=agreement(**sums) if sums else None,
        ground=report.ground,
        signal_s_per_million=1e6 * cost.wall_s / photons
        if cost and cost.wall_s and photons
        else None,
        failures=len(report.failures),
    )


def _row(method: TrackMethod) -> tuple[str, ...]:
    values = (
        number(method.signal),
        percent(method.signal / method.photons if method.photons else None),
        number(method.labels.f1, 3) if method.labels else "-",
        metres(method.ground.rmse) if method.ground else "-",
        significant(method.signal_s_per_million),
    )
    return (method.name, *map(as_ascii, values))
