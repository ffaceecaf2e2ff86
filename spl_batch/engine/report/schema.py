"""JSON Schemas, generated from the models, and the page of all codes, from the table of findings.

Run ``python -m spl_batch.engine.report.schema [--check]``.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Formatter
from typing import Any, Final

from spl_batch.engine.findings import PAGE, Code, table
from spl_batch.receivers import HOMES, IMAGING, report_model, workflow_model

DIALECT = "https://json-schema.org/draft/2020-12/schema"

BEGIN: Final = "<!-- codes: python -m spl_batch.engine.report.schema -->"
"""Line of the page of codes from which on it is made of the table."""


def schemas() -> dict[str, str]:
    """Text of every schema file, by file name: JSON with a stable order of keys."""
    found = {}
    for kind in HOMES:
        before = "" if kind == IMAGING else f"{kind}_"
        workflow = workflow_model(kind).model_json_schema(mode="validation")
        report = report_model(kind).model_json_schema(mode="serialization")
        words = "" if kind == IMAGING else f" ({kind})"
        found[f"{before}report.schema.json"] = _text(
            {**report, "title": f"spl-batch report{words}"}
        )
        found[f"{before}workflow.schema.json"] = _text(
            {**workflow, "title": f"spl-batch workflow{words}"}
        )
    return found


def generated(root: Path) -> dict[Path, str]:
    """Text of every file below a folder that is made of the models and the table of findings."""
    found = {root / "schemas" / name: text for name, text in schemas().items()}
    page = root / PAGE
    before = page.read_text(encoding="utf-8").partition(BEGIN)[0] if page.is_file() else ""
    return found | {page: f"{before}{BEGIN}\n\n{codes()}"}


def codes() -> str:
    """Text of all codes, in order."""
    return "\n".join(line for code in sorted(table()) for line in _section(code, table()[code]))


def _section(name: str, code: Code) -> Iterator[str]:
    yield f"## {name}: {code.title}\n"
    sentences = {"": code.sentences} if isinstance(code.sentences, str) else code.sentences
    for kind, sentence in sentences.items():
        yield f"- `{kind}`: {_shown(sentence)}" if kind else _shown(sentence)
    yield ""
    if code.consequence:
        shown = _shown(code.consequence)
        yield f"{shown[0].upper()}{shown[1:]}.\n"
    if code.remedy:
        yield f"To do: {_shown(code.remedy)}.\n"


def _shown(template: str) -> str:
    """A template with the names of its values in italics."""
    parts = Formatter().parse(template)
    return "".join(f"{text}*{name}*" if name else text for text, name, *_ in parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files below a folder, this one by default, or only ``--check`` them."""
    given = sys.argv[1:] if arguments is None else arguments
    root = Path(next((one for one in given if one != "--check"), "."))
    check, old = "--check" in given, False
    for path, text in generated(root).items():
        if path.is_file() and path.read_text(encoding="utf-8") == text:
            continue
        old = True
        if check:
            sys.stderr.write(f"{path}: stale; run python -m spl_batch.engine.report.schema\n")
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            sys.stdout.write(f"{path}: written\n")
    return int(old and check)


def _text(schema: dict[str, Any]) -> str:
    return json.dumps({"$schema": DIALECT, **schema}, indent=2, allow_nan=False) + "\n"


if __name__ == "__main__":
    sys.exit(main())
