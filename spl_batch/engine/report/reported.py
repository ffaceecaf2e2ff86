"""Findings as a report has them: alike ones as one, in words."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from string import Formatter
from typing import Any, Final

from spl_batch.engine.findings import Box, Finding, settled, table
from spl_batch.engine.report.number_format import as_ascii, height
from spl_batch.engine.report.parts import FindingReport
from spl_batch.errors import counted, grouped, named
from spl_batch.formats.units import METRES, Units, both


def reported(
    findings: Iterable[Finding],
    ignored: Collection[str] = (),
    *,
    notes: bool = False,
    units: Units = METRES,
) -> tuple[FindingReport, ...]:
    """Findings of a report, alike ones as one.

    Those of the same code, kind, key of the workflow and wording are alike; values, place and
    sentence are those of the worst.

    Parameters
    ----------
    ignored : collection of str
        Codes that are left out (``report.ignore``).
    notes : bool
        Whether notes for the operator are wanted, too.
    units : Units
        What sentences give coordinates and heights in.
    """
    alike: dict[tuple[object, ...], list[Finding]] = {}
    for one in settled(findings, ignored):
        if notes or table()[one.code].severity != "note":
            key = one.code, *map(one.values.get, ("kind", "key", "what"))
            alike.setdefault(key, []).append(one)
    return tuple(_as_one(some, units) for some in alike.values())


def texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Lines for a screen or a log, notes included."""
    return tuple(one.text for one in reported(findings, notes=True))


def _as_one(alike: list[Finding], units: Units) -> FindingReport:
    worst = max(alike, key=lambda one: one.badness or 0.0)
    ordered = sorted(alike, key=lambda one: -(one.badness or 0.0))
    subjects = tuple(dict.fromkeys(one.subject for one in ordered if one.subject))
    code = table()[worst.code]
    template, words = code.sentence(worst.values.get("kind", "")), _Words(units.of_heights)
    sentence, consequence, remedy = (
        words.vformat(text, (), worst.values) for text in (template, code.consequence, code.remedy)
    )
    if worst.place is not None:
        sentence = f"{sentence}, {_within(worst.place, units)}"
    return FindingReport(
        code=worst.code,
        severity=code.severity,
        title=code.title,
        subject=_subject(subjects, code.noun, graded=worst.badness is not None),
        subjects=subjects,
        place=worst.place,
        values=dict(worst.values),
        sentence=sentence,
        consequence=consequence,
        remedy=remedy,
    )


def _subject(subjects: Sequence[str], noun: str, *, graded: bool) -> str:
    """What findings concern, in words; a file's name shows that it is one."""
    if len(subjects) < 2:
        before = "" if noun in {"", "file"} else f"{noun} "
        return f"{before}{subjects[0]}" if subjects else ""
    names = named(subjects, 3)
    listed = f"{len(subjects)} {noun}s ({names})" if noun else names
    return f"{listed}, at worst {subjects[0]}" if graded else listed


def _within(place: Box, units: Units) -> str:
    name, unit_m = units.of_coordinates
    west, south, east, north = (grouped(round(side / unit_m)) for side in place)
    return f"within x {west} to {east} and y {south} to {north} {name}"


_OF_HEIGHTS: Final[Mapping[str, Callable[[float, tuple[str, float]], str]]] = {
    "length": partial(both, digits=None),
    "height": height,
}
"""Specifications of values in metres, and how they are written in the unit of delivery."""


class _Words(Formatter):
    """Numbers as every message has them; ``of_heights``: unit of delivery, and metres in it."""

    def __init__(self, of_heights: tuple[str, float]) -> None:
        self._of_heights = of_heights

    def format_field(self, value: Any, format_spec: str) -> str:
        """A value in words; a specification of letters counts what it names."""
        if format_spec in _OF_HEIGHTS and isinstance(value, list):
            return " and ".join(
                f"{self.format_field(metres, format_spec)} {what}" for metres, what in value
            )
        if format_spec in _OF_HEIGHTS:
            return as_ascii(_OF_HEIGHTS[format_spec](value, self._of_heights))
        if isinstance(value, list | tuple):
            return named(value)
        if isinstance(value, int) and not isinstance(value, bool):
            noun, _, verb = format_spec.partition("|")
            if len(noun) > 1 and noun.replace(" ", "").isalpha():
                return counted(value, noun, verb)
            return format(value, format_spec) if format_spec else grouped(value)
        return format(value, format_spec)
