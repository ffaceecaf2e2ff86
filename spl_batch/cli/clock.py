"""How long a command takes, from Enter to prompt: imports count, and so do workers that end."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import click

SLOW_S: Final = 2.0
"""Time after which a command that prints nothing else says what it is doing [s]."""

_FIELDS_BEFORE_START: Final = 19
"""Fields of ``/proc/PID/stat`` between the name of the program and its start [proc(5)]."""


def process_age_s() -> float:
    """How long this process has been running [s]."""
    try:
        stat = Path("/proc/self/stat").read_text(encoding="utf-8")
        # The name, in parentheses, may hold spaces.
        ticks = int(stat.rpartition(")")[2].split()[_FIELDS_BEFORE_START])
        now_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    except (OSError, AttributeError):  # only Linux has them
        import psutil  # noqa: PLC0415 - slow import, only where it is needed

        return time.time() - float(psutil.Process().create_time())
    return now_s - ticks / os.sysconf("SC_CLK_TCK")


class CommandClock:
    """Measures one command.

    Parameters
    ----------
    age_s : float
        How long ago it began [s].
    """

    def __init__(self, age_s: float = 0.0) -> None:
        self._began_s = time.monotonic() - age_s

    @property
    def took_s(self) -> float:
        """Time since its beginning [s]."""
        return time.monotonic() - self._began_s


@contextmanager
def saying_if_slow(text: str, after_s: float = SLOW_S) -> Iterator[Callable[[], None]]:
    """Say on standard error what is done if it is not done soon; call what is given once it is."""
    # Named, as rich puts another in its place while a view is drawn; click looks behind that.
    timer = threading.Timer(after_s, lambda: click.echo(f"info: {text}", sys.stderr, err=True))
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()
