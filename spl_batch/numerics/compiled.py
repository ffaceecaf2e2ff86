"""The project's ``njit``: kernels whose compiled code is kept whole, and only while it is current.

numba keeps an index of each function on disk, which names files of code by number. It writes each
file at once, but takes the number from an index that another process may be about to replace. Two
processes that compile a function for other types, or for other processors on a shared file system,
then take the same number, and the index of one names the code of the other (numba issue 8851). The
index comes before the code, too: a process that is killed between them leaves the code of an
earlier version under the stamp of the new one.

numba takes code for current as long as the file of its function stays as it is. But code that the
function calls is compiled into it: where only the file of a called function has changed, as after
an upgrade, the old code would go on (numba issue 10128).

:func:`njit` mends both. It writes under a lock of the folder, the code first; and code is current
as long as no file of the project that its own file imports, directly or not, has changed.

A kernel with ``inline="always"`` is inlined by LLVM: numba would type and lower it anew within each
kernel that calls it.

A kernel that another one calls with a constant would be compiled for that constant alone, and so
would all that it calls with it. Here it is compiled once, for any number.

numba compiles each function with a wrapper that unpacks Python's objects, and with one for C. They
take a fifth of the time. A kernel that only other kernels call is compiled without them; one that
is called from Python as well is compiled twice.
"""

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from itertools import count
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba
from numba.core import caching, types
from numba.core.dispatcher import Dispatcher

from spl_batch.imports import content_hash, imported
from spl_batch.numerics.linked_code import (
    CompilerForInlining,
    CompilerForLinking,
    KernelCompiler,
    linked,
)

try:
    import fcntl
except ImportError:  # Windows has none; there numba keeps its code in its own way
    fcntl = None  # type: ignore[assignment]

_F = TypeVar("_F", bound=Callable[..., Any])

_LOCK: Final = "spl_batch.lock"
_STEPS: Final = ("_load_index", "_save_index", "_data_name", "_save_data", "_source_stamp")


def njit(**options: Any) -> Callable[[_F], "Dispatcher[_F]"]:
    """Compile a function when it is first called, and keep the code on disk.

    Parameters
    ----------
    **options
        As of :func:`numba.njit`; the function releases the GIL.

    Returns
    -------
    callable
        Decorator that makes a dispatcher of numba of a function.
    """
    taken = {**options, "nogil": True, "cache": True, "no_cfunc_wrapper": True}
    inlined = taken.pop("inline", "never") == "always"

    def decorate(function: _F) -> "Dispatcher[_F]":
        kernel: Any = numba.njit(**taken, pipeline_class=KernelCompiler)(function)
        kernel._cache._cache_file = kept(kernel._cache)  # noqa: SLF001 - there is no other way
        kernel.for_kernels = _inner(function, taken, inlined=inlined) or kernel
        kernel.get_overload = kernel.for_kernels.get_overload
        kernel.get_call_template = partial(_of_any_number, kernel.for_kernels.get_call_template)
        return cast("Dispatcher[_F]", kernel)

    return decorate


def _inner(function: Callable[..., Any], options: Mapping[str, Any], *, inlined: bool) -> Any:
    """The same kernel for other kernels alone; None where its code cannot be kept apart."""
    compiler = CompilerForInlining if inlined else CompilerForLinking
    inner: Any = numba.njit(**options, pipeline_class=compiler)(function)
    code = kept(inner._cache, "inner")  # noqa: SLF001 - there is no other way
    if not isinstance(code, KeptCode):
        return None
    inner._cache._cache_file = code  # noqa: SLF001
    inner.targetctx = linked(inner.targetctx)
    return inner


def _of_any_number(
    template: Callable[..., Any], args: Sequence[types.Type], named: Mapping[str, types.Type]
) -> Any:
    """What a kernel takes from another: numbers, where numba sees a type in each constant."""
    plain = {name: types.unliteral(given) for name, given in named.items()}
    return template(tuple(map(types.unliteral, args)), plain)


def kept(known: Any, kind: str = "") -> Any:
    """Files of a function's code, written and stamped as this module describes.

    Parameters
    ----------
    known : numba.core.caching.FunctionCache
        What numba has made for the function.
    kind : str
        Tells code of one function from other code of it; in the names of its files.

    Returns
    -------
    KeptCode or numba.core.caching.IndexDataCacheFile
        numba's own files where they are not as this module knows them.
    """
    own = known._cache_file  # noqa: SLF001
    if fcntl is None or not all(hasattr(own, step) for step in _STEPS):
        return own
    locator = known._impl.locator  # noqa: SLF001
    path = Path(locator._py_file)  # noqa: SLF001
    stamp = source_stamp(path) if path.is_file() else own._source_stamp  # noqa: SLF001
    name = f"{known._impl.filename_base}{kind and '.'}{kind}"  # noqa: SLF001
    return KeptCode(locator.get_cache_path(), name, stamp)


class KeptCode(caching.IndexDataCacheFile):
    """Index and code of a function, for some types and processors."""

    def save(self, key: Any, data: Any) -> None:
        """Keep code: under a lock, the code before the index that names it.

        ``key``: the types, the processor and hashes of the function.
        """
        with _locked(Path(self._cache_path) / _LOCK):
            overloads = self._load_index()
            taken = set(overloads.values())
            free = (name for name in map(self._data_name, count(1)) if name not in taken)
            name = overloads.get(key) or next(free)
            self._save_data(name, data)
            self._save_index({**overloads, key: name})

    def _load_index(self) -> dict[Any, str]:
        """Names of code by types; none of an earlier version whose types are gone from there."""
        try:
            found: dict[Any, str] = super()._load_index()
        except (ImportError, AttributeError):
            return {}
        return found


def folder_of(function: Callable[..., Any]) -> Path:
    """Folder in which compiled code of a function would be kept; it is made if it is not there."""
    return Path(caching.FunctionCache(function)._impl.locator.get_cache_path())  # noqa: SLF001


@cache
def source_stamp(path: Path) -> str:
    """Hash of a file and of the files of the project that it imports, directly or not."""
    return content_hash(imported(path))


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
