"""One task: read, run the stage, write atomically, leave a receipt.

What there is to do is declared by :mod:`spl_batch.engine.tasks.step`.
"""

import hashlib
import sys
import time
import traceback
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from pathlib import Path
from typing import Any, Final

import spl_batch
from spl_batch import __version__
from spl_batch.engine.store.working_store import forget_receipt, read_receipt, write_receipt
from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.spare_memory import give_back
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Job, Outcome, Receipt, Task
from spl_batch.errors import (
    INTERRUPTED,
    DamagedError,
    InputError,
    SplBatchError,
    StoppedError,
    one_line,
)
from spl_batch.formats.files.atomic import checksum, is_as_written, json_digest, size, stop_if_full
from spl_batch.imports import content_hash, data_files, imported, module_file
from spl_batch.receivers import HOMES, steps

RASTER: Final = ".tif"
"""How names of rasters end, whose bytes carry no checksum."""

DECISIVE: Final = (
    "laspy",
    "lazrs",
    "numba",
    "numpy",
    "pyproj",
    "rasterio",
    "scikit-image",
    "scipy",
    "shapely",
    "zarr",
)
"""Libraries whose versions can change a result."""

PACKAGE: Final = Path(spl_batch.__file__).parent
"""Folder of the project's modules."""

LIBRARIES: Final = (*DECISIVE, "dask", "distributed", "h5py", "pyarrow", "pyogrio")
"""Libraries whose versions a report lists."""


@cache
def library_version(name: str) -> str:
    """Version of a library; "missing" where it is not installed, as some need not be."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


@cache
def build_version() -> str:
    """Version of the project and hash of its whole package, the same for all receivers."""
    kinds = {".j2", ".js", ".json", ".py", ".yaml"}
    files = (file for file in PACKAGE.rglob("*") if file.suffix in kinds)
    return f"{__version__}+{content_hash(files)[:16]}"


@cache
def code_version(receiver: str) -> str:
    """Version of the project, hash of the code and of the libraries that decide results.

    ``receiver``: a workflow's ``kind``; code that its tasks do not import changes no result.
    """
    digest = hashlib.blake2b(content_hash(task_files(receiver)).encode(), digest_size=8)
    for name in DECISIVE:
        digest.update(f"{name} {library_version(name)}".encode())
    return f"{__version__}+{digest.hexdigest()}"


def task_files(receiver: str) -> frozenset[Path]:
    """Modules that a receiver's tasks import, directly or not, and the tables that these read."""
    listed = HOMES[receiver].steps.partition(":")[0]
    homes = {listed, *chain.from_iterable(step.modules for step in steps(receiver).values())}
    files = (module_file(name) for name in (__name__, *homes))
    modules = frozenset[Path]().union(*(imported(path) for path in files if path is not None))
    return modules.union(*map(data_files, modules))


def task_key(task: Task, context: RunContext[Any], digests: Iterable[str | None]) -> str:
    """Hash of everything that a task's result depends on.

    ``digests``: digests of the receipts that the task needs, in the order of ``task.needs``.
    """
    settings = _settings(task.kind, context)
    parts = [task.kind, task.name, task.args, settings, context.crs_wkt, context.code]
    return json_digest([*parts, list(digests)], finite=False)


_SETTINGS: Final[dict[str, tuple[Any, dict[str, Any]]]] = {}
"""Workflow and settings of a step, by its name: dumped once, not for each of a million tasks. The
latest alone, as a worker gets a workflow of its own with each task."""


def _settings(step: str, context: RunContext[Any]) -> dict[str, Any]:
    """Parts of the workflow that a step's results depend on."""
    workflow = context.workflow
    known = _SETTINGS.get(step)
    if known is None or known[0] is not workflow:
        content = workflow.model_dump(mode="json")
        declared: Step = steps(workflow.kind)[step]
        known = workflow, {path: _at(content, path) for path in declared.settings}
        _SETTINGS[step] = known
    return known[1]


def _step(task: Task, context: RunContext[Any]) -> Step:
    found: Step = steps(context.workflow.kind)[task.kind]
    return found


def finished(task: Task, key: str, context: RunContext[Any]) -> Receipt | None:
    """Receipt of a task that needs no doing: it matches, and its outputs are there.

    Outputs are known by their size. Files of the store are verified where they are read. The
    checksum of a delivered file, and of any raster, is looked at if it was written to after the
    task was done.
    """
    receipt = read_receipt(context.store, task.kind, task.name)
    if receipt is None or receipt.failed or receipt.key != key:
        return None
    sizes, times = receipt.sizes, receipt.written_ns
    same = (
        is_as_written(context.store.named(name), sizes.get(name, -1), times.get(name), content)
        for name, content in receipt.outputs.items()
    )
    return receipt if all(same) else None


