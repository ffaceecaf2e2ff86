"""Duration of earlier runs, for what a later one finds finished.

A run that writes its report keeps its duration, earlier ones included, beside the receipts. One
that was stopped or killed leaves only its lines in ``log.jsonl``: it lasted from the first to the
last. What is linked from another output's store has its time beside it.
"""

import mmap
from collections.abc import Callable, Collection, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.report.run_record import recall
from spl_batch.engine.store.working_store import Store, read_json, write_json
from spl_batch.engine.watch.log_lines import event_of, seconds
from spl_batch.errors import DamagedError, StoreError

FIRST_EVENT: Final = b'"event": "RunStarted"'
"""What the log has in the first line of each run."""

WORK_EVENT: Final = b'"event": "Task'
"""What it has where a run does something; one that finds everything finished has no such line."""

_SHARED: Final = "shared.json"
"""File beside the receipts: duration of what is linked from another store."""

_End = Callable[[mmap.mmap, int, int], int]
"""Where a run's lines that count end, from those where they begin and end; -1 if none does."""


def log_bytes(output: Path) -> int:
    """Length of the log of an output folder [byte]."""
    log = _log(output)
    return log.stat().st_size if log.exists() else 0


def earlier_wall_s(output: Path) -> float | None:
    """Time that the runs before the one at work took; None where nothing tells [s]."""
    try:
        kept = recall(output)
        if kept.get("earlier_s", 0.0) is None:  # nor did that run know of those before it
            return None
        told, begin = [float(kept["wall_s"])], int(kept.get("log_bytes", 0))
        told += _shared(output, "more_s")
    except StoreError:  # they were stopped before their report
        told, begin = _shared(output, "wall_s"), 0
    before = _durations(_log(output), begin, _any_work)[:-1]  # the latest is at work
    told += [wall_s for wall_s in before if wall_s > 0]
    return sum(told) if told else None


def share_time(source: Path, target: Path, stages: Collection[str]) -> None:
    """Tell an output the duration, in another one, of what both have in common.

    Parameters
    ----------
    source, target : Path
        Folders of the results: where the work was done, and where it is wanted.
    stages : collection of str
        First stages of a run, whose results are shared.
    """
    marks = [f'"event": "TaskEnded", "stage": "{stage}"'.encode() for stage in stages]

    def last_of_them(whole: mmap.mmap, at: int, end: int) -> int:
        last = max(whole.rfind(mark, at, end) for mark in marks)
        return last if last < 0 else whole.find(b"\n", last, end) + 1 or end

    wall_s = sum(_durations(_log(source), 0, last_of_them))
    if wall_s > 0:
        told = _shared(target, "wall_s") if _reported(target) else []
        more_s = sum(wall_s - before_s for before_s in told)
        write_json(Store(target).local / _SHARED, {"wall_s": wall_s, "more_s": more_s})


def _shared(output: Path, what: str) -> list[float]:
    """What :func:`share_time` has told, if it has: in all, or more than a report knew of [s]."""
    try:
        return [float(read_json(Store(output).local / _SHARED)[what])]
    except DamagedError:
        return []


def _reported(output: Path) -> bool:
    """Whether a run of an output came to its report."""
    try:
        return bool(recall(output))
    except StoreError:
        return False


def _any_work(whole: mmap.mmap, at: int, end: int) -> int:
    return end if whole.find(WORK_EVENT, at, end) >= 0 else -1


def _durations(log: Path, begin: int, ends: _End) -> list[float]:
    """Durations of runs that were not forgotten; 0 for those that count for nothing [s]."""
    found: list[float] = []
    if not log.exists() or not log.stat().st_size:
        return found
    with log.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as whole:
        for at, stop in pairwise([*_starts(whole, begin), len(whole)]):
            started, end = _record(whole[at : whole.find(b"\n", at)]), ends(whole, at, stop)
            if started.get("anew"):
                found.clear()
            lasted = bool(started) and end >= 0
            found.append(_last_s(whole, at, end) - seconds(started) if lasted else 0.0)
    return found


def _starts(whole: mmap.mmap, begin: int) -> Iterator[int]:
    """Where the first line of each run begins [byte]."""
    found = whole.find(FIRST_EVENT, begin)
    while found >= 0:
        yield whole.rfind(b"\n", 0, found) + 1
        found = whole.find(FIRST_EVENT, found + 1)


def _last_s(whole: mmap.mmap, at: int, end: int) -> float:
    """Time of the last line between two bytes that a killed run has left whole [s]."""
    while True:
        line = max(whole.rfind(b"\n", at, end - 1) + 1, at)
        record = _record(whole[line:end])
        if record:
            return seconds(record)
        end = line


def _record(line: bytes) -> dict[str, Any]:
    """An event as it was logged; nothing of half a line, or of one that is damaged."""
    try:
        return event_of(line)
    except ValueError:
        return {}


def _log(output: Path) -> Path:
    return output / "log.jsonl"
