"""The verb ``init``: a first workflow for a folder of files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from spl_batch.airborne.first_use.clouds import SENSOR
from spl_batch.airborne.first_use.commented import propose
from spl_batch.airborne.first_use.folder import look_through
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.engine.watch.listing import listed
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import write_bytes

NAME: Final = "workflow.yaml"
"""What the workflow is called, in the folder."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """A workflow that was written, and what it rests on."""

    workflow: Path
    found: tuple[tuple[str, str], ...]  #: Key or word, and what the files tell of it.
    unknown: tuple[tuple[str, str], ...]  #: Key, and what they do not tell.
    left_out: tuple[str, ...]  #: Files that the workflow does not name, and why.

    def __repr__(self) -> str:
        unknown = (("not told", f"{label}: {text}") for label, text in self.unknown)
        left = (("left out", text) for text in self.left_out)
        return listed("Beginning", (("workflow", str(self.workflow)), *self.found, *unknown, *left))


def init(folder: Path | str, *, force: bool = False) -> Beginning:
    """Write a commented workflow for the files of a folder.

    Parameters
    ----------
    folder : Path or str
        Folder with LAS, LAZ or COPC below it, and what belongs to them.

    Raises
    ------
    WorkflowError
        If no cloud there can be used, or a workflow is there already.
    """
    place = Path(folder)
    target = place / NAME
    if target.exists() and not force:
        raise WorkflowError(
            f"{target} is there already; `spl-batch plan` reads it, --force replaces"
        )
    proposal = propose(look_through(place, load_preset(SENSOR)))
    write_bytes(target, proposal.text.encode())
    return Beginning(
        target, tuple(proposal.found), tuple(proposal.unknown), tuple(proposal.left_out)
    )
