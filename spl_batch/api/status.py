"""What is done, failed and left in an output folder, from its log and receipts."""

import json
from dataclasses import dataclass
from pathlib import Path

from spl_batch.errors import WorkflowError
from spl_batch.runner import STAGES


@dataclass(slots=True)
class StageStatus:
    """State of one stage.

    Parameters
    ----------
    stage : str
        Its name.
    total, done, failed : int
        Tasks known, finished and failed [count].
    points : int
        Points handled by finished tasks [count].
    wall_s : float
        Summed time of those tasks [s].
    left_points : int
        Points of tasks that are still to do [count].
    """

    stage: str
    total: int = 0
    done: int = 0
    failed: int = 0
    points: int = 0
    wall_s: float = 0.0
    left_points: int = 0

    @property
    def left(self) -> int:
        """Tasks that are still to do [count]."""
        return self.total - self.done - self.failed


def status(output: Path | str) -> list[StageStatus]:
    """State of each stage of the latest run.

    Parameters
    ----------
    output : Path or str
        Folder of the results.

    Raises
    ------
    WorkflowError
        If no run has worked there.
    """
    log = Path(output) / "log.jsonl"
    try:
        lines = log.read_text(encoding="utf-8").splitlines()
    except OSError:
        raise WorkflowError(f"{output}: no run has worked here (no log.jsonl)") from None
    stages = {name: StageStatus(name) for name in STAGES}
    for line in lines:
        try:
            event = json.loads(line)
        except json.JSONDecodeError:
            continue  # a run that was killed may have left half a line
        _count(event, stages)
    return list(stages.values())


def _count(event: dict[str, object], stages: dict[str, StageStatus]) -> None:
    kind = event.get("event")
    if kind == "RunStarted":
        stages.update({name: StageStatus(name) for name in STAGES})
    stage = stages.get(str(event.get("stage")))
    if stage is None:
        return
    if kind == "PhaseStarted":
        stage.total += int(str(event["tasks"])) + int(str(event["skipped"]))
        stage.done += int(str(event["skipped"]))
        stage.left_points += int(str(event["points"]))
    elif kind == "TaskEnded":
        points = int(str(event["points"]))
        stage.left_points -= points
        if event["reason"]:
            stage.failed += 1
        else:
            stage.done += 1
            stage.points += points
            stage.wall_s += float(str(event["wall_s"]))
