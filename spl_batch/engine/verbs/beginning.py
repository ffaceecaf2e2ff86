"""The verb ``init``: a first workflow for a folder of files, whatever their receiver."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from spl_batch.engine.store.deliveries import RECORD
from spl_batch.engine.store.output_lock import lock_file
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.receivers import HOMES, beginner

NAME: Final = "workflow.yaml"
"""What the workflow is called, in the folder."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """A workflow that was written, and what it rests on."""

    workflow: Path
    found: tuple[tuple[str, str], ...]  #: Key or word, and what the files hold of it.
    unknown: tuple[tuple[str, str], ...]  #: Key, and what they do not hold.
    left_out: tuple[str, ...]  #: Files that the workflow does not name, and why.


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
    place = Path(folder)
    target = place / NAME
    if target.exists() and not force:
        raise WorkflowError(
            f"{target} is there already; `spl-batch plan` reads it, --force replaces"
        )
    drafts = (begin(place) for kind in HOMES if (begin := beginner(kind)) is not None)
    draft = next((draft for draft in drafts if draft is not None), None)
    if draft is None:
        inputs = ", and no ".join(home.inputs for home in HOMES.values() if home.begin)
        raise WorkflowError(f"{place}: no {inputs} below it; name the folder that holds them")
    write_bytes(target, draft.text.encode())
    return Beginning(target, tuple(draft.found), tuple(draft.unknown), tuple(draft.left_out))


def files_below(folder: Path) -> list[Path]:
    """Files below a folder but for hidden ones and results of runs, in order of their names."""
    return sorted(_files(folder))


def _files(folder: Path) -> Iterator[Path]:
    for place, folders, names in os.walk(folder):
        folders[:] = [
            name
            for name in folders
            if not name.startswith(".") and not _is_output(Path(place, name))
        ]
        yield from (Path(place, name) for name in names if not name.startswith("."))


def _is_output(folder: Path) -> bool:
    return (folder / RECORD).exists() or lock_file(folder).exists()
