"""The verb ``init``: a first workflow for a folder of files, whatever their receiver.

What files show is written, what they do not is a comment that asks for it.
"""

import json
import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import yaml

from spl_batch.engine.store.output_lock import lock_file
from spl_batch.engine.verbs.output_owner import RECORD
from spl_batch.errors import WorkflowError, plain
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.receivers import HOMES, beginner

NAME: Final = "workflow.yaml"
"""What the workflow is called, in the folder."""

_PLAIN: Final = re.compile(r"[A-Za-z][\w./*:-]*")


@dataclass
class Beginning:
    """A first workflow, and what it rests on."""

    lines: list[str] = field(default_factory=list)
    #: Key and what was seen; key and what files leave open.
    found: list[tuple[str, str]] = field(default_factory=list)
    unknown: list[tuple[str, str]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)  #: Files that it does not name, and why.
    workflow: Path = Path(NAME)  #: The file, once it is written.

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


def init(folder: Path | str, *, force: bool = False) -> Beginning:
    """Write a commented workflow for the files of a folder.

    Parameters
    ----------
    folder : Path or str
        Folder with LAS, LAZ or COPC below it, and what belongs to them; or with photons along a
        track.

    Raises
    ------
    WorkflowError
        If no file there can be used, or a workflow is there already.
    """
    base = Path(folder)
    target = base / NAME
    if target.exists() and not force:
        raise WorkflowError(
            f"{target} is there already; `spl-batch plan` reads it, --force replaces"
        )
    drafts = (begin(base) for kind in HOMES if (begin := beginner(kind)) is not None)
    draft: Beginning | None = next((draft for draft in drafts if draft is not None), None)
    if draft is None:
        inputs = ", and no ".join(home.inputs for home in HOMES.values() if home.begin)
        raise WorkflowError(f"{base}: no {inputs} below it; name the folder that holds them")
    write_bytes(target, draft.text.encode())
    return replace(draft, workflow=target)


def headed(page: str) -> Beginning:
    """Begin a file, with the name of the page that explains its keys."""
    return Beginning(
        [
            "# Written by `spl-batch init` from what the files state. A `?` marks what they do not",
            "# state: look at these lines first. The keys that are not here are explained in",
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
    for parent in sorted({path.parent for path in paths}):
        for suffix in sorted({path.suffix for path in paths if path.parent == parent}):
            these = sorted(p for p in paths if p.parent == parent and p.suffix == suffix)
            pattern = f"*{suffix}"
            if len(these) > 1 and these == sorted(parent.glob(pattern)):
                found.append((parent.relative_to(base) / pattern).as_posix())
            else:
                found += [path.relative_to(base).as_posix() for path in these]
    return found[0] if len(found) == 1 else found


def files_below(folder: Path) -> list[Path]:
    """Files below a folder but for hidden ones and results of runs, in order of their names."""
    return sorted(_files(folder))


def _files(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        folders[:] = [
            name
            for name in folders
            if not name.startswith(".") and not _is_output(Path(parent, name))
        ]
        yield from (Path(parent, name) for name in names if not name.startswith("."))


def _is_output(folder: Path) -> bool:
    return (folder / RECORD).exists() or lock_file(folder).exists()
