"""State of a run as its log tells it, which any process may read while it grows."""

import mmap
import time
from pathlib import Path
from typing import Final

from spl_batch.engine.settings.mistaken_file import no_output
from spl_batch.engine.store.deliveries import RECORD
from spl_batch.engine.store.output_lock import holder
from spl_batch.engine.store.working_store import IDENTITY, Store, read_receipt
from spl_batch.engine.watch.earlier_runs import FIRST_EVENT, WORK_EVENT
from spl_batch.engine.watch.events import TaskEnded, as_record
from spl_batch.engine.watch.log_lines import event_of
from spl_batch.engine.watch.status import RunStatus
from spl_batch.errors import WorkflowError, reason_of
from spl_batch.formats.files.atomic import of_a_file

LOG: Final = "log.jsonl"
"""Name of the log, below the output."""

_CLOCKS_S: Final = 0.05
"""How much coarser than the log's the times of files may be [s]."""

_NO_EVENT: Final = (ValueError, KeyError, OverflowError)
"""What a line of the log leads to that is cut off, by a kill, damaged, or of no stage."""

_BLOCK_BYTES: Final = 1 << 22
"""Bytes of the log read at once [byte]."""


class Follower:
    """Reads the log of an output folder as it grows, each line once.

    Parameters
    ----------
    output : Path or str
        Folder of the results.

    Raises
    ------
    WorkflowError
        If no run has worked there.
    """

    def __init__(self, output: Path | str) -> None:
        self.output = Path(output)
        self.status = RunStatus()
        self._rest = b""
        self._lost = 0
        fault = no_output(self.output, "status")
        if fault:
            raise WorkflowError(f"{output}: {fault}")
        try:
            self._read = _latest_run(self._log)
        except OSError:
            raise WorkflowError(f"{output}: no run has worked here (no log.jsonl)") from None

    @property
    def _log(self) -> Path:
        return self.output / LOG

    def update(self) -> RunStatus:
        """State as of now."""
        try:
            with open(self._log, "rb", opener=of_a_file) as stream:
                stream.seek(self._read)
                while content := stream.read(_BLOCK_BYTES):
                    self._read += len(content)
                    self._take(content)
        except OSError as error:
            raise WorkflowError(f"{self._log}: cannot be read: {reason_of(error)}") from None
        self.status.lost_lines = self._lost
        self.status.holder = holder(self.output)
        self.status.delivered = None
        if self.status.holder is None:
            self.status.nothing_runs()
            self._take_unheard()
            if any(stage.done for stage in self.status.stages.values()):
                self.status.delivered = _without_store(self.output)
        else:
            self.status.advance(time.time())
        return self.status

    def _take_unheard(self) -> None:
        """Count in the tasks that were finished while their run was stopped: its log lacks them."""
        store = Store(self.output)
        stages, kinds = self.status.stages, self.status.kinds
        for (kind, name), stage in list(self.status.begun.items()):
            receipt = read_receipt(store, kind, name)
            if receipt is None or receipt.failed or stage not in stages or kind not in kinds:
                continue
            written_s = store.receipt(kind, name).stat().st_mtime
            if written_s < self.status.kinds[kind] - _CLOCKS_S:  # stale: it was to be done again
                continue
            ended = TaskEnded(stage, kind, name, receipt.points, receipt.wall_s, "")
            latest_s = self.status.stages[stage].latest_s
            self.status.feed(as_record(ended))
            self.status.stages[stage].latest_s = max(written_s, latest_s)

    def _take(self, content: bytes) -> None:
        *lines, self._rest = (self._rest + content).split(b"\n")
        for line in lines:
            try:
                self.status.feed(event_of(line))
            except _NO_EVENT:
                self._lost += 1


def status(output: Path | str) -> RunStatus:
    """State of the latest run of an output folder, which may be working at this moment.

    Parameters
    ----------
    output : Path or str
        Folder of the results.

    Raises
    ------
    WorkflowError
        If no run has worked there.
    """
    return Follower(output).update()


def _latest_run(log: Path) -> int:
    """Where the lines of the latest run begin in a log [byte]."""
    if not log.stat().st_size:
        return 0
    with log.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as whole:
        # A run that ended before its work began says nothing of what is done.
        began = whole.rfind(WORK_EVENT)
        first = whole.rfind(FIRST_EVENT, 0, began if began >= 0 else len(whole))
        return whole.rfind(b"\n", 0, max(first, 0)) + 1


def _without_store(output: Path) -> tuple[str, ...] | None:
    """What else an output folder holds where nothing vouches for it; None where a store does."""
    store = Store(output)
    if store.path("receipts").is_dir() or (store.local / IDENTITY).exists():
        return None
    own = {store.local.name, LOG, RECORD}
    return tuple(sorted(path.name for path in output.iterdir() if path.name not in own))
