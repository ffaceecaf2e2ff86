"""Comparison of several methods as JSON and as a page.

``comparison.html.j2`` has what every page of a comparison has; a receiver's template extends it by
the block ``sections``.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from spl_batch.engine.report.page import environment, named_tables
from spl_batch.engine.report.parts import Count, Part
from spl_batch.engine.report.picture import Picture
from spl_batch.formats.files.atomic import write_bytes


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

    Parameters
    ----------
    report : Compared
        What is told; it has ``methods``.
    template, package : str
        The receiver's page, and where it lies.
    """
    content = json.dumps(report.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
    page: Any = environment(package).get_template(template)
    text = named_tables(page.render(report=report, pictures=pictures))
    write_bytes(out / "compare.json", content.encode())
    write_bytes(out / "compare.html", text.encode())
