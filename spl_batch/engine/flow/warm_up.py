"""Preparation of one machine's workers: each does its share once, before its first task."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from spl_batch.engine.flow.job import Observer

TOPIC: Final = "spl-batch-ahead"
"""What workers tell of their steps under."""

TELL_S: Final = 0.5
"""A worker tells of its steps at most once in so long [s]."""

Work = Callable[[int, int, Callable[[int, int], None]], int]

PATIENCE_S: Final = 600.0
"""Time after which tasks start all the same [s]."""


@dataclass(slots=True)
class Ahead:
    """Something to do before the first task."""

    #: Does a share, from 0, of so many, and says how much was left to do. Workers are sent it, so
    #: it is a function of a module. Its third argument is told how many steps of how many are done.
    work: Work
    what: str  #: What is being done, in words.
    done: bool = False
    took_s: float | None = None  #: How long it took; None where nothing was left to do [s].
    steps: dict[int, tuple[int, int]] = field(default_factory=dict)

    def share_out(self, client: Any, workers: Sequence[str], observer: Observer) -> None:
        """Have each worker do its share, unless that is done; what fails is left to the tasks."""
        if self.done:
            return
        self.done, begin_s = True, time.monotonic()
        from distributed import wait  # noqa: PLC0415 - slow import, only when used

        def hear(event: tuple[float, tuple[int, int, int]]) -> None:
            share, done, of = event[1]
            if not self.steps:
                observer.noted(self.what)
            self.steps[share] = done, of
            if len(self.steps) == len(workers):  # else the whole would grow as they begin
                dones, ofs = zip(*self.steps.values(), strict=True)
                observer.compiled(sum(dones), sum(ofs))

        client.subscribe_topic(TOPIC, hear)
        shares = [
            client.submit(_work, self.work, k, len(workers), workers=[address],
                          allow_other_workers=True, pure=False, key=f"{self.work.__name__}-{k}")
            for k, address in enumerate(workers)
        ]  # fmt: skip
        with suppress(TimeoutError):
            wait(shares, timeout=PATIENCE_S)
        client.unsubscribe_topic(TOPIC)
        if any(share.result() for share in shares if share.status == "finished"):
            self.took_s = time.monotonic() - begin_s
        for share in shares:
            if share.status == "error":
                observer.noted(f"{self.what}: {share.exception()}")
            share.cancel()


def _work(work: Work, share: int, shares: int) -> int:
    """Do a share on a worker, and report now and then how far it is."""
    from distributed import get_worker  # noqa: PLC0415 - slow import, and it runs on workers only

    worker, told_s = get_worker(), -TELL_S

    def tell(done: int, of: int) -> None:
        nonlocal told_s
        if done == of or time.monotonic() - told_s >= TELL_S:
            told_s = time.monotonic()
            worker.log_event(TOPIC, (share, done, of))

    return work(share, shares, tell)
