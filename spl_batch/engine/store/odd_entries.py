"""What must not lie in an output: links that lead out of it, and what only looks like a file.

A run writes in its output alone, so that a link could lead it elsewhere; and who opens a pipe waits
for its other end, who reads a device reads for ever.
"""

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from spl_batch.errors import WorkflowError

_KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)

_FILES: Final = (
    *("log.jsonl", "delivered.json", "report.json", "report.html"),
    *("store/lock", "store/run.json", "store/identity.json"),
)
"""Names below the output that are files where they are there."""

_FOLDERS: Final = ("laz", "tiles", "stac", "store/receipts")
"""Names below the output that are folders."""

_RESULTS: Final = (".tif", ".json", ".html", ".qml", ".qlr", ".gpkg", ".xml", ".vpc")
"""How names of results end that lie in the output itself."""

_REMEDY: Final = "remove it, or name another output"


def refuse_odd(output: Path) -> None:
    """Refuse an output in which something leads elsewhere, or is neither a file nor a folder.

    ``store`` may be a link, to a faster disk; nothing in it may lead out of there.

    Raises
    ------
    WorkflowError
        One line that names the first.
    """
    store = output / "store"
    for place, home in ((output, output), (store, store)):
        inside = Path(os.path.realpath(home))
        for path in _entries(place, but=store):
            _refuse(path, inside)
    _refuse_swapped(output)
    results = (path for path in sorted(output.glob("*")) if path.name.endswith(_RESULTS))
    for path in (*results, *sorted(store.glob("*.json"))):
        if path.is_dir():
            raise WorkflowError(_swapped(path, "a folder"))


def refuse_odd_log(output: Path) -> None:
    """Refuse what :func:`refuse_odd` does, but of what a look at a run reads; it takes no time."""
    for home, names in ((output, ("log.jsonl",)), (output / "store", ("lock", "receipts"))):
        inside = Path(os.path.realpath(home))
        for path in (home / name for name in names):
            _refuse(path, inside)
    _refuse_swapped(output)


def _refuse_swapped(output: Path) -> None:
    """Refuse a folder in place of a file, or the other way round."""
    swapped = [(name, "a folder") for name in _FILES if (output / name).is_dir()]
    swapped += [(name, "a file") for name in _FOLDERS if (output / name).is_file()]
    for name, kind in swapped:
        raise WorkflowError(_swapped(output / name, kind))


def _swapped(path: Path, kind: str) -> str:
    return (
        f"output: {path} is {kind}, which a run cannot use there: move it away, or name another "
        "output"
    )


def _entries(folder: Path, but: Path) -> Iterator[Path]:
    """All below a folder that is no plain file or folder; ``but`` is not looked into."""
    left = [folder]
    while left:
        try:
            with os.scandir(left.pop()) as found:
                for entry in found:
                    path = Path(entry.path)
                    if path == but or entry.is_file(follow_symlinks=False):
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        left.append(path)
                    else:
                        yield path
        except OSError:  # gone, as a run is at work there, or not to be read, which that run tells
            continue


def _refuse(path: Path, inside: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except OSError:  # nothing there
        return
    if stat.S_ISLNK(mode):
        _refuse_link(path, inside)
        return
    for is_one, kind in _KINDS:
        if is_one(mode):
            raise WorkflowError(f"output: {path} is {kind}, and no file: {_REMEDY}")


def _refuse_link(path: Path, inside: Path) -> None:
    target = Path(os.path.realpath(path))
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            text = f"output: {path} is a link that leads to itself: {_REMEDY}"
            raise WorkflowError(text) from None
    if inside not in target.parents:
        raise WorkflowError(f"output: {path} is a link to {target}, out of the output: {_REMEDY}")
