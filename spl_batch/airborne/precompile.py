"""Compile kernels before they are needed, a share in each of some processes.

numba compiles a kernel when it is first called, and keeps the code on disk. In the first run on
a machine all workers would compile the same at the same time, each of them everything. A process
that has compiled keeps some 250 MiB of what the compiler needed; so processes of their own
compile, and workers load the code.
``signatures.json`` lists the kernels that the airborne chain calls, by the step that is the first
to call them, with the types of their arguments; ``python -m benchmarks.airborne.signatures``
writes it.
"""

import gc
import importlib
import json
import os
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from itertools import chain
from typing import Any, Final

from llvmlite.binding import get_host_cpu_name
from numba import types
from numba.core.dispatcher import Dispatcher

from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.tasks.step import stages
from spl_batch.formats.files.atomic import json_digest
from spl_batch.numerics.compiled import folder_of
from spl_batch.receivers import IMAGING

COMPILING: Final = (
    "getting the kernels ready; the first run on a machine compiles them, which usually takes half "
    "a minute, and later runs load them in seconds"
)
"""Note where a run compiles."""

OF_DETECTIONS: Final = "products.reflectance"
"""Room of the kernels that only an intensity raster of detections needs."""

Listed = Mapping[str, Sequence[str]]
"""Names of kernels by step."""


@cache
def signatures() -> dict[str, dict[str, list[list[Any]]]]:
    """Types of the arguments of each kernel, by step and name, as :func:`parse` takes them."""
    text = (files("spl_batch.airborne") / "signatures.json").read_text(encoding="utf-8")
    found: dict[str, dict[str, list[list[Any]]]] = json.loads(text)
    return found


def listed(workflow: Workflow | None = None, until: str | None = None) -> Listed:
    """Kernels that a workflow calls up to a stage, by step; all of them without."""
    order = stages(IMAGING)
    wanted = order[: order.index(until) + 1] if until else order
    detections = workflow is None or workflow.products.intensity == "detection"
    return {
        step: [name for name in names if detections or OF_DETECTIONS not in name]
        for step, names in signatures().items()
        if STEPS[step].stage in wanted
    }


def compiling(processes: int, workflow: Workflow | None = None, until: str | None = None) -> WarmUp:
    """Processes that compile the kernels of :func:`listed`; those that do so already, if any."""
    found = _compiling(json.dumps(listed(workflow, until)))
    found.processes, found.waited_s = min(processes, os.cpu_count() or 1), None
    return found


@cache
def _compiling(names: str) -> WarmUp:
    # numba's code is of one interpreter and for one kind of processor; machines that share a disk
    # may have several, whose code lies side by side.
    whose = sys.implementation.cache_tag, get_host_cpu_name(), names
    mark = folder_of(find) / f"{json_digest(code_version(IMAGING))}-{json_digest(whose)}.compiled"
    return WarmUp(partial(_command, names), [*json.loads(names)], COMPILING, mark, 1)


def compile_all(processes: int = 1) -> int:
    """Compile every kernel in some processes, and wait; kernels that were compiled [count]."""
    every = compiling(processes)
    every.begin()
    every.finish()
    return every.made


def _command(names: str, share: int, shares: int) -> tuple[str, ...]:
    """Command of a process that compiles: it finds the same files of this project as this one.

    ``python -m`` would take those of the folder that it is called in, such as a clone.
    """
    begin = f"import runpy, sys; sys.path[:] = {sys.path!r}; "
    begin += f"runpy.run_module({__name__!r}, run_name='__main__', alter_sys=True)"
    return sys.executable, "-c", begin, str(share), str(shares), names


def compile_share(share: int, shares: int, names: Listed) -> None:
    """Compile some of the kernels, or load what is compiled, and write how far that is.

    A line has the kernels of this share that are ready, those that they call among them; how many
    it has; how many were compiled and not loaded [count]; and the number of the step.
    """
    mine = divided(names, shares)[share]
    needed = {name: set(_called(find(name))) for name in {*chain.from_iterable(mine.values())}}
    whole, ready, compiled = len(set().union(*needed.values())), set[str](), 0
    for number, step in enumerate(mine):
        # Those that call few others first: each part is short then, and progress moves evenly.
        for name in reversed(mine[step]):
            _say(len(ready), whole, compiled, number)
            ready |= needed[name]
            kernel = find(name)
            for stored in signatures()[step][name]:
                before = sum(kernel.stats.cache_misses.values())
                kernel.compile(parse(stored, kernel))
                compiled += sum(kernel.stats.cache_misses.values()) - before
    _say(whole, whole, compiled, len(mine))


def _say(*numbers: int) -> None:
    sys.stdout.write(" ".join(map(str, numbers)) + "\n")
    sys.stdout.flush()


def divided(names: Listed, shares: int) -> list[dict[str, list[str]]]:
    """Shares of about equal cost up to each step; kernels that call the same are kept together."""
    loads: list[set[str]] = [set() for _ in range(shares)]
    found: list[dict[str, list[str]]] = [{step: [] for step in names} for _ in range(shares)]
    for step, of_step in names.items():
        called = {name: frozenset(_called(find(name))) for name in of_step}
        for name in sorted(called, key=lambda name: (-len(called[name]), name)):
            added = [len(called[name] - load) for load in loads]
            best = min(range(shares), key=lambda k: len(loads[k]) + 2 * added[k])
            loads[best] |= called[name]
            found[best][step].append(name)
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
    threading.Thread(target=_end_with_parent, daemon=True).start()
    compile_share(int(sys.argv[1]), int(sys.argv[2]), json.loads(sys.argv[3]))
