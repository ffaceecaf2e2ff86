"""Keep compiled code whole where several processes compile at the same time.

numba keeps an index of each function on disk, which names files of code by number. It writes each
file at once, but takes the number from an index that another process may be about to replace: two
that compile a function for other types, or for other processors on a file system that they share,
take the same number, and what one of them indexed is the code of the other. The index comes before
the code, too: a process that is killed between them leaves the code of an earlier version under the
stamp of the new one.

:func:`install` makes both steps one: under a lock of the folder, and the code first.
"""

import contextlib
import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any, Final

from numba.core.caching import IndexDataCacheFile

try:
    import fcntl
except ImportError:  # Windows has none; there numba is left as it is
    fcntl = None  # type: ignore[assignment]

_LOCK: Final = "spl_batch.lock"


def install() -> None:
    """Have numba save code as :func:`save` does, in this process."""
    if fcntl is not None:
        IndexDataCacheFile.save = save  # type: ignore[method-assign]


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
