"""One HTML page that opens anywhere, without a network: text, tables and pictures inside.

``page.html.j2`` has what every report has: title, verdicts, key numbers, failures, cost,
provenance. A receiver's template extends it by the blocks ``overview``, ``sections`` and
``method``. ``comparison.html.j2`` has what every comparison of methods has.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import getmembers, isfunction
from pathlib import Path
from typing import Any, Final

import yaml
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from pydantic import BaseModel, Field, ValidationError

from spl_batch import errors
from spl_batch.engine.report import number_format
from spl_batch.engine.report.parts import Count, Part
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.verdict import Verdict
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.receivers import HOMES, IMAGING, workflow_model

LONGEST_TABLE: Final = 200
"""More rows than this are in ``report.json`` only: a page is for reading."""

LONGEST_VALUE: Final = 160
"""Longest value that the table of changed parameters shows whole [characters]."""

HOME: Final = __package__
"""Package of the templates that all reports share."""


@dataclass(frozen=True, slots=True)
class Front:
    """Top of a page."""

    #: Name of what was processed; kind of instrument, above it.
    title: str
    kicker: str
    facts: tuple[str, ...]  #: What comes below the title.
    #: Anchor and name of each section that the receiver adds.
    sections: tuple[tuple[str, str], ...]
    verdicts: tuple[Verdict, ...]  #: Sentences on whether the result can be used.
    cards: tuple[tuple[str, str, str], ...]  #: Label, value and remark of each key number.


def render_page(
    template: str,
    report: Any,
    front: Front,
    *,
    package: str = HOME,
    **more: Any,
) -> str:
    """The page of a report: HTML without any other file; the same input gives the same text.

    Parameters
    ----------
    report : BaseModel
        A receiver's model with ``performance``, ``failures``, ``findings`` and ``provenance``.
    **more
        More for the template; ``pictures``, a mapping of str to
        :class:`~spl_batch.engine.report.picture.Picture`, is always among it.
    """
    made = environment(package).get_template(template)
    return made.render(
        report=report,
        front=front,
        changed=[*changed(report.provenance.parameters)],
        longest=LONGEST_TABLE,
        **more,
    )


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
    environment.filters.update(getmembers(number_format, isfunction))
    return environment


def _shown(value: Any) -> Any:
    """A text without anything that cannot be seen; names in files are written by others."""
    if type(value) is not str or value.isprintable():
        return value
    return "\n".join(map(errors.plain, value.split("\n")))


def changed(parameters: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Dotted key and value of what a workflow sets otherwise than the default does.

    ``parameters``: a whole workflow, defaults included, as ``provenance.parameters`` of a report.
    """
    kind = parameters.get("kind", IMAGING)
    try:
        workflow: BaseModel = workflow_model(kind if kind in HOMES else IMAGING)(**parameters)
    except ValidationError:  # of another version, whose keys are others
        return
    yield from _flat(workflow.model_dump(mode="json", exclude_defaults=True), "")


def _flat(given: Mapping[str, Any], before: str) -> Iterator[tuple[str, str]]:
    for name, value in given.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{before}{name}.")
        elif f"{before}{name}" != "kind":
            text = yaml.safe_dump(value, default_flow_style=True, width=10**6)
            shown = text.removesuffix("\n").removesuffix("\n...")
            cut = f"{shown[:LONGEST_VALUE]} ..." if len(shown) > LONGEST_VALUE else shown
            yield f"{before}{name}", cut


def report_json(report: BaseModel) -> str:
    """Text of ``report.json``: fields in the model's order, every number finite or null."""
    content = report.model_dump(mode="json")
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_both(out: Path, report: BaseModel, page: str, name: str = "report") -> None:
    """Write a report as JSON and as a page into a folder, each whole or not at all."""
    write_bytes(out / f"{name}.json", report_json(report).encode())
    write_bytes(out / f"{name}.html", page.encode())


class ComparedMethod(Part):
    """What one method made of the inputs."""

    name: str = Field(description="Method, as it was asked for.")
    folder: str = Field(description="Its results, relative to the comparison.")
    signal: Count = Field(description="Signal [count].")
    kept_only: Count = Field(description="Signal here, noise by the first method [count].")
    removed_only: Count = Field(description="Noise here, signal by the first method [count].")
    failures: Count = Field(0, description="Files and tasks that failed [count].")


class Compared(Part):
    """What a comparison writes down."""

    version: str = Field(description="Version of the code.")


def write_comparison(
    out: Path, report: Compared, template: str, package: str, pictures: Sequence[Picture]
) -> None:
    """Write ``compare.json`` and ``compare.html`` into a folder.

    ``report`` has ``methods``; ``template`` is the receiver's page, in its ``package``.
    """
    page: Any = environment(package).get_template(template)
    write_both(out, report, page.render(report=report, pictures=pictures), "compare")
