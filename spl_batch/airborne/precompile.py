"""Compile kernels before they are needed, a share on each worker.

numba compiles a kernel when it is first called, and keeps the code on disk. In the first run on
a machine all workers would compile the same at the same time, each of them everything. A process
that has compiled keeps some 250 MiB of what the compiler needed; so a worker has a process of
its own compile, and loads the code.
``signatures.json`` lists the kernels that the airborne chain calls, with the types of their
arguments; ``python -m benchmarks.airborne.signatures`` writes it.
"""

import contextlib
import gc
import importlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any, Final

from numba import types
from numba.core.dispatcher import Dispatcher

from spl_batch.errors import StoppedError
from spl_batch.numerics.compiled import is_kept

WATCHED: Final = "watched"
"""Argument of the process that compiles: it ends when its standard input does."""


def signatures() -> dict[str, list[list[Any]]]:
    """Types of the arguments of each kernel, by module and name, as :func:`parse` takes them."""
    text = (files("spl_batch.airborne") / "signatures.json").read_text(encoding="utf-8")
    found: dict[str, list[list[Any]]] = json.loads(text)
    return found


Tell = Callable[[int, int], None]
"""Told how many kernels of how many are compiled."""


def _tell_nobody(_done: int, _of: int) -> None:
    """Listen to no progress."""


def compile_share(share: int, shares: int, tell: Tell = _tell_nobody) -> int:
    """Have some of the kernels compiled by a process that ends, and load them.

    Parameters
    ----------
    share, shares : int
        Which part of all, from 0, and of how many.
    tell : callable
        Told how many kernels of this share are compiled, those that they call among them, and how
        many it has [count].

    Returns
    -------
    int
        Kernels that were compiled [count].

    Raises
    ------
    StoppedError
        That process has failed; its last line says why.
    """
    listed = signatures()
    names = divided(listed, shares)[share]
    ready = all(
        is_kept(find(name), parse(stored, find(name))) for name in names for stored in listed[name]
    )
    compiled = 0 if ready else _elsewhere(share, shares, tell)
    return compiled + _compile(share, shares, _tell_nobody)


def _command(share: int, shares: int) -> tuple[str, ...]:
    """Command of the process that compiles: it finds the same files of this project as this one.

    ``python -m`` would take those of the folder that it is called in, such as a clone.
    """
    begin = f"import runpy, sys; sys.path[:] = {sys.path!r}; "
    begin += f"runpy.run_module({__name__!r}, run_name='__main__', alter_sys=True)"
    return sys.executable, "-c", begin, str(share), str(shares), WATCHED


def _elsewhere(share: int, shares: int, tell: Tell) -> int:
    """Compile in another process; kernels that were compiled [count]."""
    command = _command(share, shares)
    last = "0"
    with tempfile.TemporaryFile("w+") as errors:
        with subprocess.Popen(  # noqa: S603 - this project's own module
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        ) as child:
            for line in child.stdout or ():
                *steps, last = line.split()
                if steps:
                    tell(int(steps[0]), int(last))
        if child.returncode:
            errors.seek(0)
            said = errors.read().strip().splitlines() or [f"exit status {child.returncode}"]
            raise StoppedError(f"kernels were not compiled ahead: {said[-1]}")
    return int(last)


@contextlib.contextmanager
def compiling_beside() -> Iterator["subprocess.Popen[bytes] | None"]:
    """Compile in another process as long as a block lasts, where a second processor is idle."""
    if (os.cpu_count() or 1) < 2:
        yield None
        return
    with subprocess.Popen(  # noqa: S603 - this project's own module
        _command(0, 1), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as child:
        try:
            yield child
        finally:
            child.kill()  # code is kept whole or not at all


def _compile(share: int, shares: int, tell: Tell) -> int:
    """Compile here, or load what is compiled; kernels that were compiled and not loaded [count]."""
    compiled, listed = 0, signatures()
    # Those that call few others first: each step is short then, and what is told moves evenly.
    names = divided(listed, shares)[share][::-1]
    needed = [set(_called(find(name))) for name in names]
    ready: set[str] = set()
    whole = len(ready.union(*needed))
    for name, kernels in zip(names, needed, strict=True):
        tell(len(ready), whole)
        ready |= kernels
        kernel = find(name)
        for stored in listed[name]:
            before = sum(kernel.stats.cache_misses.values())
            kernel.compile(parse(stored, kernel))
            compiled += sum(kernel.stats.cache_misses.values()) - before
    tell(whole, whole)
    return compiled


def divided(names: Mapping[str, Any], shares: int) -> list[list[str]]:
    """Kernels in shares of about equal cost; those that call the same ones are kept together."""
    called = {name: frozenset(_called(find(name))) for name in names}
    loads: list[set[str]] = [set() for _ in range(shares)]
    found: list[list[str]] = [[] for _ in range(shares)]
    for name in sorted(called, key=lambda name: (-len(called[name]), name)):
        added = [len(called[name] - load) for load in loads]
        best = min(range(shares), key=lambda k: len(loads[k]) + 2 * added[k])
        loads[best] |= called[name]
        found[best].append(name)
    return found


def find(name: str) -> Dispatcher:
    """Kernel by ``module:name``, as ``signatures.json`` names it."""
    module, _, function = name.partition(":")
    kernel: Dispatcher = getattr(importlib.import_module(module), function)
    return kernel


def parse(stored: Sequence[Any], kernel: Dispatcher) -> tuple[types.Type, ...]:
    """Types of a kernel's arguments: its module knows the named tuples among them.

    ``stored``: as ``signatures.json`` has them: ``"int64"``, ``["array", "int64", 1, "C"]``, or
    ``"readonly"`` for one that cannot be written to, ``["tuple", ...]``, or a named tuple by its
    name.
    """
    return tuple(_parse(one, kernel.py_func.__globals__) for one in stored)


def _parse(stored: Any, known: Mapping[str, Any]) -> types.Type:
    if isinstance(stored, str):
        found: types.Type = getattr(types, stored)
        return found
    kind, *parts = stored
    if kind in {"array", "readonly"}:
        dtype, axes, layout = parts
        return types.Array(_parse(dtype, known), axes, layout, readonly=kind == "readonly")
    members = [_parse(part, known) for part in parts]
    made: types.Type = types.BaseTuple.from_types(  # type: ignore[no-untyped-call]
        members, None if kind == "tuple" else known[kind]
    )
    return made


def _called(kernel: Dispatcher) -> Iterator[str]:
    """Kernels that one calls, and those that they call, itself among them."""
    waiting, seen = [kernel], set()
    while waiting:
        function = waiting.pop().py_func
        name = f"{function.__module__}.{function.__name__}"
        if name not in seen:
            seen.add(name)
            yield name
            values = map(function.__globals__.get, function.__code__.co_names)
            waiting.extend(v for v in values if isinstance(v, Dispatcher))


def _end_with_parent() -> None:
    """End this process when the one that started it is gone: its end of the pipe closes then."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    # The compiler makes millions of objects that live long: a tenth of its time went into looking
    # through them again and again.
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)
    mine, of_all = map(int, sys.argv[1:3])
    if sys.argv[3:] == [WATCHED]:
        threading.Thread(target=_end_with_parent, daemon=True).start()

    def _say(done: int, of: int) -> None:
        sys.stdout.write(f"{done} {of}\n")
        sys.stdout.flush()

    sys.stdout.write(f"{_compile(mine, of_all, _say)}\n")
