"""Preparation of one machine's workers: each does its share once, before its first task."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from spl_batch.engine.flow.job import Observer
from spl_batch.engine.watch.events import Compiling, Note

TOPIC: Final = "spl-batch-warm-up"
"""What workers report their steps under."""

REPORT_S: Final = 0.5
"""A worker reports its steps at most once in so long [s]."""

PATIENCE_S: Final = 600.0
"""Time after which tasks start all the same [s]."""

Work = Callable[[int, int, Callable[[int, int], None]], int]
"""Does a share, from 0, of so many, and returns how much was left to do. Its third argument takes
how many steps of how many are done."""


@dataclass(slots=True)
class WarmUp:
    """Something to do before the first task."""

    work: Work  #: A function of a module, as workers are sent it.
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
                observer.tell(Note("info", self.what))
            self.steps[share] = done, of
            if len(self.steps) == len(workers):  # else the whole would grow as they begin
                dones, ofs = zip(*self.steps.values(), strict=True)
                observer.tell(Compiling(sum(dones), sum(ofs)))

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
                observer.tell(Note("info", f"{self.what}: {share.exception()}"))
            share.cancel()


def _work(work: Work, share: int, shares: int) -> int:
    """Do a share on a worker, and report now and then how far it is."""
    from distributed import get_worker  # noqa: PLC0415 - slow import, and it runs on workers only

    worker, reported_s = get_worker(), -REPORT_S

    def report(done: int, of: int) -> None:
        nonlocal reported_s
        if done == of or time.monotonic() - reported_s >= REPORT_S:
            reported_s = time.monotonic()
            worker.log_event(TOPIC, (share, done, of))

    return work(share, shares, report)
