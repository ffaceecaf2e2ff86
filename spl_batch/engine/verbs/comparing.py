"""Several methods on the same inputs, and how they differ.

Each method gets a folder of its own, ``OUTPUT/compare/METHOD``, with everything that a run gives.
What methods have in common is done once, in the store of ``OUTPUT`` itself (or was, by an earlier
run), and linked into theirs. Receipts decide what is left to do: a comparison that was stopped goes
on where it was, and one more method costs that method alone.

What methods there are, and how they are described, is each receiver's own: it fills in
:class:`Methods`.
"""

import json
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.report.parts import Performance
from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.engine.store.output_lock import locked
from spl_batch.engine.store.working_store import Store, forget_receipt, read_receipt, read_receipts
from spl_batch.engine.verbs.output_owner import usable
from spl_batch.engine.verbs.planning import prepare
from spl_batch.engine.verbs.running import run
from spl_batch.engine.watch.events import Listener, Note, ignore
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import real_path, replacing, size
from spl_batch.formats.files.remote import copy_object, is_remote
from spl_batch.receivers import HOMES, comparison, steps

FOLDER: Final = "compare"
"""Where the methods' results lie, below the output folder."""


@dataclass(frozen=True, slots=True)
class Methods:
    """What a receiver fills in whose methods can be compared."""

    known: str  #: Names of all methods, as a message lists them.
    #: Of a method's name and the workflow: ``key.path=value`` that make a run one of this method,
    #: or None where there is no such method. It raises where something that it needs is missing.
    keys: Callable[[str, Any], Sequence[str] | None]
    #: Of the names asked for: last stage of what these methods share, which is done first.
    until: Callable[[Collection[str]], str]
    #: Of the workflow and a method's name: stages and steps of the workflow's own run of which this
    #: method can use what is finished.
    share: Callable[[Any, str], Collection[str]]
    #: Of the output folder and reports by method: writes ``compare.html`` and ``compare.json`` and
    #: returns their figures, with ``methods``.
    write: Callable[[Path, Mapping[str, Any]], Any]
    row: Callable[[Any, Any], tuple[str, ...]]  #: Of that and a method: what the console shows.
    titles: tuple[str, ...]  #: Heads of the console's columns.


@dataclass(frozen=True, slots=True)
class ComparisonResult:
    """How a comparison ended."""

    exit_status: int  #: 0 all done, 1 some files or tasks failed.
    output: Path  #: Folder that holds ``compare.html`` and ``compare.json``.
    report: Any  #: What they have; ``methods`` in the order asked for.
    #: Heads of the columns that the console shows, and a row for each method, its name first.
    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def compare(
    workflow: Path | str,
    methods: str | Sequence[str],
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> ComparisonResult:
    """Run several methods on the same inputs.

    Parameters
    ----------
    methods : str or sequence of str
        At least two, separated by commas, e.g. ``"vsaes:published,voxel"`` of an airborne survey,
        ``"likelihood,mdbscan"`` of photon profiles; the first is what the others are compared with.
    workflow, workers, memory, overrides, listener : optional
        As :func:`~spl_batch.engine.verbs.running.run` takes them, and so are the errors.

    Returns
    -------
    ComparisonResult
    """
    path = Path(workflow)
    settings = load_any(path, overrides)
    found: Methods | None = comparison(settings.kind)
    if found is None:
        known = ", ".join(name for name, home in HOMES.items() if home.compare)
        raise WorkflowError(f"{path}: kind: {settings.kind} has one method; compare is for {known}")
    output = real_path(real_path(path).parent / settings.output)
    url = settings.outputs.store
    keys = {}
    for name, own in _chosen(methods, found, settings).items():
        store = store_of(output, name, url)
        keys[name] = [*overrides, f"output={json.dumps(str(store.output))}", *own]
        if url:
            keys[name].append(f"outputs.store={json.dumps(store.url)}")
        load_any(path, keys[name])
    usable(prepare(path, overrides, memory=memory, workers=workers))  # before the lock's file
    process = partial(run, path, workers=workers, memory=memory, listener=listener)
    source, tasks = Store(output, url), steps(settings.kind)
    with locked(output / FOLDER):
        # What the methods share is finished first, under the workflow's own settings.
        status = process(until=found.until(keys), overrides=overrides).exit_status
        reports = {}
        for count, (name, own) in enumerate(keys.items(), start=1):
            listener(Note("info", f"{name}, {count} of {len(keys)}"))
            target = store_of(output, name, url)
            names = found.share(settings, name)
            share_finished(source, target, [k for k, s in tasks.items() if {k, s.stage} & {*names}])
            result = process(overrides=own)
            status = max(status, result.exit_status)
            if result.report is not None:
                reports[name] = result.report
        if not reports:
            raise WorkflowError(f"{output}: no method has finished; nothing can be compared")
        report = found.write(output, reports)
    rows = tuple(found.row(report, method) for method in report.methods)
    return ComparisonResult(status, output, report, found.titles, rows)


def _chosen(
    methods: str | Sequence[str], found: Methods, settings: Any
) -> dict[str, Sequence[str]]:
    """Keys of each method that is asked for, by name; two at the least."""
    chosen = {}
    for name in listed(methods):
        own = found.keys(name, settings)
        if own is None:
            raise WorkflowError(f"--methods: no method {name!r}; there are {found.known}")
        chosen[name] = own
    if len(chosen) < 2:
        raise WorkflowError(f"--methods: name two or more of {found.known}, separated by commas")
    return chosen


def listed(methods: str | Sequence[str]) -> list[str]:
    """Names of a list such as ``"likelihood,mdbscan"``, each once, in the order given."""
    names = methods.split(",") if isinstance(methods, str) else methods
    return list(dict.fromkeys(name.strip() for name in names if name.strip()))


def folder_of(name: str) -> str:
    """Where a method's results lie, below the output folder."""
    return f"{FOLDER}/{name.replace(':', '-')}"


def store_of(output: Path, name: str, url: str | None) -> Store:
    """Working store of a method: each has one of its own."""
    place = folder_of(name)
    return Store(output / place, f"{url.rstrip('/')}/{place}" if url else None)


def share_finished(source: Store, target: Store, kinds: Iterable[str]) -> None:
    """Make what one store has finished of some kinds of task known to another."""
    for receipt in (receipt for kind in kinds for receipt in read_receipts(source, kind)):
        need = receipt.kind, receipt.name
        if receipt.failed or read_receipt(target, *need) == receipt:
            continue
        forget_receipt(target, *need)
        paths = {source.named(name): target.named(name) for name in receipt.outputs}
        if all(size(path) >= 0 for path in paths):
            # The receipt comes last: until then nothing vouches for the outputs.
            for path, name in {**paths, source.receipt(*need): target.receipt(*need)}.items():
                _link(path, name)


def _link(path: Path, name: Path) -> None:
    """Give a file of a store a name in another; files there are only replaced."""
    if is_remote(path):
        copy_object(path, name)
        return
    with replacing(name, durable=False) as temporary:
        try:
            os.link(path, temporary)
        except OSError:
            # Another file system, or one without links; a full disk shows itself here again.
            shutil.copy2(path, temporary)


def per_million(cost: Performance, stage: str, count: int) -> float | None:
    """Seconds of a stage for a million of what was processed."""
    spent = cost.stages.get(stage)
    return 1e6 * spent.wall_s / count if spent and spent.wall_s and count else None
