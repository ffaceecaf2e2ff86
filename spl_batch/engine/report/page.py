"""One HTML page that opens anywhere, without a network: text, tables and pictures inside.

``page.html.j2`` has what every report has: title, verdicts, key numbers, failures, cost,
provenance. A receiver's template extends it by the blocks ``overview``, ``sections`` and
``method``.
"""

import datetime as dt
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Protocol

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from spl_batch import errors
from spl_batch.engine.report import number_format as text
from spl_batch.engine.report.parameters import changed, without
from spl_batch.engine.report.parts import (
    Failure,
    FindingReport,
    Performance,
    Provenance,
    StagePerformance,
)
from spl_batch.engine.report.verdict import Verdict

LONGEST_TABLE: Final = 200
"""More rows than this are in ``report.json`` only: a page is for reading."""

HOME: Final = __package__
"""Package of the templates that all reports share."""

_SCROLL: Final = '<div class="scroll" tabindex="0"><table'
_HEADING: Final = re.compile(r"<(h[1-4])\b[^>]*>(.*?)</\1>", re.DOTALL)
_TAG: Final = re.compile(r"<[^>]*>")


class AnyReport(Protocol):
    """What every receiver's report has."""

    @property
    def performance(self) -> Performance:
        """Cost of the run."""

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Everything that did not make it."""

    @property
    def findings(self) -> tuple[FindingReport, ...]:
        """What a reader has to know."""

    @property
    def provenance(self) -> Provenance:
        """Enough to do it again."""


@dataclass(frozen=True, slots=True)
class Front:
    """What stands at the top of a page."""

    #: Name of what was processed; kind of instrument, above it.
    title: str
    kicker: str
    facts: tuple[str, ...]  #: What stands below the title.
    #: Anchor and name of each section that the receiver adds.
    sections: tuple[tuple[str, str], ...]
    verdicts: tuple[Verdict, ...]  #: Sentences that say whether the result can be used.
    cards: tuple[tuple[str, str, str], ...]  #: Label, value and remark of each key number.
    #: Keys of the workflow that this receiver's data made no use of: the page leaves them out.
    unused: tuple[str, ...] = ()


def render_page(
    template: str,
    report: AnyReport,
    front: Front,
    *,
    package: str = HOME,
    script_hash: str = "",
    **more: Any,
) -> str:
    """The page of a report.

    Parameters
    ----------
    script_hash : str
        Names the one script that the page may run, as a content security policy does; none may
        where it is empty.
    **more
        More for the template; ``pictures``, a mapping of str to
        :class:`~spl_batch.engine.report.picture.Picture`, is always among it.

    Returns
    -------
    str
        HTML without any reference to another file; the same input gives the same text.
    """
    used = without(report.provenance.parameters, front.unused)
    page = (
        environment(package)
        .get_template(template)
        .render(
            report=report,
            title=front.title,
            kicker=front.kicker,
            facts=front.facts,
            sections=front.sections,
            verdicts=front.verdicts,
            cards=front.cards,
            stages=_stages(report.performance.stages),
            written=_written(report.provenance.created),
            changed=[
                one
                for one in changed(report.provenance.parameters)
                if not _is_below(one[0], front.unused)
            ],
            parameters=_compact(used),
            left_out=bool(front.unused),
            longest=LONGEST_TABLE,
            script_hash=script_hash,
            **more,
        )
    )
    return named_tables(page)


@cache
def environment(package: str = HOME) -> Environment:
    """Templates of a package and those that all share, with the numbers' formats as filters."""
    packages = dict.fromkeys((package, HOME))
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, ".") for name in packages]),
        autoescape=True,
        finalize=_shown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        {
            name: getattr(text, name)
            for name in (
                "number",
                "plain",
                "significant",
                "expected_count",
                "alike",
                "typeset",
                "percent",
                "share",
                "large",
                "duration",
                "size",
                "centimetres",
                "metres",
                "millimetres",
                "scaled",
                "of_all",
                "surface_name",
            )
        }
    )
    return environment


def _shown(value: Any) -> Any:
    """A text without anything that cannot be seen; names in files are written by others."""
    if type(value) is not str or value.isprintable():
        return value
    return "\n".join(map(errors.plain, value.split("\n")))


def _is_below(key: str, above: tuple[str, ...]) -> bool:
    return any(key == one or key.startswith(f"{one}.") for one in above)


def _compact(parameters: Mapping[str, Any]) -> str:
    """JSON with a line for each section: an appendix of a few hundred numbers stays short."""
    lines = (
        f" {json.dumps(key, ensure_ascii=False)}: {json.dumps(value, ensure_ascii=False)}"
        for key, value in parameters.items()
    )
    return "{\n" + ",\n".join(lines) + "\n}"


def _stages(stages: Mapping[str, StagePerformance]) -> list[dict[str, Any]]:
    """Rows of the table of stages, with the lengths of their bars in percent."""
    most_time = max((s.wall_s or 0.0 for s in stages.values()), default=0.0) or 1.0
    most_memory = max((s.peak_rss_mb or 0.0 for s in stages.values()), default=0.0) or 1.0
    return [
        {
            "name": name,
            "cost": stage,
            "time_bar": f"{100 * (stage.wall_s or 0.0) / most_time:.1f}",
            "memory_bar": f"{100 * (stage.peak_rss_mb or 0.0) / most_memory:.1f}",
        }
        for name, stage in stages.items()
    ]


def _written(created: str) -> str:
    """Time stamp as people read it; unchanged where it is no ISO time."""
    try:
        moment = dt.datetime.fromisoformat(created)
    except ValueError:
        return created
    zone = moment.tzname() or ""
    return f"{moment.day} {moment:%B %Y, %H:%M} {zone}".strip()


def named_tables(page: str) -> str:
    """A page whose tables are called as the headings that they follow.

    Parameters
    ----------
    page : str
        HTML; each table is the first thing in a ``div`` of the class ``scroll``.
    """
    before, *tables = page.split(_SCROLL)
    parts, called, times = [before], "Table", 0
    for part in tables:
        headings = _HEADING.findall(before)
        if headings:
            called, times = " ".join(_TAG.sub("", headings[-1][1]).split()), 0
        times += 1
        name = (f"{called}, table {times}" if times > 1 else called).replace('"', "&quot;")
        region = f'<div class="scroll" tabindex="0" role="region" aria-label="{name}, scrolls">'
        parts += [f'{region}<table aria-label="{name}"', part]
        before = part
    return "".join(parts)
