"""Freed memory that a worker has kept, given back where its limit is near.

A worker keeps what it frees for what it allocates next, which saves a tenth of the time. But what
lies in pieces fits nothing large: a task that holds 500 MiB needs 600 where others were done
before. So tasks give it back before each thing that needs much, where the process holds more than
half of its limit.
"""

import ctypes
from typing import Final

import psutil

NEAR_SHARE: Final = 0.5
"""Part of the limit up to which a worker keeps what it has freed."""

_limit: int | None = None


def limit_memory(limit: int | None) -> None:
    """Set the memory limit of this process [byte]; None for none."""
    global _limit  # noqa: PLW0603 - a limit is one of the process
    _limit = limit


def give_back() -> None:
    """Give freed memory back to the system where the limit is near, if the C library can."""
    if _limit and psutil.Process().memory_info().rss > NEAR_SHARE * _limit:
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
