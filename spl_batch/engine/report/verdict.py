"""Sentences and rows that every receiver's page and console show: verdicts, time, failures."""

from collections.abc import Iterable, Sequence
from typing import Any, Final, Literal, NamedTuple

from spl_batch.engine.report.number_format import as_ascii, duration, large, number
from spl_batch.engine.report.parts import Failure, FindingReport, Performance

Tone = Literal["good", "attention", "bad", "neutral"]


FAILURES_NAMED: Final = 3
"""Failures that the console names at the end; the report has all [count]."""


class Verdict(NamedTuple):
    """One sentence at the top of the report."""

    tone: Tone
    text: str


def ending_rows(
    work: Performance,
    failures: Sequence[Failure],
    findings: Sequence[FindingReport],
    noun: str = "points",
) -> list[tuple[str, str]]:
    """Label and value of what the console shows last, whatever the receiver."""
    rows = [("run time", f"{duration(work.wall_s)} ({speed_remark(work, noun)})")]
    if work.peak_rss_mb is not None:
        rows.append(("peak memory", f"{number(work.peak_rss_mb)} MiB per worker"))
    rows.append(("failures", number(len(failures)) if failures else "none"))
    rows += [("failed", _failed(failure)) for failure in failures[:FAILURES_NAMED]]
    if more := failures[FAILURES_NAMED:]:
        rows.append(("", f"and {number(len(more))} more, see the report"))
    if findings:
        rows.append(("warnings", number(len(findings))))
    return [(label, as_ascii(value)) for label, value in rows]


def card_rows(cards: Iterable[tuple[str, str, str]], report: Any) -> list[tuple[str, str]]:
    """Label and value of what the console shows of a page's cards, and last of its ``report``."""
    rows = [(label.lower(), f"{value} ({remark})") for label, value, remark in cards]
    plain = [(label, as_ascii(value.replace("°", " deg"))) for label, value in rows]
    return plain + ending_rows(report.performance, report.failures, report.findings)


def _failed(failure: Failure) -> str:
    """What has failed, why, and what helps."""
    named = failure.place in failure.reason
    what = failure.reason if named else f"{failure.task or failure.place}: {failure.reason}"
    helps = failure.remedy
    return f"{what}; {helps}" if helps and helps not in what else what


def speed_remark(work: Performance, noun: str = "points") -> str:
    """Speed of a run, unless it went on with earlier runs' work; time of compiling."""
    compiling = f", {duration(work.compile_s)} of it compiling, once" if work.compile_s else ""
    if work.part_alone:
        return f"this part alone; the rest was finished before{compiling}"
    apart = " apart from compiling" if work.compile_s else ""
    return f"{large(work.points_per_s)} {noun}/s{apart}{compiling}"


def failure_verdict(failures: Sequence[Failure], findings: Sequence[FindingReport]) -> Verdict:
    """Sentence that names what has failed."""
    failed, warned = len(failures), len(findings)
    remarks = f"{number(warned)} warning{'s' * (warned != 1)}" if warned else "no warnings"
    if failed:
        return Verdict(
            "bad",
            f"{number(failed)} failure{'s' * (failed != 1)}, {remarks}: the rest is finished; "
            "the same command tries only what failed.",
        )
    return Verdict("attention" if warned else "good", f"No failures, {remarks}.")
