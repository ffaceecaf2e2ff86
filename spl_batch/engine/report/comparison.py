"""Comparison of several methods as JSON and as a page.

``comparison.html.j2`` has what every page of a comparison has; a receiver's template extends it by
the block ``sections``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from spl_batch.engine.report.page import environment, write_both
from spl_batch.engine.report.parts import Count, Part
from spl_batch.engine.report.picture import Picture


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
