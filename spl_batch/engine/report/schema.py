"""JSON Schemas, generated from the models.

Run ``python -m spl_batch.engine.report.schema [--check]``.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spl_batch.receivers import HOMES, IMAGING, report_model, workflow_model

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """Text of every schema file, by file name.

    Returns
    -------
    dict of str to str
        JSON with a stable order of keys and a newline at its end.
    """
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
    """Write the schema files, or only check them."""
    parser = argparse.ArgumentParser(
        prog="python -m spl_batch.engine.report.schema", description=__doc__
    )
    parser.add_argument("folder", nargs="?", type=Path, default=Path("schemas"))
    parser.add_argument("--check", action="store_true", help="write nothing, fail when stale")
    options = parser.parse_args(arguments)
    changed = stale(options.folder)
    if options.check:
        for name in changed:
            sys.stderr.write(f"{options.folder / name}: stale; run {parser.prog}\n")
        return 1 if changed else 0
    options.folder.mkdir(parents=True, exist_ok=True)
    texts = schemas()
    for name in changed:
        (options.folder / name).write_text(texts[name], encoding="utf-8")
        sys.stdout.write(f"{options.folder / name}: written\n")
    return 0


def _text(schema: dict[str, Any]) -> str:
    return json.dumps({"$schema": DIALECT, **schema}, indent=2, allow_nan=False) + "\n"


if __name__ == "__main__":
    sys.exit(main())
