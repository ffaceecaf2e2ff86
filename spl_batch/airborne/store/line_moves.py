"""Shifts of flightlines that a run applies, and the one way in which points are given them.

Tiles keep points where their files have them. Whoever reads points of a run that aligns its
flightlines adds the shift of each one's flightline, told by point source id and time.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.store.working_store import Store
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.tables import COLUMNS

TOLD_BY: Final = ("point_source_id", "gps_time")
"""Columns that tell the flightline of a point."""

MARGIN_S: Final = 1.0
"""A return so much before or after those of a flightline is still its own [s]."""

PLACE: Final = ("strips", "shifts.npz")
"""File of the store that holds what a run applies."""


class LineMove(NamedTuple):
    """What is added to the coordinates of a flightline."""

    name: str
    psid: int
    #: Times of its first and last return [s]; minus and plus infinity for whatever of its point
    #: source id lies in no other flightline.
    first_s: float
    last_s: float
    shift: tuple[int, int, int]  #: East, north, up [quanta].


class LineMoves:
    """What is added to the coordinates of all flightlines.

    Parameters
    ----------
    moves : sequence of LineMove
        One for each flightline that was flown, those that stay too.
    """

    def __init__(self, moves: Sequence[LineMove]) -> None:
        # Those of an id by time; what stands for the rest of its points comes first.
        self.moves = sorted(moves, key=lambda one: (one.psid, one.first_s, one.name))
        self._first = np.array([one.first_s for one in self.moves], np.float64)
        self._last = np.array([one.last_s for one in self.moves], np.float64)
        self._shift = np.array([one.shift for one in self.moves], np.int64).reshape(-1, 3)
        self._of: dict[int, NDArray[np.intp]] = {}
        for psid in {one.psid for one in self.moves}:
            mine = [k for k, one in enumerate(self.moves) if one.psid == psid]
            self._of[psid] = np.array(mine, np.intp)

    @property
    def reach_q(self) -> int:
        """Longest way that a point goes along one axis of the map [quanta]."""
        return int(np.abs(self._shift[:, :2]).max(initial=0))

    @property
    def moved(self) -> list[LineMove]:
        """Flightlines that do not stay."""
        return [one for one in self.moves if any(one.shift)]

    def of_line(self, name: str) -> tuple[int, int, int]:
        """Shift of a flightline by its name: east, north, up [quanta]."""
        return next((one.shift for one in self.moves if one.name == name), (0, 0, 0))

    def of(self, psid: NDArray[np.uint16], time_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Shift of each point: (n, 3) east, north, up [quanta]."""
        found = np.zeros((len(psid), 3), np.int64)
        for one in np.flatnonzero(np.bincount(psid)).tolist():
            lines = self._of.get(one)
            if lines is None:
                continue
            mine = np.flatnonzero(psid == one)
            time, rest = time_s[mine], lines[np.isneginf(self._first[lines])]
            timed = lines[len(rest) :]
            shift = np.zeros((len(mine), 3), np.int64)
            if len(rest):
                shift[:] = self._shift[rest[-1]]
            if len(timed):
                begins = self._first[timed] - MARGIN_S
                place = np.maximum(np.searchsorted(begins, time, side="right") - 1, 0)
                line = timed[place]
                within = (time >= begins[place]) & (time <= self._last[line] + MARGIN_S)
                shift[within] = self._shift[line[within]]
            found[mine] = shift
        return found

    def add(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Columns of points, at least :data:`TOLD_BY`, with their coordinates shifted."""
        shift = self.of(*(columns[name] for name in TOLD_BY))
        moved = {
            axis: (columns[axis] + shift[:, k]).astype(COLUMNS[axis].dtype)
            for k, axis in enumerate("xyz")
            if axis in columns
        }
        return {**columns, **moved}

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays by name, to be stored."""
        return {
            "name": np.array([one.name for one in self.moves], np.str_),
            "psid": np.array([one.psid for one in self.moves], np.int64),
            "first_s": self._first,
            "last_s": self._last,
            "shift": self._shift,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "LineMoves":
        """What :meth:`to_arrays` gave."""
        names = ("name", "psid", "first_s", "last_s", "shift")
        rows = zip(*(arrays[name].tolist() for name in names), strict=True)
        return cls(
            [
                LineMove(name, psid, first_s, last_s, (east, north, up))
                for name, psid, first_s, last_s, (east, north, up) in rows
            ]
        )


def read_moves(args: Mapping[str, Any], store: Store) -> LineMoves | None:
    """Shifts that a task is told to apply; None where nothing is shifted.

    ``args``: arguments of the task; ``aligned`` where there are shifts.
    """
    if not args.get("aligned"):
        return None
    moves = LineMoves.from_arrays(read_arrays(store.path(*PLACE)))
    return moves if moves.moved else None
