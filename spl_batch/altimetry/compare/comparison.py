"""Several methods on the same photon profiles; ``engine.verbs.comparing`` runs them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, get_args

from spl_batch.altimetry.compare.comparison_page import TrackComparison, TrackMethod, write
from spl_batch.altimetry.compare.contrast import contrast
from spl_batch.altimetry.report.model import METHOD_NAMES, TrackReport
from spl_batch.altimetry.report.summarise import agreement
from spl_batch.altimetry.settings import Method, TrackWorkflow
from spl_batch.engine.report.number_format import as_ascii, metres, number, percent, significant
from spl_batch.engine.verbs.comparing import Methods, folder_of, per_million
from spl_batch.engine.verbs.reporting import recalled


def _keys(method: str, settings: TrackWorkflow) -> list[str] | None:
    """Keys of the workflow that make a run one of this method, and of no other beside it."""
    if method not in get_args(Method):
        return None
    keys = [f"signal.method={method}"]
    return keys if settings.reference is None else [*keys, "reference.baseline=false"]


def _write(output: Path, reports: Mapping[str, TrackReport]) -> TrackComparison:
    """Gather the table and the picture, and write them."""
    folders = {method: output / folder_of(method) for method in reports}
    found = contrast(folders)
    done = {method: recalled(folder)[0] for method, folder in folders.items()}
    results = tuple(
        _result(method, report, done[method], found.kept_only[method], found.removed_only[method])
        for method, report in reports.items()
    )
    first = next(iter(reports.values()))
    report = TrackComparison(name=first.name, version=first.provenance.version, methods=results)
    write(output, report, found.disputed)
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
    photons = report.counts.points_in
    told = [b.false_signal for b in report.beams if b.false_signal is not None]
    return TrackMethod(
        name=method,
        title=METHOD_NAMES[method],
        folder=folder_of(method),
        photons=photons,
        signal=report.counts.signal,
        false_signal=sum(told) if told else None,
        kept_only=kept_only,
        removed_only=removed_only,
        labels=agreement(**sums) if sums else None,
        ground=report.ground,
        signal_s_per_million=per_million(report.performance, "signal", photons),
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


METHODS: Final = Methods(
    known=", ".join(get_args(Method)),
    keys=_keys,
    until=lambda _: "index",
    share=lambda *_: {"index"},
    write=_write,
    row=_row,
    titles=("method", "signal", "of all", "F1", "ground RMSE", "s per million"),
)
"""What can be compared: beams are read once."""
