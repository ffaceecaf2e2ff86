"""Jobs flow to the workers of a dask scheduler, receipts flow back.

A task that fails is tried once more, on another worker. The scheduler runs the tasks of a lost
worker elsewhere; a task that has lost several workers in a row fails, with the nannies' reason.
"""

import contextlib
import queue
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from spl_batch.engine.flow.job import Footing, Job, Observer, OnReceipt, work
from spl_batch.engine.flow.warm_up import Ahead
from spl_batch.engine.store.working_store import write_receipt
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.runner import failure
from spl_batch.engine.tasks.task import Receipt, WorkersSeen
from spl_batch.errors import StoppedError

IN_FLIGHT_PER_THREAD: Final = 3
"""Tasks handed to the scheduler for each worker thread [count]."""

LARGE_POINTS: Final = 4_000_000
"""Points from which on a task waits for the first free worker, not behind another task [count]: the
largest come first, so that all end together."""

TICK_S: Final = 2.0
"""How often the workers are looked at [s]; less often where they are hundreds."""

PATIENCE_S: Final = 300.0
"""How long local workers may all be gone before the run stops [s]."""

"""First word of the reason of a task that took more memory than its workers had."""

_MEMORY_TOPIC: Final = "worker-restart-memory"
"""Where a nanny says that it has ended its worker for its memory."""


@dataclass(frozen=True, slots=True)
class OnDask:
    """Does jobs on the workers of a dask scheduler."""

    client: Any
    observer: Observer
    footing: Footing
    local: bool
    ahead: Ahead | None = None

    def make_ready(self) -> None:
        """Have local workers do what comes before the first task."""
        if self.local and self.ahead is not None and not self.ahead.done:
            self.ahead.share_out(self.client, sorted(workers_of(self.client)), self.observer)

    def run(self, jobs: Iterable[Job], context: RunContext[Any], on_receipt: OnReceipt) -> None:
        """Do jobs as workers become free, those that join later included.

        Raises
        ------
        StoppedError
            If the scheduler is lost or a task met something that concerns everything.
        """
        flow = _Flow(self, context, iter(jobs))
        try:
            for receipt in flow.receipts():
                on_receipt(receipt)
        finally:
            flow.close()


@dataclass(slots=True)
class _Try:
    """A job on its way."""

    job: Job
    number: int = 1
    began_on: str = ""
    others: tuple[str, ...] = ()


