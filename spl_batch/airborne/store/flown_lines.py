"""Which flightline each point belongs to, and the heights that a run adds to it.

Tiles keep points as their files have them. Whoever reads points of a run that aligns its
flightlines adds the shift of each one's flightline, found by point source id and time.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.store.working_store import Store
from spl_batch.formats.las.header import Vlr
from spl_batch.formats.las.writer import Shifted
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.tables import COLUMNS

NEEDED: Final = ("point_source_id", "gps_time")
"""Columns that a point's flightline follows from."""

MARGIN_S: Final = 1.0
"""A return so much before or after those of a flightline is still its own [s]."""

SHIFTS: Final = ("overlaps", "shifts.npz")
"""File of the store with what a run adds."""

KEY: Final = (b"spl-batch", 1)
"""User id and number of the record of a file with the shifts: JSON."""

_IDS: Final = 2**16


class FlownLine(NamedTuple):
    """A flightline."""

    name: str
    psid: int
    #: Times of its first and last return [s]; minus and plus infinity for whatever of its point
    #: source id lies in no other flightline.
    first_s: float
    last_s: float
    up_q: int = 0  #: What is added to its heights [quanta].


class FlownLines:
    """All flightlines of a survey.

    Parameters
    ----------
    lines : sequence of FlownLine
        One for each that was flown.
    """

    def __init__(self, lines: Sequence[FlownLine]) -> None:
        self.lines = sorted(lines, key=lambda one: (one.psid, one.first_s, one.name))
        self._timed = [one for one in self.lines if np.isfinite(one.first_s)]
        of_id: dict[int, list[int]] = {}
        for k, one in enumerate(self._timed):
            of_id.setdefault(one.psid, []).append(k)
        self._of_id = {psid: np.array(mine, np.int32) for psid, mine in of_id.items()}
        ends = [(one.first_s - MARGIN_S, one.last_s + MARGIN_S) for one in self._timed]
        self._first, self._last = np.array(ends, np.float64).reshape(-1, 2).T
        rest = np.zeros(_IDS, np.int32)
        for one in self.lines:
            if np.isinf(one.first_s):
                rest[one.psid] = one.up_q
        self._up = np.concatenate([np.array([t.up_q for t in self._timed], np.int32), rest])

    @property
    def count(self) -> int:
        """Numbers that :meth:`numbers` can give [count]."""
        return len(self._timed) + _IDS

    def numbers(self, psid: NDArray[np.uint16], time_s: NDArray[np.float64]) -> NDArray[np.int32]:
        """Number of each point's flightline, or of all of its id that belong to none: (n,)."""
        found = psid.astype(np.int32) + np.int32(len(self._timed))
        present = np.flatnonzero(np.bincount(psid)).tolist()
        for lines, mine in ((self._of_id[p], psid == p) for p in present if p in self._of_id):
            rows = np.flatnonzero(mine)
            time = time_s[rows]
            place = np.searchsorted(self._first[lines], time, side="right") - 1
            line = lines[np.maximum(place, 0)]
            within = (time >= self._first[line]) & (time <= self._last[line])
            found[rows[within]] = line[within]
        return found

    def line(self, number: int) -> FlownLine:
        """The flightline of a number; one named by its id for points of no other."""
        if number < len(self._timed):
            return self._timed[number]
        psid = number - len(self._timed)
        return FlownLine(f"{psid:05d}", psid, -np.inf, np.inf, int(self._up[number]))

    def up_q(self, psid: NDArray[np.uint16], time_s: NDArray[np.float64]) -> NDArray[np.int32]:
        """What is added to the height of each point: (n,) [quanta]."""
        return self._up[self.numbers(psid, time_s)]

    def up_of(self, name: str) -> int:
        """The same of a flightline by its name [quanta]."""
        return next((one.up_q for one in self.lines if one.name == name), 0)

    def shifted(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Columns of points, :data:`NEEDED` among them, with their shifts in ``z``."""
        if "z" not in columns:
            return dict(columns)
        z = columns["z"] + self.up_q(*(columns[name] for name in NEEDED))
        return {**columns, "z": z.astype(COLUMNS["z"].dtype)}

    def of_file(self, spans: Mapping[str, Sequence[Sequence[float]]]) -> Shifted | None:
        """Shifts of the points of a file; None where all of them stay.

        ``spans``: of each point source id first and last time [s], and more; none without times.
        """

        def holds(one: FlownLine) -> bool:
            if not spans:
                return bool(np.isinf(one.first_s))
            return any(
                first <= one.last_s + MARGIN_S and last >= one.first_s - MARGIN_S
                for first, last, *_ in spans.get(str(one.psid), ())
            )

        mine = [one for one in self.lines if one.up_q and holds(one)]
        return Shifted(self.up_q, record_of(mine)) if mine else None

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays by name, to be stored."""
        columns = zip(*self.lines, strict=True) if self.lines else ((),) * len(_TYPES)
        return {
            name: np.array(values, dtype)
            for (name, dtype), values in zip(_TYPES.items(), columns, strict=True)
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "FlownLines":
        """Flightlines that :meth:`to_arrays` gave."""
        rows = zip(*(arrays[name].tolist() for name in _TYPES), strict=True)
        return cls([FlownLine(*row) for row in rows])


_TYPES: Final = {
    "name": np.str_,
    "psid": np.int64,
    "first_s": np.float64,
    "last_s": np.float64,
    "up_q": np.int64,
}


def record_of(lines: Sequence[FlownLine]) -> Vlr:
    """Record of a file that names what was added to the heights of its flightlines."""
    content = {
        "align": "vertical",
        "meaning": "added to the heights of each flightline, rounded to the file's scale [m]",
        "flightlines": [
            {
                "name": one.name,
                "point_source_id": one.psid,
                "gps_time": [one.first_s, one.last_s] if np.isfinite(one.first_s) else None,
                "up_m": one.up_q / QUANTA_PER_M,
            }
            for one in lines
        ],
    }
    data = json.dumps(content, indent=1).encode() + b"\0"
    return Vlr(*KEY, b"shifts of flightlines", data)


def read_shifts(args: Mapping[str, Any], store: Store) -> FlownLines | None:
    """Shifts that a task applies; None where nothing is shifted.

    ``args``: arguments of the task; ``aligned`` where there are shifts.
    """
    if not args.get("aligned"):
        return None
    lines = FlownLines.from_arrays(read_arrays(store.path(*SHIFTS)))
    return lines if any(one.up_q for one in lines.lines) else None
