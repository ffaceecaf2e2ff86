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
    """Units of an absolute grid, counted by state in cells of ``step`` x ``step`` squares.

    A unit is a square of the grid, named by its column and row, or a rectangle of several, named by
    the first and by how many lie along its sides. It counts in each cell that it touches.
    """

    edge_m: float
    #: Column and row of the map's first square.
    west: int
    south: int
    step: int  #: Squares along one side of a cell [count].
    #: (rows, columns): units in each cell, from the south-west; all, finished, failed, being worked
    #: on.
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
        west, south = both[:, :2].min(axis=0).tolist()
        east, north = (both[:, :2] + both[:, 2:]).max(axis=0).tolist()
        wide, high = east - west, north - south
        step = max(math.ceil(wide / COLUMNS), math.ceil(high / ROWS))
        shape = (math.ceil(high / step), math.ceil(wide / step))
        zeros = [np.zeros(shape, np.int64) for _ in range(4)]
        made = cls(edge_m, west, south, step, *zeros)
        made._count(made.total, both)
        made._count(made.done, ready)
        return made

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "TileMap":
        """Map as :meth:`record` gave it.

        Raises
        ------
        ValueError
            If it is none.
        """
        place = (record["edge_m"], record["west"], record["south"], record["step"])
        total, done = (np.array(record[k]) for k in ("total", "done"))
        counts = total.dtype.kind == done.dtype.kind == "i" and total.shape == done.shape
        whole = all(type(value) is int for value in place[1:]) and place[3] > 0
        whole &= isinstance(place[0], int | float) and place[0] > 0
        if not (counts and total.ndim == 2 and total.size and whole):
            raise ValueError("tiles: no map of counts by row and column")
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

    def _count(self, counts: NDArray[np.int64], units: NDArray[np.int64]) -> None:
        """Add units: steps up and down at the corners of each, then running totals."""
        place = np.array([self.west, self.south])
        first = (units[:, :2] - place) // self.step
        stop = (units[:, :2] + units[:, 2:] - 1 - place) // self.step + 1
        change = np.zeros((counts.shape[0] + 1, counts.shape[1] + 1), np.int64)
        for columns, rows, sign in (
            (first[:, 0], first[:, 1], 1),
            (stop[:, 0], stop[:, 1], 1),
            (first[:, 0], stop[:, 1], -1),
            (stop[:, 0], first[:, 1], -1),
        ):
            np.add.at(change, (rows, columns), sign)
        counts += change.cumsum(axis=0).cumsum(axis=1)[:-1, :-1]

    def _add(self, counts: NDArray[np.int64], name: str, change: int) -> None:
        i, j, wide, high = _parse([name])[0].tolist()
        rows, columns = (
            slice(max(low // self.step, 0), max((low + side - 1) // self.step + 1, 0))
            for low, side in ((j - self.south, high), (i - self.west, wide))
        )
        counts[rows, columns] += change


def extent_m(name: str, edge_m: float) -> tuple[float, float, float, float]:
    """West, east, south and north edges of a unit of squares with an edge of ``edge_m`` [m]."""
    column, row, wide, high = (int(v) * edge_m for v in _parse([name])[0])
    return (column, column + wide, row, row + high)


def _parse(names: Iterable[str]) -> NDArray[np.int64]:
    """Column, row and sides of units such as ``"-3_12"``, a square, or ``"-4_12_2_3"``."""
    parts = ([*name.split("_"), "1", "1"] for name in names)
    numbers = (int(v) for part in parts for v in part[:4])
    return np.fromiter(numbers, np.int64).reshape(-1, 4)