@dataclass(slots=True)
class _Flow:
    """Jobs going out, receipts coming in."""

    to: OnDask
    context: RunContext[Any]
    jobs: Iterator[Job]
    waits: Job | None = None
    signs: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)
    running: dict[Any, _Try] = field(default_factory=dict)
    by_name: dict[tuple[str, str], _Try] = field(default_factory=dict)
    threads: Mapping[str, int] = field(default_factory=dict)
    starved: set[str] = field(default_factory=set)
    waiting: bool = False
    looked_s: float = -1e9
    populated_s: float = field(default_factory=time.monotonic)

    def receipts(self) -> Iterator[Receipt]:
        """Receipts of all jobs, as they come."""
        client = self.to.client
        client.subscribe_topic(self._topic, lambda event: self.signs.put(event[1]))
        client.subscribe_topic(_MEMORY_TOPIC, lambda event: self.signs.put(event[1]))
        self._look()
        while True:
            self._feed()
            if not self.running:
                return
            with contextlib.suppress(queue.Empty):
                receipt = self._take(self.signs.get(timeout=TICK_S))
                if receipt is not None:
                    yield receipt
            self._look()

    def close(self) -> None:
        """Let go of jobs that are still on their way."""
        for future in self.running:
            with contextlib.suppress(Exception):
                future.cancel()
        with contextlib.suppress(Exception):
            self.to.client.unsubscribe_topic(self._topic)

    @property
    def _topic(self) -> str:
        """Where this client's tasks say that they begin."""
        return f"spl_batch-{self.to.client.id}"

    def _feed(self) -> None:
        """Hand out jobs until enough are in flight for the workers that there are."""
        threads = max(sum(self.threads.values()), 1)
        while True:
            self.waits = self.waits or next(self.jobs, None)
            if self.waits is None:
                return
            large = self.waits[0].points >= LARGE_POINTS
            if len(self.running) >= threads * (1 if large else IN_FLIGHT_PER_THREAD):
                return
            self._submit(_Try(self.waits))
            self.waits = None

    def _submit(self, trial: _Try) -> None:
        task, key = trial.job
        try:
            future = self.to.client.submit(
                work,
                # What it needs is in its key, and of a whole survey it is a long list.
                *(replace(task, needs=()), key, self.context, self.to.footing, self._topic),
                pure=False,
                # No mere preference: an idle worker would steal it back.
                workers=trial.others or None,
            )
        except Exception as error:
            raise lost(error) from error
        self.running[future] = trial
        self.by_name[task.kind, task.name] = trial
        future.add_done_callback(self.signs.put)

    def _take(self, sign: Any) -> Receipt | None:
        """Follow up a sign: a future that is done, a task that began, a worker that was ended."""
        if not isinstance(sign, dict):
            return self._ended(sign)
        if "rss" in sign:
            self.starved.add(sign["worker"])
            used = f"{sign['rss'] / 2**20:.0f} MiB"
            self.to.observer.noted(f"worker {sign['worker']} was killed while it used {used}")
            return None
        trial = self.by_name.get((sign["kind"], sign["name"]))
        if trial is not None:
            trial.began_on = sign["worker"]
            self.to.observer.started(trial.job[0], sign["worker"])
        return None

    def _ended(self, future: Any) -> Receipt | None:
        """Receipt of a job; None where it is tried again."""
        trial = self.running.pop(future, None)
        if trial is None:
            return None
        task, _ = trial.job
        worker, receipt, hopeless = self._outcome(future, trial)
        if receipt.failed and trial.number == 1 and not hopeless:
            others = tuple(address for address in self.threads if address != worker)
            self._submit(_Try(trial.job, 2, others=others))
            return None
        del self.by_name[task.kind, task.name]
        return receipt

    def _outcome(self, future: Any, trial: _Try) -> tuple[str, Receipt, bool]:
        """Worker and receipt of a job, and whether another try is out of question."""
        from distributed.client import FutureCancelledError  # noqa: PLC0415
        from distributed.scheduler import KilledWorker  # noqa: PLC0415

        try:
            worker, receipt = future.result()
        except StoppedError:
            raise
        except KilledWorker as killed:
            return self._killed(killed, trial)
        except (FutureCancelledError, OSError, TimeoutError) as error:
            raise lost(error) from error
        except Exception as error:  # noqa: BLE001 - the worker could not even begin
            reason = f"{type(error).__name__}: {error}"
            return trial.began_on, failure(*trial.job, reason), False
        # A damaged file is damaged for all; it is made again, which takes more than a try.
        return worker, receipt, "damaged" in receipt.facts

    def _killed(self, killed: Any, trial: _Try) -> tuple[str, Receipt, bool]:
        """Failure of a task that has lost all the workers that it was given to."""
        last, tries = killed.last_worker, killed.allowed_failures + 1
        self._hear(0.5)
        if last.address in self.starved:
            limit = f"{last.memory_limit / 2**20:.0f} MiB"
            code = "F02"
            why = f"OutOfMemory: its worker needed more than {limit}, on each of {tries} tries"
        else:
            code = "F04"
            why = (
                f"LostWorker: {tries} workers died with it, by a signal, the system's "
                "memory or a crash"
            )
        receipt = failure(*trial.job, why, code=code)
        write_receipt(self.context.store, receipt)
        # It may have waited behind the guilty one, or run beside it in another thread.
        alone = trial.began_on == last.address and last.nthreads == 1
        return last.address, receipt, alone

    def _hear(self, seconds: float) -> None:
        """Wait for what nannies say of a death; it may come a moment after the death."""
        kept, until = [], time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                sign = self.signs.get(timeout=left)
                if isinstance(sign, dict):
                    self._take(sign)
                else:
                    kept.append(sign)
        for sign in kept:
            self.signs.put(sign)

    def _look(self) -> None:
        """Look at the workers, now and then: how many there are, and how they are."""
        now = time.monotonic()
        if now - self.looked_s < max(TICK_S, len(self.threads) / 50):
            return
        try:
            found = workers_of(self.to.client)
        except Exception as error:
            raise lost(error) from error
        if self.to.client.status != "running":
            raise lost(self.to.client.status)
        self.looked_s = now
        self._count(found, now)

    def _count(self, found: Mapping[str, Mapping[str, Any]], now: float) -> None:
        gone = [address for address in self.threads if address not in found]
        for address in gone:
            self.to.observer.noted(f"worker {address} is lost; other workers do its tasks")
        if found:
            self.populated_s = now
        elif self.to.local and now - self.populated_s > PATIENCE_S:
            raise StoppedError("all workers are gone and do not come back; run again to continue")
        elif not self.waiting:
            self.to.observer.noted("no worker is connected; waiting for one")
        self.waiting = not found
        self.threads = {address: int(facts["nthreads"]) for address, facts in found.items()}
        if gone:
            self._free()
        self.to.observer.seen(_workers(found))

    def _free(self) -> None:
        """Let tasks that wait for workers that are gone run anywhere."""
        for future, trial in list(self.running.items()):
            if trial.others and not any(address in self.threads for address in trial.others):
                del self.running[future]
                future.cancel()
                self._submit(_Try(trial.job, trial.number))


def workers_of(client: Any) -> dict[str, Mapping[str, Any]]:
    """Facts of each worker by address, as the scheduler knows them now.

    Every two seconds ``Client.scheduler_info`` is overwritten with one that lists no workers.
    """
    return dict(client.sync(client.scheduler.identity)["workers"])


def _workers(found: Mapping[str, Mapping[str, Any]]) -> WorkersSeen:
    used = [float(facts["metrics"].get("memory", 0)) for facts in found.values()]
    limits = [float(f["memory_limit"]) for f in found.values() if f["memory_limit"]]
    return WorkersSeen(
        len(found),
        sum(int(facts["nthreads"]) for facts in found.values()),
        round(max(used, default=0.0) / 2**20, 1),
        round(min(limits, default=0.0) / 2**20, 1),
    )


def lost(error: object) -> StoppedError:
    """What a run ends with when its scheduler is gone."""
    said = " ".join(str(error).split()) or type(error).__name__
    return StoppedError(f"the scheduler is lost ({said}); run again to continue")
