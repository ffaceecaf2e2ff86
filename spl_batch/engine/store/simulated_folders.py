"""Folders that simulations write into: a mark says that what lies there was simulated."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.settings.mistaken_file import refuse_urls
from spl_batch.engine.store.output_lock import refuse_lost
from spl_batch.engine.store.working_store import read_json, write_json
from spl_batch.errors import DamagedError, WorkflowError, named

MADE: Final = "simulated.json"
"""Mark of a folder that a simulation has written into."""


@contextmanager
def simulating(folder: Path, scene: Path) -> Iterator[None]:
    """Simulate into a folder that is empty but for the scene, or that a simulation has filled.

    Parameters
    ----------
    folder : Path
        Where the block writes to; made where it is missing.
    scene : Path
        File of the scene, which may lie in the folder.

    Raises
    ------
    WorkflowError
        If it holds anything else.
    """
    refuse_urls(folder)
    refuse_lost(folder, str(folder), Path.cwd())
    if _mark(folder) is None:
        _refuse(folder, _names(folder, scene), "which no simulation made")
    new = not folder.exists()
    write_json(folder / MADE, {"whole": False, "quickstart": False})
    try:
        yield
    except BaseException:
        if not _names(folder, scene):  # a fault of the scene leaves nothing behind
            (folder / MADE).unlink()
            if new:
                folder.rmdir()
        raise
    write_json(folder / MADE, {"whole": True, "quickstart": False})


def mark_quickstart(folder: Path) -> None:
    """Record that the survey of a folder is the quickstart's."""
    write_json(folder / MADE, {"whole": True, "quickstart": True})


def quickstarted(folder: Path) -> bool:
    """Whether an earlier quickstart has made its survey in a folder, which goes on then.

    Raises
    ------
    WorkflowError
        If the folder holds anything else.
    """
    refuse_urls(folder)
    mark = _mark(folder)
    if mark is None or (mark["whole"] and not mark["quickstart"]):
        _refuse(folder, _names(folder), "which no quickstart made")
        return False
    return bool(mark["whole"]) and (folder / "workflow.yaml").exists()


def _mark(folder: Path) -> dict[str, Any] | None:
    """Mark of a folder; None where there is none."""
    try:
        return read_json(folder / MADE)
    except DamagedError:
        return None


def _names(folder: Path, scene: Path | None = None) -> list[str]:
    """What lies in a folder beside the mark and the scene."""
    if folder.exists() and not folder.is_dir():
        raise WorkflowError(f"{folder} is a file; name a folder")
    there = folder.iterdir() if folder.is_dir() else ()
    others = (path for path in there if scene is None or not path.samefile(scene))
    return sorted(path.name for path in others if path.name != MADE)


def _refuse(folder: Path, names: list[str], why: str) -> None:
    if names:
        raise WorkflowError(f"{folder} holds {named(names, 3)}, {why}; name another folder")
