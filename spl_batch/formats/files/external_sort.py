"""Rows of any number in the order of their keys: sorted stretches wait on disk.

Each stretch of rows is sorted and put on disk, with the key of its first row and of each further
:data:`SAMPLE_ROWS`-th. These keys say where to cut all stretches so that few rows lie between two
cuts: these are read, sorted and handed on. Memory depends neither on the number of rows nor on
their order, but for 8 bytes of each :data:`SAMPLE_ROWS` rows, and :data:`SAMPLE_ROWS` rows of each
stretch that reaches between two cuts.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spl_batch.formats.files.atomic import stop_if_full

STRETCH_ROWS: Final = 262_144
"""Rows that are sorted at once [count]."""

SAMPLE_ROWS: Final = 1024
"""Rows between two keys of the sample [count]."""


_END: Final = int(np.iinfo(np.int64).max)


class _Stretch(NamedTuple):
    """A sorted stretch on disk: first byte, rows, first keys of a sample and of the last row."""

    offset: int
    rows: int
    sample: NDArray[np.int64]
    last: int


class Sorter:
    """Rows that wait on disk to be put in order; a context manager.

    Parameters
    ----------
    dtypes : mapping of str to dtype
        Columns. Those of the key come first and are integers.
    keys : int
        Columns of the key [count]. Rows of one first key are held in memory together.
    folder : Path or None
        Where rows wait; None for the system's place for temporary files.
    stretch_rows : int
        Rows that are in memory at once, roughly [count].
    """

    def __init__(
        self,
        dtypes: Mapping[str, DTypeLike],
        keys: int,
        folder: Path | None = None,
        stretch_rows: int = STRETCH_ROWS,
    ) -> None:
        self._dtype = np.dtype([(name, np.dtype(kind)) for name, kind in dtypes.items()])
        self._keys = list(dtypes)[:keys]
        self._folder, self._most = folder, stretch_rows
        self._step = max(1, min(SAMPLE_ROWS, stretch_rows // 16))
        self._stretches: list[_Stretch] = []

    def __enter__(self) -> Self:
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
        self._file: IO[bytes] = TemporaryFile(dir=self._folder)
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return sum(stretch.rows for stretch in self._stretches)

    def add(self, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.intp]:
        """Take in a stretch of rows: (n,) intp, its rows in the order of their keys.

        ``columns``: mapping of str to (n,) ndarray, all columns.
        """
        order = np.lexsort([columns[key] for key in reversed(self._keys)])
        if not len(order):
            return order
        rows = np.empty(len(order), self._dtype)
        for name in columns:
            rows[name] = columns[name][order]
        end = self._stretches[-1] if self._stretches else _Stretch(0, 0, np.empty(0, np.int64), 0)
        offset = end.offset + end.rows * self._dtype.itemsize
        try:
            self._file.seek(offset)
            self._file.write(rows.view(np.uint8).data)
        except OSError as error:
            stop_if_full(error, self._folder or "the folder for temporary files")
            raise
        key = rows[self._keys[0]]
        sample = key[:: self._step].astype(np.int64)
        self._stretches.append(_Stretch(offset, len(rows), sample, int(key[-1])))
        return order

    def in_order(self) -> Iterator[dict[str, NDArray[Any]]]:
        """All rows in the order of their keys, part by part.

        Rows of one first key come in one part; rows with the same key in the order in which
        they were added.

        Yields
        ------
        dict of str to (m,) ndarray
        """
        samples = [np.empty(0, np.int64), *(s.sample for s in self._stretches)]
        # The first row of each stretch is among them: the first cut is before all rows.
        sample = np.sort(np.concatenate(samples))
        cuts = sorted(set(sample[:: max(1, self._most // self._step)].tolist()))
        for low, high in pairwise([*cuts, _END]):
            near = [s for s in self._stretches if s.sample[0] < high and s.last >= low]
            rows = np.concatenate([self._between(stretch, low, high) for stretch in near])
            if len(near) > 1:
                rows = rows[np.lexsort([rows[key] for key in reversed(self._keys)])]
            yield {name: np.ascontiguousarray(rows[name]) for name in self._dtype.names or ()}

    def _between(self, stretch: _Stretch, low: int, high: int) -> NDArray[Any]:
        """Rows of a stretch with first keys from one up to another."""
        before, after = np.searchsorted(stretch.sample, [low, high]).tolist()
        first = max(before - 1, 0) * self._step
        last = min(after * self._step, stretch.rows)
        self._file.seek(stretch.offset + first * self._dtype.itemsize)
        rows = np.frombuffer(self._file.read((last - first) * self._dtype.itemsize), self._dtype)
        start, stop = np.searchsorted(rows[self._keys[0]], [low, high]).tolist()
        found: NDArray[Any] = rows[start:stop]
        return found


def repeated(columns: Mapping[str, NDArray[Any]], keys: Sequence[str]) -> NDArray[np.intp]:
    """Rows that have the key of the one before them, of rows in order: (k,) intp."""
    same = np.ones(max(len(columns[keys[0]]) - 1, 0), np.bool_)
    for key in keys:
        same &= columns[key][1:] == columns[key][:-1]
    return np.flatnonzero(same) + 1
