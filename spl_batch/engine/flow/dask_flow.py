"""Jobs flow to the workers of a dask scheduler, outcomes flow back.

The scheduler holds the order: a job that waits for others is given their futures. What has failed
travels on as a value, and each job decides what it can do without. One that fails is handed out
once more. The scheduler runs the tasks of a lost worker elsewhere; a task that has ended several
workers in a row fails, with the nannies' reason.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from spl_batch.engine.flow.job import FAILED, Observer, work
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.store.working_store import write_receipt
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.runner import failure
from spl_batch.engine.tasks.task import Job, Need, Outcome
from spl_batch.engine.watch.events import Note, WorkersSeen
from spl_batch.errors import StoppedError

HELD_PER_THREAD: Final = 8
"""Batches of jobs that the scheduler holds for each worker thread, those that wait for others
included [count]."""

HELD_LEAST: Final = 32
"""The same for few threads: what a job waits for has to be among them [count]."""

BATCH_TASKS: Final = 64
"""Small tasks that a worker does in one go, at most: dask takes as long for each as they do
[count]."""

BATCHES_PER_THREAD: Final = 4
"""Batches of a step for each worker thread at the least, so that all end together [count]."""

TICK_S: Final = 2.0
"""How often the workers are looked at [s]; less often where they are hundreds."""

PATIENCE_S: Final = 300.0
"""How long local workers may all be gone before the run stops [s]."""

HEARING_S: Final = 0.5
"""How long what a nanny reports of a death may come after the death [s]."""

KILLED: Final = "killed"
"""What a try has come to whose workers died, where another task may have ended them."""

_MEMORY_TOPIC: Final = "worker-restart-memory"
"""Where a nanny reports that it has ended its worker for its memory."""


@dataclass(slots=True)
class _Trial:
    """Jobs on their way together."""

    jobs: Mapping[Need, Job]
    future: Any
    began_on: str = ""


class OnDask:
    """Does jobs on the workers of a dask scheduler, which it looks for before the first of them.

    ``connect`` gives its client, and may start workers first; ``local`` ones come back when they
    die.
    """

    def __init__(
        self,
        connect: Callable[[], Any],
        context: RunContext[Any],
        observer: Observer,
        *,
        local: bool,
        warm_up: WarmUp | None = None,
    ) -> None:
        self.context, self.observer, self.local = context, observer, local
        self.client: Any = None
        self._connect, self._warm_up = connect, warm_up
        self._trials: dict[Any, _Trial] = {}  # by the keys of futures
        self._keys: dict[Need, Any] = {}
        self._starved: set[str] = set()
        self._watch = _Watch(self)

    def _begin(self) -> None:
        from distributed import as_completed  # noqa: PLC0415 - slow import, only when used

        if self._warm_up is not None:
            self._warm_up.begin(self.observer.notify)  # workers start for seconds
        self.client = self._connect()
        self._topic = f"spl_batch-{self.client.id}"
        self._ended = as_completed(with_results=True, raise_errors=False, loop=self.client.loop)
        self.client.subscribe_topic(self._topic, self._began)
        self.client.subscribe_topic(_MEMORY_TOPIC, self._restarted)
        self._watch.start()

    @property
    def window(self) -> int:
        """Batches of jobs that it holds at once [count]."""
        return max(HELD_LEAST, HELD_PER_THREAD * sum(self._watch.known.values()))

    @property
    def has_room(self) -> bool:
        """Whether it takes more jobs now."""
        return len(self._trials) < self.window

    def batch_of(self, count: int) -> int:
        """How many of so many small tasks of a step a worker does in one go, at most [count]."""
        batches = BATCHES_PER_THREAD * sum(self._watch.known.values())
        return min(-(-count // batches), BATCH_TASKS) if batches else 1

    def submit(self, jobs: Sequence[Job]) -> None:
        """Hand jobs to the scheduler, with the futures of what they wait for."""
        if self.client is None:
            self._begin()
        step, name = jobs[0].need
        if self._warm_up is not None:
            self._warm_up.wait_for(step)
        needed = {self._keys[need]: None for job in jobs for need in job.open if need in self._keys}
        try:
            # What a task needs is in its key, and of a whole survey it is a long list.
            sent = [
                job if not job.key else job._replace(task=replace(job.task, needs=()))
                for job in jobs
            ]
            future = self.client.submit(
                work,
                *(sent, self.context, self._topic),
                *(self._trials[key].future for key in needed),
                key=(f"{step}-{self.client.id}", name, time.monotonic_ns()),
                pure=False,
            )
        except Exception as error:
            raise lost(error) from error
        self._trials[future.key] = _Trial({job.need: job for job in jobs}, future)
        self._keys |= dict.fromkeys(self._trials[future.key].jobs, future.key)
        self._ended.add(future)

    def ended(self) -> Sequence[Outcome]:
        """Wait for the next jobs to end that were submitted together.

        StoppedError if the scheduler is lost or a task met something that concerns everything.
        """
        for future, result in self._ended:
            trial = self._trials.pop(future.key, None)
            if trial is None:
                continue
            for need in trial.jobs:
                del self._keys[need]
            return self._outcomes(future, result, trial)
        raise self._watch.fault or lost("its futures are gone")

    def close(self) -> None:
        """Let go of jobs that are still on their way."""
        if self._warm_up is not None:
            self._warm_up.end()
        self._watch.over.set()
        self.give_up()
        self._trials.clear()
        self._keys.clear()
        with contextlib.suppress(Exception):
            self.client.unsubscribe_topic(self._topic)

    def give_up(self) -> None:
        """End the wait for outcomes: they will not come."""
        for trial in list(self._trials.values()):
            with contextlib.suppress(Exception):
                trial.future.cancel()

    def _outcomes(self, future: Any, result: Any, trial: _Trial) -> Sequence[Outcome]:
        """What has come of jobs."""
        from distributed.scheduler import KilledWorker  # noqa: PLC0415

        if future.status == "finished":
            found: Sequence[Outcome] = result
            return found
        if self._watch.fault is not None:
            raise self._watch.fault
        if future.status != "error":
            raise lost(future.status)
        error = result[1] if isinstance(result, tuple) else future.exception()
        if isinstance(error, StoppedError):
            raise error
        jobs = [*trial.jobs.values()]
        # Of several nobody knows which one it was; and what a job waits for may have failed.
        if len(jobs) > 1 or any(need in self._keys for need in jobs[0].open):
            return [Outcome(job.need, None, again=job.tried) for job in jobs]
        (job,) = jobs
        if isinstance(error, KilledWorker):
            return [self._killed(error, trial, job)]
        if FAILED not in job.tried:
            return [Outcome(job.need, None, again=(*job.tried, FAILED))]
        # The worker could not even begin.
        return [Outcome(job.need, failure(job.task, job.key, f"{type(error).__name__}: {error}"))]

    def _killed(self, killed: Any, trial: _Trial, job: Job) -> Outcome:
        """Failure of a task that has lost all the workers that it was given to."""
        if killed.task != trial.future.key:  # what it waits for has
            return Outcome(job.need, None, again=job.tried)
        last, tries = killed.last_worker, killed.allowed_failures + 1
        time.sleep(HEARING_S)
        # It may have waited behind the guilty one, or run beside it in another thread.
        alone = trial.began_on == last.address and last.nthreads == 1
        if not alone and KILLED not in job.tried:
            return Outcome(job.need, None, again=(*job.tried, KILLED))
        if last.address in self._starved:
            limit = f"{last.memory_limit / 2**20:.0f} MiB"
            why = f"OutOfMemory: its worker needed more than {limit}, on each of {tries} tries"
            code = "F02"
        else:
            why = (
                f"LostWorker: {tries} workers died with it, by a signal, the system's "
                "memory or a crash"
            )
            code = "F04"
        receipt = failure(job.task, job.key, why, code=code)
        write_receipt(self.context.store, receipt)
        return Outcome(job.need, receipt)

    def _began(self, event: tuple[float, Mapping[str, Any]]) -> None:
        need = tuple(event[1]["need"])
        trial = self._trials.get(self._keys.get(need))
        if trial is not None:
            trial.began_on = event[1]["worker"]
            self.observer.started(trial.jobs[need].task, trial.began_on)

    def _restarted(self, event: tuple[float, Mapping[str, Any]]) -> None:
        sign = event[1]
        if "rss" in sign:
            self._starved.add(sign["worker"])
            used = f"{sign['rss'] / 2**20:.0f} MiB"
            text = f"worker {sign['worker']} was killed while it used {used}"
            self.observer.notify(Note("info", text))


class _Watch:
    """Looks at the workers now and then: how many there are, and how they are."""

    def __init__(self, of: OnDask) -> None:
        self._of, self.over = of, threading.Event()
        self.known: dict[str, int] = {}  #: Threads by address.
        self._populated_s, self._waiting = time.monotonic(), False
        self.fault: StoppedError | None = None  #: Why no outcome will come.

    def start(self) -> None:
        """Look for the first time, and then on."""
        self._populated_s = time.monotonic()
        self._count(workers_of(self._of.client))
        threading.Thread(target=self._run, name="watch workers", daemon=True).start()

    def _run(self) -> None:
        while not self.over.wait(max(TICK_S, len(self.known) / 50)):
            try:
                self._count(workers_of(self._of.client))
                status = self._of.client.status
                self.fault = None if status == "running" else lost(status)
            except StoppedError as fault:
                self.fault = fault
            except Exception as error:  # noqa: BLE001 - whatever a lost connection leads to
                self.fault = lost(error)
            if self.fault is not None and not self.over.is_set():
                self._of.give_up()
                return

    def _count(self, found: Mapping[str, Mapping[str, Any]]) -> None:
        now, notify = time.monotonic(), self._of.observer.notify
        for address in self.known.keys() - found.keys():
            notify(Note("info", f"worker {address} is lost; other workers do its tasks"))
        if found:
            self._populated_s = now
        elif self._of.local and now - self._populated_s > PATIENCE_S:
            raise StoppedError("all workers are gone and do not come back; run again to continue")
        elif not self._waiting:
            notify(Note("info", "no worker is connected; waiting for one"))
        self._waiting = not found
        self.known = {address: int(facts["nthreads"]) for address, facts in found.items()}
        used = [float(facts["metrics"].get("memory", 0)) for facts in found.values()]
        limits = [float(f["memory_limit"]) for f in found.values() if f["memory_limit"]]
        most, limit = (round(v / 2**20, 1) for v in (max(used, default=0), min(limits, default=0)))
        notify(WorkersSeen(len(found), sum(self.known.values()), most, limit))


def workers_of(client: Any) -> dict[str, Mapping[str, Any]]:
    """Facts of each worker by address, as the scheduler knows them now.

    Every two seconds ``Client.scheduler_info`` is overwritten with one that lists no workers.
    """
    return dict(client.sync(client.scheduler.identity)["workers"])


def lost(error: object) -> StoppedError:
    """What a run ends with when its scheduler is gone."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return StoppedError(f"the scheduler is lost ({reason}); run again to continue")
