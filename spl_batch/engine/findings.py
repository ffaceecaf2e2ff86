"""Findings: what a run has to warn of, as values.

A finding has a code, numbers, a subject and a place. One table has for each code its sentences,
their consequence, the remedy and a title: screen, log, ``report.json``, the page of a report and
the documentation are made of it. Each receiver has a table of its own
(:data:`spl_batch.receivers.HOMES`); codes of the engine are in :data:`CODES`. Nothing reads a text
to decide anything.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

from spl_batch import receivers

Severity = Literal["note", "warning"]
"""A note is for whoever runs the work; it is in no report."""

Box = Sequence[float]
"""West, south, east and north [m]."""

PAGE: Final = "docs/troubleshooting.md"
"""Page of the documentation with every code."""


class Finding(NamedTuple):
    """Something to warn of; in a receipt's facts it is a list of the same fields.

    Parameters
    ----------
    code : str
        Key of the table.
    values : mapping of str to object
        What the sentence names; ``kind`` chooses among the sentences of a code.
    subject : str
        What it concerns: a file, a flightline, a ground cell; empty for all of a survey.
    place : Box or None
        Where it is [m].
    badness : float or None
        Orders findings that are alike, the highest first.
    """

    code: str
    values: Mapping[str, Any] = {}  # plain, as findings are kept as JSON
    subject: str = ""
    place: Box | None = None
    badness: float | None = None


@dataclass(frozen=True, slots=True)
class Code:
    """What a code means."""

    title: str
    #: By ``kind``, in which ``{name}`` is a value: ``{count:points|have}`` counts, others are
    #: formatted as by :func:`format`, and ``{low_m:length}`` and ``{error_m:height}`` are metres in
    #: the unit of delivery, or pairs of such and words (:mod:`spl_batch.engine.report.reported`).
    sentences: Mapping[str, str] | str
    consequence: str = ""
    remedy: str = ""
    noun: str = ""  #: What a subject is called; one ``file`` needs no such word before its name.
    severity: Severity = "warning"
    #: By ``kind``, empty for all: codes, or ``code:kind``, that explain it. Where one of them is
    #: found of the same subject, or of all, this one is left out.
    implied_by: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def sentence(self, kind: str = "") -> str:
        """Template of a kind."""
        return self.sentences if isinstance(self.sentences, str) else self.sentences[kind]

    def causes(self, kind: str = "") -> tuple[str, ...]:
        """What explains a finding of a kind."""
        return (*self.implied_by.get("", ()), *self.implied_by.get(kind, ()))


CODES: Final[Mapping[str, Code]] = MappingProxyType(
    {
        "E01": Code(
            "Room, memory and inputs",
            {
                "disk": "output: a run takes about {needed}, its disk has {free} left",
                "gone": "no longer an input of this survey: {files}; what earlier runs delivered "
                "of them is deleted when this run has delivered",
                "memory": "{what}",
            },
            severity="note",
        ),
        "E02": Code(
            "Results of an earlier run are kept",
            "of an earlier run, kept as tasks of this one failed: {files}",
            remedy="mend what failed and run again, or delete what is of no use",
        ),
        "F01": Code(
            "An input cannot be used",
            "{reason}",
            "the rest is done without it",
            "copy it again, mend or remove it, then run again: only what failed is tried",
        ),
        "F02": Code(
            "A worker had too little memory",
            "{reason}",
            "what reads its result is left out",
            "raise --memory, and run again: only what failed is tried",
        ),
        "F03": Code(
            "A file of the working store is damaged",
            "{reason}",
            "it is made again, unless what makes it fails too",
            "run again: only what failed is tried",
        ),
        "F04": Code(
            "A task failed",
            "{reason}",
            "what reads its result is left out",
            "run again: only what failed is tried; a fault that stays is ours, report it with "
            "log.jsonl",
        ),
    }
)
"""Codes of the engine; those with an F are of failures."""


@cache
def table() -> Mapping[str, Code]:
    """Every code, those of all receivers included."""
    found = dict(CODES)
    for codes in receivers.findings():
        twice = found.keys() & codes.keys()
        if twice:
            raise ValueError(f"codes with two meanings: {', '.join(sorted(twice))}")
        found.update(codes)
    return MappingProxyType(found)


def of_receipts(receipts: Mapping[str, Any]) -> Iterator[Finding]:
    """Findings of tasks: without a subject they are of what the task worked on.

    ``receipts``: by name; their facts have ``findings``, and may have a ``name``.
    """
    for name, receipt in receipts.items():
        for fields in receipt.facts.get("findings", ()):
            one = Finding(*fields)
            yield one if one.subject else one._replace(subject=str(receipt.facts.get("name", name)))


def settled(
    findings: Iterable[Finding], ignored: Collection[str] = (), known: Collection[Finding] = ()
) -> list[Finding]:
    """Findings that are worth a warning: none that is ignored, known, or explained by another.

    ``ignored``: codes of ``report.ignore``; ``known``: what was reported before, which explains
    others, too.
    """
    new = [one for one in findings if one.code not in ignored]
    causes: dict[str, set[str]] = {}
    for one in (*known, *new):
        for cause in (one.code, f"{one.code}:{one.values.get('kind')}"):
            causes.setdefault(cause, set()).add(one.subject)
    alike: dict[tuple[str, str], list[Finding]] = {}  # values cannot be hashed
    for one in known:
        alike.setdefault((one.code, one.subject), []).append(one)
    kept: list[Finding] = []
    for one in new:
        explained = any(
            one.subject in causes.get(code, ()) or "" in causes.get(code, ())
            for code in table()[one.code].causes(one.values.get("kind", ""))
        )
        seen = alike.setdefault((one.code, one.subject), [])
        if not explained and one not in seen:
            seen.append(one)
            kept.append(one)
    return kept
