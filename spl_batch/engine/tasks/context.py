"""Context that every task is given, and what it hands back."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from pyproj import CRS

from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.store.working_store import Store
from spl_batch.formats.files.atomic import real_path
from spl_batch.formats.units import Units

W = TypeVar("W", bound=BaseWorkflow)


@dataclass(frozen=True, slots=True)
class RunContext(Generic[W]):
    """What a run is: the same for every task, small enough to send along."""

    workflow: W
    base: Path  #: Folder that relative paths of the workflow start from.
    output: Path
    crs_wkt: str  #: CRS of what is processed as WKT; empty where none is known.
    code: str  #: Version of the code, part of every key.
    mark: str = ""  #: What the lock file of the output holds while this run works there.

    @property
    def store(self) -> Store:
        """The working store."""
        return Store(self.output, self.workflow.outputs.store)

    @property
    def crs(self) -> CRS | None:
        """CRS of the processed data; None without one."""
        return CRS.from_wkt(self.crs_wkt) if self.crs_wkt else None

    @property
    def shown_units(self) -> Units:
        """Units in which report and screen give coordinates and heights."""
        return Units.of(self.crs)

    def resolve(self, name: str) -> Path:
        """Path of the workflow, seen from its folder."""
        return real_path(self.base / name)


@dataclass(frozen=True, slots=True)
class Produced:
    """What a task's function hands back to the runner."""

    outputs: Sequence[Path] = ()  #: Files and directories that it wrote.
    facts: Mapping[str, Any] = field(default_factory=dict)  #: Small results, plain JSON values.
    points: int = 0
    #: mapping of str to (int, int): path of an input read from end to end -> size [byte], time of
    #: writing [ns since 1970].
    inputs: Mapping[str, Sequence[int]] = field(default_factory=dict)


TaskFunction = Callable[[Mapping[str, Any], Any], Produced]
"""Function of a kind of task: arguments and context in, what it produced out."""
