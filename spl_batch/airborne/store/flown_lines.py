"""Which flightline each point belongs to, and the heights that a run adds to it.

A flightline is a point source id between two long pauses. Points get its number once, when they
are shared among tiles, and carry it as ``line``. Tiles keep heights as their files have them;
whoever reads points of a run that aligns its flightlines adds the shift of each one's.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.store.working_store import Store
from spl_batch.formats.las.header import Vlr
from spl_batch.formats.las.writer import Shifted
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.lattice.tables import COLUMNS

SHIFTS: Final = ("overlaps", "shifts.npz")
"""File of the store with what a run adds."""

KEY: Final = (b"spl-batch", 1)
"""User id and number of the record of a file with the shifts: JSON."""

LINES: Final = int(np.iinfo(COLUMNS["line"].dtype).max) + 1
"""Numbers that a flightline can have [count]."""


class Pass(NamedTuple):
    """A flightline."""

    number: int
    name: str
    psid: int
    #: Times of its first and last return [s]; minus and plus infinity without times.
    first_s: float
    last_s: float


_PASSES: Final = np.dtype(list(zip(Pass._fields, ("i8", "U40", "i8", "f8", "f8"), strict=True)))
"""A flightline as it is stored."""


def numbers(psids: Sequence[int]) -> list[int]:
    """Numbers of flightlines, by their point source ids in the order of time.

    The first of an id has that id; further ones have what no id is, from the highest down. So a
    flightline that is added leaves the numbers of others alone.
    """
    spare = iter(sorted(set(range(LINES)) - set(psids), reverse=True))
    seen: set[int] = set()
    found = []
    for psid in psids:
        found.append(next(spare, psid) if psid in seen else psid)
        seen.add(psid)
    return found


def line_of(
    psid: NDArray[np.uint16], time_s: NDArray[np.float64], passes: Iterable[Pass]
) -> NDArray[np.uint16]:
    """Number of each point's flightline: that of its id and time, else the first of its id."""
    found = psid.astype(np.uint16)
    for one in passes:
        if one.number != one.psid:
            within = (time_s >= one.first_s) & (time_s <= one.last_s)
            found[(psid == one.psid) & within] = one.number
    return found


class Shifts:
    """Heights that a run adds to flightlines, ``up_q`` to each [quanta]."""

    def __init__(self, passes: Sequence[Pass], up_q: NDArray[np.int32]) -> None:
        self.passes = passes
        self._up = np.zeros(LINES, np.int32)
        self._up[[one.number for one in passes]] = up_q

    def of(self, line: NDArray[np.uint16]) -> NDArray[np.int32]:
        """What is added to the height of each point, by its flightline [quanta]."""
        return self._up[line]

    def of_name(self, name: str) -> int:
        """The same of a flightline by its name [quanta]."""
        return next((int(self._up[one.number]) for one in self.passes if one.name == name), 0)

    def shifted(self, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Columns of points, ``line`` among them, with their shifts in ``z``."""
        if "z" not in columns:
            return dict(columns)
        z = columns["z"] + self.of(columns["line"])
        return {**columns, "z": z.astype(COLUMNS["z"].dtype)}

    def record(self, psids: Iterable[int] | None = None) -> Vlr | None:
        """Record of a file that names what was added to its flightlines; None where all stay.

        ``psids``: point source ids in the file; all by default.
        """
        wanted = None if psids is None else set(psids)
        content = {
            "align": "vertical",
            "meaning": "added to the heights of each flightline, rounded to the file's scale [m]",
            "flightlines": [
                {
                    "name": one.name,
                    "point_source_id": one.psid,
                    "gps_time": [one.first_s, one.last_s] if np.isfinite(one.first_s) else None,
                    "up_m": int(self._up[one.number]) / QUANTA_PER_M,
                }
                for one in self.passes
                if self._up[one.number] and (wanted is None or one.psid in wanted)
            ],
        }
        if not content["flightlines"]:
            return None
        data = json.dumps(content, indent=1).encode() + b"\0"
        return Vlr(*KEY, b"shifts of flightlines", data)

    def of_file(self, spans: Mapping[str, Any]) -> Shifted | None:
        """Shifts of the points of a file; None where all of them stay.

        ``spans``: by each point source id of the file; none without times.
        """
        record = self.record(map(int, spans) if spans else None)
        if record is None:
            return None
        return Shifted(lambda psid, time_s: self.of(line_of(psid, time_s, self.passes)), record)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays by name, to be stored."""
        passes = np.array(self.passes, _PASSES)
        return {"passes": passes, "up_q": self._up[passes["number"]]}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Shifts":
        """Shifts that :meth:`to_arrays` gave."""
        return cls([Pass(*row) for row in arrays["passes"].tolist()], arrays["up_q"])


def read_shifts(args: Mapping[str, Any], store: Store) -> Shifts | None:
    """Shifts that a task applies; None where nothing is shifted.

    ``args``: arguments of the task; ``aligned`` where there are shifts.
    """
    if not args.get("aligned"):
        return None
    arrays = read_arrays(store.path(*SHIFTS))
    return Shifts.from_arrays(arrays) if arrays["up_q"].any() else None
