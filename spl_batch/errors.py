"""The project's own exceptions.

Every message is one clear line that names the file, the value and the remedy.
The command line prints it without a traceback and exits with ``exit_status``.
"""

from collections.abc import Sequence


class SplBatchError(Exception):
    """Base of every error that this project raises on purpose."""

    exit_status = 2


class WorkflowError(SplBatchError, ValueError):
    """The workflow file, or an option on the command line, is wrong."""


class InputError(SplBatchError, ValueError):
    """An input file cannot be used.

    Parameters
    ----------
    path : str
        The file that is at fault.
    faults : sequence of str
        Every fault found in it: value, what is allowed, remedy.
    """

    def __init__(self, path: str, faults: str | Sequence[str]) -> None:
        self.path = path
        self.faults = (faults,) if isinstance(faults, str) else tuple(faults)
        super().__init__(f"{path}: {'; '.join(self.faults)}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, tuple[str, ...]]]:
        return type(self), (self.path, self.faults)


class PlanError(SplBatchError):
    """The work as planned cannot be done: too little memory or disk, nothing to do."""


class StoreError(SplBatchError):
    """Something in the working store is missing or damaged."""

    exit_status = 1


class StoppedError(SplBatchError):
    """Something that concerns everything: full disk, lost scheduler. Run again to continue."""

    exit_status = 3