def run_task(task: Task, key: str, context: RunContext[Any]) -> Receipt:
    """Do one task and leave its receipt, also when it fails: with a reason where the task failed.

    What concerns every task, such as a full disk, raises StoppedError.
    """
    # From here on an earlier receipt's outputs may be overwritten: it must not speak for them if
    # this task is killed half-way.
    forget_receipt(context.store, task.kind, task.name)
    start = time.perf_counter()
    try:
        give_back()
        function = _step(task, context).loaded()
        start = time.perf_counter()  # what loads a module for the first time is no work of a task
        receipt = _receipt(task, key, context, function(task.args, context), start)
    except (StoppedError, KeyboardInterrupt):
        raise
    except BaseException as error:
        if INTERRUPTED.is_set():  # what compiles has lost the exception and fails by that
            raise KeyboardInterrupt from error
        stop_if_full(error, context.output)
        receipt = _failed(task, key, error, time.perf_counter() - start)
    write_receipt(context.store, receipt)
    return receipt


def _receipt(
    task: Task, key: str, context: RunContext[Any], produced: Produced, start: float
) -> Receipt:
    """Receipt of a task that was done."""
    paths = {context.store.name_of(path): path for path in produced.outputs}
    outputs = {name: checksum(path) for name, path in paths.items()}
    looked_at = [n for n in paths if n.endswith(RASTER) or not n.startswith("store/")]
    return Receipt(
        task.kind,
        task.name,
        key,
        json_digest([outputs, produced.facts]),
        "",
        outputs,
        produced.facts,
        produced.points,
        time.perf_counter() - start,
        _peak_rss_mb(),
        {name: size(path) for name, path in paths.items()},
        {name: paths[name].stat().st_mtime_ns for name in looked_at},
        produced.inputs,
    )


def _failed(task: Task, key: str, error: BaseException, wall_s: float) -> Receipt:
    """Receipt of a task that has raised something."""
    if isinstance(error, DamagedError):
        return failure(task, key, error.fault, wall_s, code="F03", damaged=error.path)
    codes = ((InputError, "F01"), (MemoryError, "F02"))
    code = next((code for kind, code in codes if isinstance(error, kind)), "F04")
    reason = str(error) if isinstance(error, SplBatchError) else one_line(error)
    trace = "".join(traceback.format_exception(error))
    return failure(task, key, reason, wall_s, code=code, trace=trace)


def do(job: Job, context: RunContext[Any], needed: Iterable[Outcome] = ()) -> Outcome:
    """Do a job, unless it turns out to be finished, or to miss what it cannot be done without.

    ``needed``: what has come of the jobs that it waited for, and others of its batch.
    """
    task, key = job.task, job.key
    if not key:
        own = [one for one in needed if one.need in job.open]
        if any(one.again is not None for one in own):
            return Outcome(job.need, None, again=job.tried)
        made = {o.need: o.receipt.digest for o in own if o.receipt and not o.receipt.failed}
        found = {**job.found, **made}
        bound = _step(task, context).bound(task, found)
        if bound is None:
            return Outcome(job.need, None)
        task, key = bound, task_key(bound, context, map(found.get, bound.needs))
        receipt = finished(task, key, context)
        if receipt is not None:
            return Outcome(job.need, receipt, found=True)
    return Outcome(job.need, run_task(task, key, context))


def failure(
    task: Task,
    key: str,
    reason: str,
    wall_s: float = 0.0,
    *,
    code: str = "F04",
    damaged: str = "",
    trace: str = "",
) -> Receipt:
    """Receipt of a task that was not done.

    Its facts have its code, the file of the store that is at fault, and where in the code it
    failed.
    """
    line = " ".join(reason.split()) or "failed without a message"
    facts = {"code": code, "damaged": damaged, "traceback": trace}
    facts = {name: value for name, value in facts.items() if value}
    return Receipt(task.kind, task.name, key, "", line, {}, facts, 0, wall_s, _peak_rss_mb())


def _at(content: object, path: str) -> object:
    for part in path.split("."):
        content = content[part] if isinstance(content, dict) else None
    return content


def _peak_rss_mb() -> float:
    # The kernel's record of this program; ru_maxrss also counts the one that started it.
    with suppress(OSError, StopIteration), Path("/proc/self/status").open() as lines:
        return int(next(x for x in lines if x.startswith("VmHWM:")).split()[1]) / (1 << 10)
    if sys.platform == "win32":
        import psutil  # noqa: PLC0415 - for Windows alone

        return psutil.Process().memory_info().peak_wset / (1 << 20)
    import resource  # noqa: PLC0415 - Windows has none

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)
