"""Folders that simulations write into: they replace nothing that a simulation has not made."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.settings.mistaken_file import refuse_urls
from spl_batch.engine.store.deliveries import RECORD
from spl_batch.engine.store.output_lock import lock_file, refuse_lost
from spl_batch.engine.store.working_store import read_json, write_json
from spl_batch.errors import DamagedError, WorkflowError, named
from spl_batch.formats.files.atomic import SCRATCH, real_path

MADE: Final = "simulated.json"
"""Record of what a simulation has made, in its folder."""

_WORKFLOW: Final = "workflow.yaml"
_BEFORE_RECORDS: Final = frozenset(
    {
        *("flightlines", "trajectory.csv", "trajectory.sbet", "reference_lml.laz", "water.gpkg"),
        *("truth", _WORKFLOW, "out"),
    }
)
"""What lies in the folder of a quickstart that was made before there was a record."""


@contextmanager
def simulating(folder: Path, scene: Path) -> Iterator[None]:
    """Simulate into a folder that holds nothing else; record what was made in it.

    Parameters
    ----------
    folder : Path
        Where the block writes to; made where it is missing.
    scene : Path
        File of the scene, which may lie in the folder.

    Raises
    ------
    WorkflowError
        If it holds a file that no simulation made, or one that has changed since.
    """
    refuse_urls(folder)
    refuse_lost(folder, str(folder), Path.cwd())
    made = _made(folder)
    given = (
        {real_path(scene).relative_to(real_path(folder)).as_posix()}
        if _holds(folder, scene)
        else set()
    )
    there = [name for name in _contents(folder) if name not in given]
    if made is None:
        _refuse(folder, there, "which no simulation made")
    elif not made["begun"]:
        files = made["files"]
        _refuse(folder, [n for n in there if n not in files], "which no simulation made")
        changed = [n for n in there if _stamp(folder / n) != files[n]]
        _refuse(folder, changed, "which has changed since it was simulated")
    new = not folder.exists()
    write_json(folder / MADE, {"begun": True, "files": {}, "quickstart": False})
    try:
        yield
    except BaseException:
        if set(_contents(folder)) <= given:  # a fault of the scene leaves nothing behind
            (folder / MADE).unlink()
            if new:
                folder.rmdir()
        raise
    files = {name: _stamp(folder / name) for name in _contents(folder) if name not in given}
    write_json(folder / MADE, {"begun": False, "files": files, "quickstart": False})


def _holds(folder: Path, scene: Path) -> bool:
    return real_path(folder) in real_path(scene).parents


def mark_quickstart(folder: Path) -> None:
    """Record that the survey of a folder is the quickstart's."""
    write_json(folder / MADE, {**read_json(folder / MADE), "quickstart": True})


def quickstarted(folder: Path) -> bool:
    """Whether an earlier quickstart has made its survey in a folder, which goes on then.

    Raises
    ------
    WorkflowError
        If the folder holds anything else.
    """
    refuse_urls(folder)
    made = _made(folder)
    if made is None:
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
        old = names <= _BEFORE_RECORDS and {_WORKFLOW, "truth"} <= names
        if old and _is_quickstart(folder / _WORKFLOW):
            return True
        _refuse(folder, _contents(folder), "which no quickstart made")
        return False
    if made["begun"]:
        return False
    if not made["quickstart"]:
        _refuse(folder, _contents(folder), "which no quickstart made")
    others = [name for name in _contents(folder) if name not in made["files"]]
    _refuse(folder, others, "which no quickstart made")
    return (folder / _WORKFLOW).exists()


def _is_quickstart(workflow: Path) -> bool:
    return "name: quickstart\n" in workflow.read_text(encoding="utf-8", errors="replace")


def _made(folder: Path) -> dict[str, Any] | None:
    """Record of a folder; None where there is none that can be trusted."""
    try:
        return read_json(folder / MADE)
    except DamagedError:
        return None


def _refuse(folder: Path, names: list[str], why: str) -> None:
    if names:
        raise WorkflowError(f"{folder} holds {named(names, 3)}, {why}; name another folder")


def _contents(folder: Path) -> list[str]:
    """Files below a folder, but for the record and the results of runs."""
    if folder.exists() and not folder.is_dir():
        raise WorkflowError(f"{folder} is a file; name a folder")
    found: list[str] = []
    for top, folders, files in os.walk(folder):
        place = Path(top)
        folders[:] = [name for name in folders if not _is_output(place / name)]
        names = [place / name for name in files if not name.endswith(SCRATCH)]
        found += [path.relative_to(folder).as_posix() for path in names]
    return sorted(name for name in found if name != MADE)


def _is_output(folder: Path) -> bool:
    return (folder / RECORD).exists() or lock_file(folder).exists()


def _stamp(path: Path) -> list[int]:
    """Size [byte] and time of writing [ns since 1970]."""
    stat = path.stat()
    return [stat.st_size, stat.st_mtime_ns]
