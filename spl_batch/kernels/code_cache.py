"""Keep compiled code whole where several processes compile at the same time.

numba keeps an index of each function on disk, which names files of code by number. It writes each
file at once, but takes the number from an index that another process may be about to replace: two
that compile a function for other types, or for other processors on a file system that they share,
take the same number, and what one of them indexed is the code of the other. The index comes before
the code, too: a process that is killed between them leaves the code of an earlier version under the
stamp of the new one.

numba takes code for current as long as the file of its function stays as it is. What that function
calls is compiled into it, though: where only the file of a called one has changed, as after an
upgrade, the old code would go on.

:func:`install` mends both: what is kept is written under a lock of the folder, the code first; and
it is current as long as no file of the project that its own one imports, directly or not, has
changed.
"""

import ast
import contextlib
import hashlib
import os
from collections.abc import Iterator
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, Final

from numba.core import caching

try:
    import fcntl
except ImportError:  # Windows has none; there numba is left as it is
    fcntl = None  # type: ignore[assignment]

_LOCK: Final = "spl_batch.lock"
_ROOT: Final = Path(__file__).parents[2]
_PACKAGE: Final = Path(__file__).parents[1].name

_STAMPED: Final[Any] = getattr(caching, "_SourceFileBackedLocatorMixin", None)
_KEPT: Final[Any] = getattr(caching, "IndexDataCacheFile", None)
_STEPS: Final = ("save", "_load_index", "_save_index", "_data_name", "_save_data")

_stamp_of_file: Final[Any] = getattr(_STAMPED, "get_source_stamp", None)


def install() -> None:
    """Have numba keep code as this module says, in this process; another numba is left as it is."""
    if _stamp_of_file is not None:
        _STAMPED.get_source_stamp = source_stamp
    if fcntl is not None and all(hasattr(_KEPT, step) for step in _STEPS):
        _KEPT.save = save


def source_stamp(locator: Any) -> Any:
    """By what numba knows that code is current.

    Parameters
    ----------
    locator : _CacheLocator
        Of a function.

    Returns
    -------
    str or object
        A hash of the function's file and of those of the project that it imports, directly or not;
        numba's own stamp where it imports none, or no kernels: it may be loaded before them.
    """
    files = imported(Path(locator._py_file))  # noqa: SLF001 - there is no other way
    kernels = _ROOT / _PACKAGE / "kernels"
    if len(files) == 1 or not any(path.is_relative_to(kernels) for path in files):
        return _stamp_of_file(locator)
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(_contents(path))
    return digest.hexdigest()


def imported(path: Path) -> set[Path]:
    """A file and those of the project that it imports, directly or not."""
    found, waiting = {path}, [path]
    while waiting:
        new = _imports(waiting.pop()) - found
        found |= new
        waiting.extend(new)
    return found


@cache
def _contents(path: Path) -> bytes:
    """Hash of a file."""
    return hashlib.sha256(path.read_bytes()).digest()


@cache
def _imports(path: Path) -> frozenset[Path]:
    """Files of the project that a file imports."""
    if not path.is_file():  # within an archive, say
        return frozenset()
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    parts = [name.split(".") for name in names if name.split(".")[0] == _PACKAGE]
    candidates = (_ROOT.joinpath(*part).with_suffix(".py") for part in parts)
    return frozenset(path for path in candidates if path.is_file())


def save(file: Any, key: Any, data: Any) -> None:
    """Keep the code of a function for some types and processor.

    Parameters
    ----------
    file : IndexDataCacheFile
        What is kept of the function.
    key : tuple
        The types, the processor and hashes of the function.
    data : object
        The code.
    """
    with _locked(Path(file._cache_path) / _LOCK):  # noqa: SLF001 - there is no other way
        overloads = file._load_index()  # noqa: SLF001
        taken = set(overloads.values())
        free = (name for name in map(file._data_name, count(1)) if name not in taken)  # noqa: SLF001
        name = overloads.get(key) or next(free)
        file._save_data(name, data)  # noqa: SLF001
        file._save_index({**overloads, key: name})  # noqa: SLF001


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that the system drops when the process ends."""
    handle = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
    try:
        with contextlib.suppress(OSError):  # some network file systems know no locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
