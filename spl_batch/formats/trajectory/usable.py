"""Records of a trajectory that cannot be are left out, named and counted, where they are few."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import InputError, counted, grouped
from spl_batch.formats.gps_clock import usable_times

ASTRAY_S: Final = 366 * 86_400.0
"""Times of a file lie within this of each other [s]."""

FARTHEST_M: Final = 1e8
"""No coordinate on Earth, in metres or degrees, is farther from zero."""

MOST_WRONG: Final = 0.1
"""Share of a file's records that may be left out: one that holds more is damaged as a whole."""

Records = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times (n,) [s] and positions (n, 3) of some records."""


class Sieve:
    """Takes the records of a file, in its order, and lets those pass that can be.

    Parameters
    ----------
    path : Path
        The file.

    Attributes
    ----------
    reason : str
        Why the file could not be read as what it is called; empty if it could.
    """

    def __init__(self, path: Path) -> None:
        self.reason = ""
        self._path = path
        self._records = self._wrong = 0
        self._first = ""
        self._middle_s: float | None = None

    def lose(self, rows: int) -> None:
        """Count rows that are no records, wherever in the file they are."""
        self._wrong += rows
        self._records += rows

    def sound(self, time: NDArray[np.float64], position: NDArray[np.float64]) -> Records:
        """The records, of some, that can be."""
        sound = usable_times(time) & (np.abs(position) <= FARTHEST_M).all(axis=1)
        if self._middle_s is None and sound.any():
            self._middle_s = float(np.median(time[sound]))
        sound &= np.abs(time - (self._middle_s or 0.0)) <= ASTRAY_S
        wrong = len(time) - int(np.count_nonzero(sound))
        if wrong and not self._first:
            self._first = f"; the first is record {self._records + int(np.argmin(sound))}"
        self._wrong += wrong
        self._records += len(time)
        return (time[sound], position[sound]) if wrong else (time, position)

    def told(self) -> str:
        """What was left out of the file; empty where nothing was.

        Raises
        ------
        InputError
            If that is more than :data:`MOST_WRONG` of it.
        """
        if self.reason and not self._records:
            raise InputError(str(self._path), self.reason)
        if not self._wrong:
            return ""
        share = f"{grouped(self._wrong)} of {counted(self._records, 'records')}"
        why = (
            "(no finite number, a time more than a year from the others, or a place beyond "
            f"{FARTHEST_M:.0e} m){self._first}"
        )
        if self._wrong > MOST_WRONG * self._records:
            text = f"{share} cannot be used {why}: remove them"
            raise InputError(str(self._path), self.reason or text)
        return f"trajectory {self._path.name}: {share} left out {why}"
