"""What a run tells those who watch it."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RunStarted:
    """A run begins; what the log says before it belongs to earlier ones.

    Parameters
    ----------
    workflow : str
        Workflow file.
    workers : int
        Worker processes [count].
    code : str
        Version of the code.
    """

    workflow: str
    workers: int
    code: str


@dataclass(frozen=True, slots=True)
class PhaseStarted:
    """A phase knows its tasks.

    Parameters
    ----------
    stage, kind : str
        Stage of the command line, and kind of the tasks.
    tasks : int
        Tasks to do [count].
    skipped : int
        Tasks found finished [count].
    points : int
        Points that the tasks to do will handle [count].
    """

    stage: str
    kind: str
    tasks: int
    skipped: int
    points: int


@dataclass(frozen=True, slots=True)
class TaskEnded:
    """A task is finished, or has failed for good.

    Parameters
    ----------
    stage, kind, name : str
        Which one.
    points : int
        Points that it was to handle [count].
    wall_s : float
        Its duration [s].
    reason : str
        Why it failed; empty when it did not.
    """

    stage: str
    kind: str
    name: str
    points: int
    wall_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class Note:
    """Something that a user should read.

    Parameters
    ----------
    level : str
        ``info``, ``warning`` or ``error``.
    text : str
        One line.
    """

    level: str
    text: str


Event = RunStarted | PhaseStarted | TaskEnded | Note
Listener = Callable[[Event], None]


def ignore(_event: Event) -> None:
    """Listen to nothing."""
