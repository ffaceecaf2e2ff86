"""How long earlier runs took for what a later one finds finished.

A run that writes its report keeps its duration, earlier ones included, beside the receipts. One
that was stopped or killed leaves its lines in ``log.jsonl`` alone: it lasted from its first line
to its last.
"""

import json
import mmap
from collections.abc import Iterator
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from spl_batch.errors import StoreError
from spl_batch.runner.remember import recall

FIRST_EVENT: Final = b'"event": "RunStarted"'
"""What the log has in the first line of each run."""

WORK_EVENT: Final = b'"event": "Task'
"""What it has where a run does something; one that finds everything finished has no such line."""


def log_bytes(output: Path) -> int:
    """Length of the log of an output folder [byte]."""
    log = _log(output)
    return log.stat().st_size if log.exists() else 0


def earlier_wall_s(output: Path) -> float | None:
    """Time that the runs before the one at work took; None where nothing tells [s].

    Parameters
    ----------
    output : Path
        Folder of the results.
    """
    try:
        kept = recall(output)
        if kept.get("earlier_s", 0.0) is None:  # nor did that run know of those before it
            return None
        told, begin = [float(kept["wall_s"])], int(kept.get("log_bytes", 0))
    except StoreError:  # they were stopped before their report
        told, begin = [], 0
    if _log(output).exists():
        told += _durations(_log(output), begin)
    return sum(told) if told else None


def _durations(log: Path, begin: int) -> list[float]:
    """Durations of the runs before the latest that did something and were not forgotten [s]."""
    found: list[float] = []
    with log.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as whole:
        for at, end in pairwise(_starts(whole, begin)):
            started = _record(whole[at : whole.find(b"\n", at)])
            if started.get("anew"):
                found.clear()
            if started and whole.find(WORK_EVENT, at, end) >= 0:
                found.append(_last_s(whole, at, end) - _seconds(started))
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
            return _seconds(record)
        end = line


def _record(line: bytes) -> dict[str, Any]:
    """An event as it was logged; nothing of half a line."""
    try:
        record: dict[str, Any] = json.loads(line)
    except ValueError:
        return {}
    return record


def _seconds(record: dict[str, Any]) -> float:
    return datetime.fromisoformat(record["time"]).timestamp()


def _log(output: Path) -> Path:
    return output / "log.jsonl"
