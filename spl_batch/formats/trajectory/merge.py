"""Trajectory files joined in the order of time, a span at a time, whatever their length.

Records are brought into the survey's CRS batch by batch and wait on disk; those before the next
batch's first record are in order and go on. Of files that are each in time order, a few batches are
in memory at once.
"""

from collections.abc import Callable, Container, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.errors import InputError, grouped
from spl_batch.formats.crs import crs_name
from spl_batch.formats.files.atomic import stop_if_full
from spl_batch.formats.gps_clock import TimeStandard, time_standard
from spl_batch.formats.trajectory.records import (
    CannotConvertError,
    conversions,
    read_records,
)
from spl_batch.formats.trajectory.usable import Records

WAITING_RECORDS: Final = 500_000
"""Records that may wait in memory for their place in time: files in disorder have more [count]."""

_RECORD_BYTES: Final = 32

Clock = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Times to times in another standard."""


class _Batch(NamedTuple):
    """Records side by side on disk: of which file, where, how many, first and last time [s]."""

    file: int
    offset: int
    records: int
    first_s: float
    last_s: float


class Sharing(NamedTuple):
    """Files, by their numbers, that share a time standard; their first and last time [s]."""

    files: tuple[int, ...]
    first_s: float
    last_s: float


class Merge:
    """Records of all files, in the survey's CRS, on disk; a context manager.

    Parameters
    ----------
    folder : Path or None
        Where the records wait; None for the system's place for temporary files.

    Attributes
    ----------
    warnings : list of str
        What had to be done to the records, or could not be.
    dropped : int
        Records that repeat a time, known once all pieces are there [count].
    """

    def __init__(self, paths: Sequence[Path], folder: Path | None = None) -> None:
        self.paths, self._folder = paths, folder
        self.warnings: list[str] = []
        self.dropped = 0
        self._batches: list[_Batch] = []

    def __enter__(self) -> Self:
        self._file: IO[bytes] = TemporaryFile(dir=self._folder)
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, survey_crs: CRS | None, trajectory_crs: str | None) -> None:
        """Read the files; see :func:`~spl_batch.formats.trajectory.records.conversions`.

        Raises
        ------
        InputError
            If one of them cannot be read or converted.
        """
        for file, path in enumerate(self.paths):
            before = len(self._batches)
            for convert, warning in conversions(path, survey_crs, trajectory_crs):
                del self._batches[before:]
                told: list[str] = []
                try:
                    for time, position in read_records(path, told.append):
                        self._keep(file, time, convert(position))
                except CannotConvertError:
                    continue
                self.warnings += [*told, *([warning] if warning else [])]
                break
            else:
                raise InputError(
                    str(path),
                    f"cannot be transformed from {trajectory_crs or 'its CRS'} to "
                    f"{crs_name(survey_crs) if survey_crs else 'none'}",
                )

    def standards(self) -> dict[TimeStandard, Sharing]:
        """Files by the time standard that each has, and the time of all of these."""
        found: dict[TimeStandard, Sharing] = {}
        for file in sorted({batch.file for batch in self._batches}):
            mine = [batch for batch in self._batches if batch.file == file]
            first, last = min(b.first_s for b in mine), max(b.last_s for b in mine)
            standard = time_standard(np.array([first, last]))
            files, low, high = found.get(standard, Sharing((), first, last))
            found[standard] = Sharing((*files, file), min(low, first), max(high, last))
        return found

    def use_clock(self, files: Container[int], clock: Clock) -> None:
        """Bring times of some files into another standard, in which batches may change places."""
        for k, batch in enumerate(self._batches):
            if batch.file in files:
                time, xyz = self._fetch(batch)
                self._batches[k] = self._put(batch.file, batch.offset, clock(time), xyz)

    def pieces(self) -> Iterator[Records]:
        """Records in the order of time, each time once.

        Raises
        ------
        InputError
            If too many wait for their place.
        """
        order = sorted(self._batches, key=lambda batch: (batch.first_s, batch.offset))
        starts = [*(batch.first_s for batch in order[1:]), np.inf][: len(order)]
        waiting: list[Records] = []
        for batch, next_s in zip(order, starts, strict=True):
            waiting.append(self._fetch(batch))
            time, xyz = (np.concatenate(columns) for columns in zip(*waiting, strict=True))
            ready = time < next_s
            waiting = [(time[~ready], xyz[~ready])]
            if len(waiting[0][0]) > WAITING_RECORDS:
                raise InputError(
                    str(self.paths[0]),
                    f"more than {grouped(WAITING_RECORDS)} trajectory records are out of time "
                    "order: sort them by time",
                )
            if ready.any():
                yield self._in_order(time[ready], xyz[ready])

    def _in_order(self, time: NDArray[np.float64], xyz: NDArray[np.float64]) -> Records:
        # Position breaks ties, so that the order of files and records cannot matter.
        order = np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0], time))
        time, xyz = time[order], xyz[order]
        first = np.ones(len(time), dtype=np.bool_)
        first[1:] = np.diff(time) > 0
        self.dropped += int(np.count_nonzero(~first))
        return time[first], xyz[first]

    def _keep(self, file: int, time: NDArray[np.float64], xyz: NDArray[np.float64]) -> None:
        if len(time):
            end = self._batches[-1] if self._batches else _Batch(0, 0, 0, 0.0, 0.0)
            offset = end.offset + end.records * _RECORD_BYTES
            self._batches.append(self._put(file, offset, time, xyz))

    def _put(
        self, file: int, offset: int, time: NDArray[np.float64], xyz: NDArray[np.float64]
    ) -> _Batch:
        try:
            self._file.seek(offset)
            self._file.write(np.column_stack([time, xyz]).tobytes())
        except OSError as error:
            stop_if_full(error, self._folder or "the folder for temporary files")
            raise
        return _Batch(file, offset, len(time), float(time.min()), float(time.max()))

    def _fetch(self, batch: _Batch) -> Records:
        self._file.seek(batch.offset)
        content = self._file.read(batch.records * _RECORD_BYTES)
        records = np.frombuffer(content, dtype=np.float64).reshape(-1, 4)
        return records[:, 0].copy(), records[:, 1:].copy()
