"""Files by their headers: which can be used, and what is wrong with the others."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import InputError
from spl_batch.formats.las.reader import LasFacts, inspect
from spl_batch.formats.units import Units


class Files:
    """Files whose headers are checked one rule after the other; a bad one meets no further rule.

    ``base``: folder below which messages name them by where they lie in it.
    """

    def __init__(self, paths: Iterable[Path] = (), base: Path | None = None) -> None:
        self._base = base
        self.usable: list[LasFacts] = []  #: In the order of their paths.
        self.bad: list[InputError] = []  #: In the order in which they were found.
        for path in paths:
            try:
                self.usable.append(inspect(path))
            except InputError as error:
                self.bad.append(error)

    def leave_out(self, fault_of: Callable[[LasFacts], str | Sequence[str] | None]) -> None:
        """Take out the files that have a fault, by a function of a header."""
        checked = [(facts, fault_of(facts)) for facts in self.usable]
        self.bad += [InputError(str(facts.path), fault) for facts, fault in checked if fault]
        self.usable = [facts for facts, fault in checked if not fault]

    def in_metres(self, units: Units) -> None:
        """Bring the boxes of files in ``units`` into metres."""
        self.usable = [facts.in_metres(units) for facts in self.usable]

    def name(self, facts: LasFacts) -> str:
        """What messages call a file."""
        return str(facts.path) if self._base is None else name_below(facts.path, self._base)

    @property
    def holding(self) -> list[LasFacts]:
        """Usable files that hold points."""
        return [facts for facts in self.usable if facts.n_points]

    @property
    def boxes(self) -> NDArray[Any]:
        """Boxes around the points of each of these: (n,) polygons, in the unit of the headers."""
        ends = np.array([(*facts.mins_m[:2], *facts.maxs_m[:2]) for facts in self.holding])
        found: NDArray[Any] = shapely.box(*ends.reshape(-1, 4).T)
        return found

    @property
    def corners(self) -> NDArray[np.float64]:
        """Two corners of the box around all points, (2, 2) likewise; (0, 2) without points."""
        boxes = self.boxes
        if not len(boxes):
            return np.empty((0, 2))
        found: NDArray[np.float64] = shapely.total_bounds(boxes).reshape(2, 2)
        return found
