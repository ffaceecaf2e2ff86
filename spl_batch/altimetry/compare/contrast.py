"""Delivered labels of several methods: where they differ, and the place where they differ most."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.photon_table import NOT_ASSESSED, SIGNAL
from spl_batch.formats.verified.parquet_npz import read_groups, reading

STRETCH_M: Final = 2000.0
"""Length of track that is shown [m]."""

_COLUMNS: Final = ("along_track", "height", "signal")


@dataclass(frozen=True, slots=True)
class Disputed:
    """A stretch of a beam as several methods see it."""

    beam: str
    #: (n,): its photons [m].
    along_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    signal: dict[str, NDArray[np.bool_]]  #: dict of str to (n,) bool: signal by method.


@dataclass(frozen=True, slots=True)
class Contrast:
    """Methods against the first of them."""

    #: Photons that each method keeps and the first removes, and the other way round [count].
    kept_only: dict[str, int]
    removed_only: dict[str, int]
    disputed: Disputed | None  #: Stretch in which they disagree about most photons.


def contrast(outputs: Mapping[str, Path]) -> Contrast:
    """Compare the photon tables of several outputs, beam by beam.

    Parameters
    ----------
    outputs : mapping of str to Path
        Output folder of each method; the first is what others differ from.
    """
    kept_only, removed_only = dict.fromkeys(outputs, 0), dict.fromkeys(outputs, 0)
    disagreed: Counter[tuple[str, int]] = Counter()
    for beam in _beams(outputs):
        for part in _groups(outputs, beam):
            signal = _signal(part)
            first = next(iter(signal.values()))
            for method, kept in signal.items():
                kept_only[method] += int(np.count_nonzero(kept & ~first))
                removed_only[method] += int(np.count_nonzero(first & ~kept))
            stacked = np.stack(list(signal.values()))
            other = stacked.any(axis=0) & ~stacked.all(axis=0)
            along = next(iter(part.values()))["along_track"][other]
            stretch, count = np.unique(np.floor(along / STRETCH_M), return_counts=True)
            for number, times in zip(stretch.tolist(), count.tolist(), strict=True):
                disagreed[beam, int(number)] += times
    if not disagreed:
        return Contrast(kept_only, removed_only, None)
    beam, number = min(disagreed, key=lambda place: (-disagreed[place], place))
    return Contrast(kept_only, removed_only, _stretch(outputs, beam, number))


def _beams(outputs: Mapping[str, Path]) -> list[str]:
    """Photon tables that every method has delivered."""
    listed = [
        {str(p.relative_to(out / "photons")) for p in (out / "photons").rglob("*.parquet")}
        for out in outputs.values()
    ]
    return sorted(set.intersection(*listed))


def _groups(outputs: Mapping[str, Path], beam: str) -> Iterator[dict[str, dict[str, NDArray[Any]]]]:
    """Rows of a beam by method, a row group at a time: all tables are in the order of the file."""
    with reading(outputs[next(iter(outputs))] / "photons" / beam) as file:
        groups = file.num_row_groups
    for group in range(groups):
        part = {}
        for method, output in outputs.items():
            with reading(output / "photons" / beam) as file:
                part[method] = read_groups(file, _COLUMNS, [group])
        yield part


def _signal(part: Mapping[str, Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[np.bool_]]:
    """Signal by method, of the photons that all have assessed; noise elsewhere."""
    known = np.logical_and.reduce([rows["signal"] != NOT_ASSESSED for rows in part.values()])
    return {method: known & (rows["signal"] == SIGNAL) for method, rows in part.items()}


def _stretch(outputs: Mapping[str, Path], beam: str, number: int) -> Disputed:
    """Photons of a stretch of a beam."""
    along, height = [], []
    signal: dict[str, list[NDArray[np.bool_]]] = {method: [] for method in outputs}
    for part in _groups(outputs, beam):
        rows = next(iter(part.values()))
        # Photons without a place have no number and lie in no stretch.
        inside = np.floor(rows["along_track"] / STRETCH_M) == number
        along.append(rows["along_track"][inside])
        height.append(rows["height"][inside])
        for method, kept in _signal(part).items():
            signal[method].append(kept[inside])
    joined = {method: np.concatenate(kept) for method, kept in signal.items()}
    name = beam.removesuffix(".parquet")
    return Disputed(name, np.concatenate(along), np.concatenate(height), joined)
