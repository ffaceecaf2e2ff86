"""What files and pages that people are shown hold, beside the keys and defaults that there are."""

import re
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from spl_batch.engine.settings.base import Section


def blocks(page: Path, language: str) -> list[str]:
    """Pieces of code of a page, in order."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """Path of every key of a workflow or scene, sections and values."""
    found = []
    for name, field in model.model_fields.items():
        found.append(prefix + name)
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(kind, type) and issubclass(kind, Section):
                found += keys(kind, f"{prefix}{name}.")
    return found


def unshown(text: str, model: type[BaseModel]) -> list[str]:
    """Keys that the text of a file does not name, not even in a comment."""
    return [
        path
        for path in keys(model)
        if not re.search(rf"^[ #]*{path.rpartition('.')[2]}:", text, re.MULTILINE)
    ]


def differing(given: Any, default: Any, prefix: str = "") -> list[str]:
    """Values of a file that are not the default, where there is one."""
    if not isinstance(given, dict):
        return [] if given == default else [prefix]
    return [
        line
        for key, value in given.items()
        for line in differing(value, (default or {}).get(key), f"{prefix}.{key}".lstrip("."))
    ]
