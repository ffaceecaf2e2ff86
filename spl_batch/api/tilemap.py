"""A map of work by state: tiles, blocks or cells of a grid, few enough to be shown."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

COLUMNS: Final = 64
"""Cells of a map from west to east, at most [count]."""

ROWS: Final = 32
"""Cells of a map from south to north, at most [count]."""


class State(IntEnum):
    """State of a cell of the map."""

    NOTHING = 0
    WAITING = 1
    PARTLY = 2
    RUNNING = 3
    DONE = 4
    FAILED = 5


@dataclass(slots=True)
class TileMap:
    """Units of an absolute grid, counted by state in cells of ``step`` x ``step`` units.

    Parameters
    ----------
    edge_m : float
        Edge of a unit [m].
    west, south : int
        Column and row of the map's first unit.
    step : int
        Units along one side of a cell [count].
    total, done, failed, running : (rows, columns) int64
        Units in each cell, from the south-west; all, finished, failed, being worked on.
    """

    edge_m: float
    west: int
    south: int
    step: int
    total: NDArray[np.int64]
    done: NDArray[np.int64]
    failed: NDArray[np.int64]
    running: NDArray[np.int64]

    @classmethod
    def of(cls, left: Iterable[str], finished: Iterable[str], edge_m: float) -> "TileMap | None":
        """Map of units by name, those to do and those that are finished; None without any."""
        todo, ready = _parse(left), _parse(finished)
        both = np.concatenate([todo, ready])
        if not len(both):
            return None
        west, south = both.min(axis=0).tolist()
        wide, high = (both.max(axis=0) - both.min(axis=0) + 1).tolist()
        step = max(math.ceil(wide / COLUMNS), math.ceil(high / ROWS))
        shape = (math.ceil(high / step), math.ceil(wide / step))
        zeros = [np.zeros(shape, np.int64) for _ in range(4)]
        made = cls(edge_m, west, south, step, *zeros)
        np.add.at(made.total, made._cells(both), 1)
        np.add.at(made.done, made._cells(ready), 1)
        return made

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "TileMap":
        """Map as :meth:`record` gave it."""
        total, done = (np.array(record[k], np.int64) for k in ("total", "done"))
        place = (record["edge_m"], record["west"], record["south"], record["step"])
        return cls(*place, total, done, np.zeros_like(total), np.zeros_like(total))

    def record(self) -> dict[str, Any]:
        """Plain values for the log, as things are before anything is started."""
        return {
            "edge_m": self.edge_m,
            "west": self.west,
            "south": self.south,
            "step": self.step,
            "total": self.total.tolist(),
            "done": self.done.tolist(),
        }

    def began(self, name: str) -> None:
        """Count a unit that is being worked on."""
        self._add(self.running, name, 1)

    def ended(self, name: str, *, began: bool, failed: bool) -> None:
        """Count a unit that is finished, or has failed."""
        if began:
            self._add(self.running, name, -1)
        self._add(self.failed if failed else self.done, name, 1)

    def states(self) -> NDArray[np.int64]:
        """:class:`State` of each cell: the one that most deserves a look; north-up."""
        found = np.where(self.total > 0, State.WAITING, State.NOTHING)
        found = np.where(self.done > 0, State.PARTLY, found)
        found = np.where((self.total > 0) & (self.done >= self.total), State.DONE, found)
        found = np.where(self.running > 0, State.RUNNING, found)
        return np.where(self.failed > 0, State.FAILED, found)[::-1]

    def _cells(self, units: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        columns, rows = units[:, 0] - self.west, units[:, 1] - self.south
        return rows // self.step, columns // self.step

    def _add(self, counts: NDArray[np.int64], name: str, change: int) -> None:
        i, j = name.split("_")
        row, column = (int(j) - self.south) // self.step, (int(i) - self.west) // self.step
        if 0 <= row < counts.shape[0] and 0 <= column < counts.shape[1]:
            counts[row, column] += change


def _parse(names: Iterable[str]) -> NDArray[np.int64]:
    """Column and row of units such as ``"-3_12"``."""
    numbers = (int(part) for name in names for part in name.split("_"))
    return np.fromiter(numbers, np.int64).reshape(-1, 2)
