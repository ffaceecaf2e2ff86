"""Report to disk: ``report.json`` and ``report.html``, each whole or not at all."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel

from spl_batch.io.atomic import write_bytes
from spl_batch.report.model import Report

if TYPE_CHECKING:  # matplotlib is loaded only where one draws
    from spl_batch.report.picture import Picture


def report_json(report: BaseModel) -> str:
    """Text of ``report.json``: fields in the model's order, every number finite or null."""
    content = report.model_dump(mode="json")
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def read_report(path: Path) -> Report:
    """Report from ``report.json``.

    Raises
    ------
    OSError
        If the file cannot be read.
    pydantic.ValidationError
        If it is no report of this version.
    """
    return Report.model_validate_json(path.read_text(encoding="utf-8"))


def write_report(out: Path, report: Report, pictures: Mapping[str, "Picture"]) -> None:
    """Write both files of the report into a folder.

    Parameters
    ----------
    out : Path
        Folder; made where it is missing.
    report : Report
        What is said.
    pictures : mapping of str to Picture
        What is shown; any may be missing.

    Raises
    ------
    StoppedError
        If the disk is full; an earlier report is then left as it was.
    WorkflowError
        If the folder cannot be written.
    """
    from spl_batch.report.html import render  # noqa: PLC0415

    write_both(out, report, render(report, pictures))


def write_both(out: Path, report: BaseModel, page: str) -> None:
    """Write any receiver's report into a folder.

    Parameters
    ----------
    out : Path
        Folder; made where it is missing.
    report : BaseModel
        What is said.
    page : str
        The same as HTML.

    Raises
    ------
    StoppedError
        If the disk is full; an earlier report is then left as it was.
    WorkflowError
        If the folder cannot be written.
    """
    write_bytes(out / "report.json", report_json(report).encode())
    write_bytes(out / "report.html", page.encode())
