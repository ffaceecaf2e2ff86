"""What workers of one machine do once, each its share, before their first task."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from spl_batch.graph.work import Observer

QUICK_S: Final = 5.0
"""Time after which a user is told what is being waited for [s]."""

PATIENCE_S: Final = 600.0
"""Time after which tasks start all the same [s]."""


@dataclass(slots=True)
class Ahead:
    """Something to do before the first task.

    Parameters
    ----------
    work : callable
        Does a share, from 0, of so many, and says how much was left to do; sent to workers, so a
        function of a module.
    what : str
        What is being done, in words.
    took_s : float or None
        How long it took; None where nothing was left to do [s].
    """

    work: Callable[[int, int], int]
    what: str
    done: bool = False
    took_s: float | None = None

    def share_out(self, client: Any, workers: Sequence[str], observer: Observer) -> None:
        """Have each worker do its share, unless that is done.

        What fails is told and left to the tasks, which do it when they need it.

        Parameters
        ----------
        client : distributed.Client
            Whose workers they are.
        workers : sequence of str
            Their addresses.
        observer : Observer
            Told what takes long or fails.
        """
        if self.done:
            return
        self.done, begin_s = True, time.monotonic()
        from distributed import wait  # noqa: PLC0415 - slow import, only when used

        shares = [
            client.submit(self.work, k, len(workers), workers=[address], allow_other_workers=True,
                          pure=False, key=f"{self.work.__name__}-{k}")
            for k, address in enumerate(workers)
        ]  # fmt: skip
        try:
            wait(shares, timeout=QUICK_S)
        except TimeoutError:
            observer.noted(self.what)
            try:
                wait(shares, timeout=PATIENCE_S)
            except TimeoutError:
                observer.noted(
                    f"not finished after {PATIENCE_S:g} s, going on without: {self.what}"
                )
        if any(share.result() for share in shares if share.status == "finished"):
            self.took_s = time.monotonic() - begin_s
        for share in shares:
            if share.status == "error":
                observer.noted(f"{self.what}: {share.exception()}")
            share.cancel()
