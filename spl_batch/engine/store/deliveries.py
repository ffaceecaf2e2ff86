"""Record of the files that runs have delivered, so that nothing else is deleted or replaced.

``delivered.json`` lies beside the results and outlives the working store. It names the survey that
the output belongs to and every file that its runs have delivered, with size, time of writing and
checksum. A file is named there before it is written: a run that was killed finds its own files
again.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.store.working_store import read_json, read_receipts, write_json
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import delivering
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import DamagedError, named
from spl_batch.formats.files.atomic import checksum

RECORD: Final = "delivered.json"
"""Name of the record, below the output."""

_KEPT: Final = ".kept"
"""How the name of a file ends that a run has moved aside instead of replacing it."""

LISTED: Final = 20
"""Files that a line names of those that are deleted [count]."""

Stamp = list[Any]
"""Size [byte], time of writing [ns since 1970] and checksum of a delivered file."""


class Deliveries:
    """The files that the runs of an output folder have written.

    Attributes
    ----------
    survey : mapping or None
        ``name`` and ``inputs`` of the survey that the output belongs to; None where no run has
        recorded any.
    files : dict of str to list
        Stamp of each file, by its name below the output.
    begun : set of str
        Names of files whose writing has begun and of whose end nothing is known.
    spared : list of str
        Names of files that :meth:`withdraw` has left, as tasks failed.
    """

    def __init__(self, context: RunContext[Any]) -> None:
        self.output = context.output
        self._kinds = delivering(context.workflow.kind)
        self.survey: Mapping[str, Any] | None = None
        self.files: dict[str, Stamp] = {}
        self.begun: set[str] = set()
        self.spared: list[str] = []
        kept: dict[str, Any] = {}
        try:
            kept = read_json(self.output / RECORD)
            self.survey, self.files = kept["survey"], kept["files"]
            self.begun = set(kept["begun"])
        except DamagedError:  # none yet, or one that nobody can trust: receipts tell instead
            pass
        if not kept or self.begun:
            self._take_receipts(context)

    def _take_receipts(self, context: RunContext[Any]) -> None:
        """Learn from receipts what was delivered without being recorded, as its run was killed."""
        for kind in self._kinds:
            for receipt in read_receipts(context.store, kind):
                if not receipt.failed:
                    self.wrote(receipt)

    def save(self) -> None:
        """Write the record."""
        content = {"survey": self.survey, "files": self.files, "begun": sorted(self.begun)}
        write_json(self.output / RECORD, content)

    def begin(self, survey: Mapping[str, Any]) -> None:
        """Record whose the output is, before anything is written."""
        self.survey = survey
        self.save()

    def make_room(self, names: Iterable[str]) -> Iterator[str]:
        """Get ready for files that are about to be written; what is not ours is moved aside.

        Parameters
        ----------
        names : iterable of str
            Names of files below the output; one that ends in ``/`` stands for all in a folder.

        Yields
        ------
        str
            What was moved, and where to.
        """
        wanted = set(names)
        for given in sorted(wanted):
            folder = self.output / given
            for path in sorted(folder.glob("*")) if given.endswith("/") else [folder]:
                name = path.relative_to(self.output).as_posix()
                if not path.is_file() or self._is_own(name):
                    continue
                kept = _free_name(path)
                path.rename(kept)
                yield (
                    f"{name} is not as a run here has written it: kept as "
                    f"{kept.relative_to(self.output).as_posix()}, the result is written anew"
                )
        self.begun |= {name for name in wanted if not name.endswith("/")}
        if wanted:
            self.save()

    def wrote(self, receipt: Receipt) -> None:
        """Take note of what a task has delivered, or is known to have."""
        for name, content in receipt.outputs.items() if receipt.kind in self._kinds else ():
            # A map for the report lies in the store.
            if name in receipt.written_ns and not name.removeprefix("./").startswith("store/"):
                self.files[name] = [receipt.sizes[name], receipt.written_ns[name], content]
                self.begun.discard(name)

    def withdraw(self, ledger: Ledger[Any, Any], *, failed: bool) -> Iterator[str]:
        """Delete what earlier runs delivered and this one does not vouch for.

        A file of an input that is gone, or can no longer be read, would pass for a result. Only
        files that are as they were written are deleted, when they have been told. Where tasks
        failed nobody knows what they would have made: only what has another name now is deleted.

        Parameters
        ----------
        ledger : Ledger
            With the files that this run has made, or found finished.
        failed : bool
            Whether a task of this run failed.

        Yields
        ------
        str
            What is kept, and why; what has another name, and what is deleted, a line each.
        """
        finished = chain.from_iterable(ledger.of(kind).values() for kind in self._kinds)
        current = {name for receipt in finished for name in receipt.outputs}
        gone: list[str] = []
        for name in sorted((self.files.keys() | self.begun) - current):
            path = self.output / name
            if path.exists() and self._as_written(name):
                gone.append(name)
            elif path.exists():
                yield (
                    f"kept, as it is not what an earlier run wrote: {name}; this run makes no such "
                    "file, delete it if it is of no use"
                )
        now = _other_names(gone, current)
        if now:
            listed = named([f"{new} was {old}" for old, new in now.items()], LISTED)
            yield f"renamed, as the inputs share other folders than before: {listed}"
        left = [name for name in gone if name not in now]
        self.spared = left if failed else []
        if left and not failed:
            it = "it" if len(left) == 1 else "them"
            yield (
                f"deleted, as an earlier run made {it} and this one does not: {named(left, LISTED)}"
            )
        stays = current.union(self.spared)
        for name in gone:
            if name not in stays:
                (self.output / name).unlink(missing_ok=True)
        self.files = {name: stamp for name, stamp in self.files.items() if name in stays}
        self.begun &= current
        self.save()

    def _is_own(self, name: str) -> bool:
        """Whether a run may replace a file: it is as written, or a killed run left it."""
        return name in self.begun or self._as_written(name)

    def _as_written(self, name: str) -> bool:
        path, stamp = self.output / name, self.files.get(name)
        if stamp is None:
            return False
        size, written_ns, content = stamp
        there = path.stat()
        if there.st_size != size:
            return False
        return bool(there.st_mtime_ns == written_ns or checksum(path) == content)


def _other_names(gone: Iterable[str], current: Iterable[str]) -> dict[str, str]:
    """What clouds that are gone are called now: the same below more or fewer folders."""
    there: dict[tuple[str, str], list[str]] = {}
    for name in current:
        there.setdefault((Path(name).parts[0], Path(name).name), []).append(name)
    found: dict[str, list[str]] = {}
    for old in gone:
        top, last = Path(old).parts[0], Path(old).name
        for new in there.get((top, last), ()) if old.endswith(".laz") else ():
            short, long = sorted((old.removeprefix(top), new.removeprefix(top)), key=len)
            if long.endswith(short):
                found.setdefault(new, []).append(old)
    return {olds[0]: new for new, olds in found.items() if len(olds) == 1}


def _free_name(path: Path) -> Path:
    """A name beside a file that nothing has."""
    number, free = 1, path.with_name(path.name + _KEPT)
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}{_KEPT}{number}")
    return free
