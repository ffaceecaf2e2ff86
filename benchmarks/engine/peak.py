"""Highest memory of this process while something runs."""

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path


def resident_bytes() -> int:
    """Memory of this process that is in use now [byte]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096


class Peak:
    """Highest resident memory while a block runs, looked at every millisecond."""

    def __init__(self) -> None:
        self.before = self.highest = resident_bytes()
        self._done = threading.Event()

    @contextlib.contextmanager
    def watching(self) -> Iterator["Peak"]:
        """Watch while the block runs."""
        watcher = threading.Thread(target=self._watch, daemon=True)
        watcher.start()
        try:
            yield self
        finally:
            self._done.set()
            watcher.join()

    def _watch(self) -> None:
        while not self._done.is_set():
            self.highest = max(self.highest, resident_bytes())
            time.sleep(0.001)
