"""Report to disk: ``report.json`` and ``report.html``, each whole or not at all."""

import json
from pathlib import Path

from pydantic import BaseModel

from spl_batch.formats.files.atomic import write_bytes


def report_json(report: BaseModel) -> str:
    """Text of ``report.json``: fields in the model's order, every number finite or null."""
    content = report.model_dump(mode="json")
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_both(out: Path, report: BaseModel, page: str) -> None:
    """Write any receiver's report into a folder.

    ``out``: folder; made where it is missing.
    """
    write_bytes(out / "report.json", report_json(report).encode())
    write_bytes(out / "report.html", page.encode())
