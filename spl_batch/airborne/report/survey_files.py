"""Report of an airborne survey on disk: JSON and page."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from spl_batch.airborne.report.model import Report

if TYPE_CHECKING:  # matplotlib is loaded only where one draws
    from spl_batch.airborne.report.clip_view import Clip
    from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.page import write_both


def write_report(
    out: Path, report: Report, pictures: Mapping[str, "Picture"], clip: "Clip | None" = None
) -> None:
    """Write both files of the report into a folder.

    Parameters
    ----------
    out : Path
        Folder; made where it is missing.
    report : Report
        What is said.
    pictures : mapping of str to Picture
        What is shown; any may be missing.
    clip : Clip, optional
        Points that a reader can turn.

    Raises
    ------
    StoppedError
        If the disk is full; an earlier report is then left as it was.
    WorkflowError
        If the folder cannot be written.
    """
    from spl_batch.airborne.report.survey_page import render  # noqa: PLC0415

    write_both(out, report, render(report, pictures, clip))
