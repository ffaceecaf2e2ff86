"""JSON Schemas, generated from the models.

Run ``python -m spl_batch.engine.report.schema [--check]``.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spl_batch.receivers import HOMES, IMAGING, report_model, workflow_model

DIALECT = "https://json-schema.org/draft/2020-12/schema"


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


def stale(folder: Path) -> list[str]:
    """Names of the schema files in a folder that are missing or differ from the models."""
    return [
        name
        for name, text in schemas().items()
        if not (folder / name).is_file() or (folder / name).read_text(encoding="utf-8") != text
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the schema files of a folder, ``schemas`` by default, or only ``--check`` them."""
    given = sys.argv[1:] if arguments is None else arguments
    folder = Path(next((one for one in given if one != "--check"), "schemas"))
    old, texts = stale(folder), schemas()
    for name in old:
        if "--check" in given:
            sys.stderr.write(
                f"{folder / name}: stale; run python -m spl_batch.engine.report.schema\n"
            )
            continue
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(texts[name], encoding="utf-8")
        sys.stdout.write(f"{folder / name}: written\n")
    return int(bool(old) and "--check" in given)


def _text(schema: dict[str, Any]) -> str:
    return json.dumps({"$schema": DIALECT, **schema}, indent=2, allow_nan=False) + "\n"


if __name__ == "__main__":
    sys.exit(main())
