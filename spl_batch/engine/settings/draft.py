"""A workflow file in the making: what files tell is written, what they do not is said."""

import json
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml

from spl_batch.errors import plain

_PLAIN: Final = re.compile(r"[A-Za-z][\w./*:-]*")


@dataclass
class Draft:
    """A workflow file in the making."""

    lines: list[str] = field(default_factory=list)
    #: Key and what was seen; key and what files do not tell.
    found: list[tuple[str, str]] = field(default_factory=list)
    unknown: list[tuple[str, str]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  #: Files that it does not name, and why.

    @property
    def text(self) -> str:
        """Content of the file."""
        return "\n".join(self.lines) + "\n"

    def section(self, name: str) -> None:
        """Begin a section."""
        self.lines += ["", f"{name}:"]

    def known(self, key: str, value: Any, reason: str, label: str = "") -> None:
        """Write a key of a section, and above it why it has this value."""
        self.found.append((label or key, plain(reason)))
        self.lines += [f"  # {plain(reason)}", *key_lines(key, value, "  ")]

    def supposed(self, key: str, value: str, reason: str) -> None:
        """Write a key that has to have a value, and above it that this one may be wrong."""
        self.unknown.append((key, reason))
        self.lines += [f"  # ? {reason}", *key_lines(key, value, "  ")]

    def note(self, key: str, reason: str) -> None:
        """Write what has to be settled elsewhere, as a comment."""
        self.unknown.append((key, reason))
        self.lines += wrapped(f"? {key}: {reason}", "  ")

    def open(self, key: str, example: Any, reason: str, *, indent: str = "  ") -> None:
        """Write a key as a comment, and above it what is not known."""
        self.unknown.append((key, plain(reason)))
        shown = [f"{indent}# {line.strip()}" for line in key_lines(key, example, "")]
        self.lines += [f"{indent}# ? {plain(reason)}", *shown]


def headed(page: str) -> Draft:
    """Begin a file, with the name of the page that explains its keys."""
    return Draft(
        [
            "# Written by `spl-batch init` from what the files tell. A `?` marks what they do not",
            "# tell: look at these lines first. The keys that are not here are explained in",
            f"# docs/{page}.md.",
            "#",
            "#   spl-batch plan workflow.yaml    what a run costs, what is wrong with the inputs",
            "#   spl-batch run workflow.yaml     everything; run again, it continues",
        ]
    )


def wrapped(text: str, indent: str = "") -> list[str]:
    """A comment, in more than one line where it is long."""
    begin = f"{indent}# "
    return textwrap.wrap(plain(text), 98, initial_indent=begin, subsequent_indent=begin)


def key_lines(key: str, value: Any, indent: str) -> list[str]:
    """A key and its value, a list one below the other."""
    if isinstance(value, list):
        return [f"{indent}{key}:", *(f"{indent}  - {_scalar(one)}" for one in value)]
    return [f"{indent}{key}: {_scalar(value)}"]


def _scalar(value: str) -> str:
    """Text as YAML reads it back."""
    if _PLAIN.fullmatch(value) and yaml.safe_load(value) == value:
        return value
    return json.dumps(value)


def patterns(base: Path, paths: Sequence[Path]) -> str | list[str]:
    """Files below a folder as patterns where these match nothing else, else by name."""
    found: list[str] = []
    for place in sorted({path.parent for path in paths}):
        for suffix in sorted({path.suffix for path in paths if path.parent == place}):
            these = sorted(p for p in paths if p.parent == place and p.suffix == suffix)
            pattern = f"*{suffix}"
            if len(these) > 1 and these == sorted(place.glob(pattern)):
                found.append((place.relative_to(base) / pattern).as_posix())
            else:
                found += [path.relative_to(base).as_posix() for path in these]
    return found[0] if len(found) == 1 else found
