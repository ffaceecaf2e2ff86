"""ICESat-2 ATL08: its classes of single photons, by position in the ATL03 file.

A photon of ATL08 is known by its ATL03 segment and its number within it, from 1. Photons
that ATL08 does not list are noise to it. The two products of a granule have the same name but
for their first five characters; a clip's may have any, so files are tried in turn. Segments are
numbered anew on each track, so the time has to agree as well.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import h5py
import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.atl03 import segment_photons
from spl_batch.altimetry.formats.hdf5 import dataset, equal_lengths
from spl_batch.formats.hdf5 import open_hdf5

_PHOTON: Final = ("classed_pc_flag", "classed_pc_indx", "ph_segment_id", "delta_time")

_SEGMENT: Final = ("segment_id", "segment_ph_cnt", "delta_time")

_SAME_TIME_S: Final = 1.0
"""A photon is nearer than this to its segment's time [s]; a segment is 20 m, another pass a day."""

SLICE_PHOTONS: Final = 262_144
"""Photons of an ATL08 file that are read at once [count]."""


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments of an ATL03 beam: their numbers, times [s], photons and first photons."""

    number: NDArray[np.int64]
    time_s: NDArray[np.float64]
    count: NDArray[np.int64]
    start: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Slice:
    """Consecutive photons of an ATL08 file, and the ATL03 photons among which they lie."""

    at: tuple[int, int]  #: Where in the ATL08 file: first, stop.
    rows: tuple[int, int]  #: Where in the ATL03 beam, to whole segments: first, stop.


@dataclass(frozen=True, slots=True)
class PhotonClasses:
    """What an ATL08 file says of the photons of an ATL03 beam, read a stretch at a time."""

    path: Path  #: The ATL08 file.
    beam: str
    segments: Segments  #: Of the ATL03 file.
    slices: tuple[Slice, ...]  #: The parts of the ATL08 file that speak of it.

    @property
    def rows(self) -> tuple[int, int]:
        """First photon of the stretch that it classified, and the one after the last."""
        return min(s.rows[0] for s in self.slices), max(s.rows[1] for s in self.slices)

    def signal(self, first: int, stop: int) -> NDArray[np.bool_]:
        """Whether each photon ``first <= row < stop`` is ground, canopy or its top to ATL08, (n,).

        Raises
        ------
        InputError
            If the file cannot be read any more.
        """
        found = np.zeros(stop - first, np.bool_)
        wanted = [s for s in self.slices if s.rows[0] < stop and s.rows[1] > first]
        with open_hdf5(self.path) as file:
            for part in wanted:
                segment, row, flag = _located(file, self.beam, part.at, self.segments)
                row = row[(flag >= 1) & (segment >= 0)]
                found[row[(row >= first) & (row < stop)] - first] = True
        return found


def find_labels(atl03: Path, files: Iterable[Path], beam: str) -> PhotonClasses | None:
    """Classes of a beam's photons, from the first file that has its segments.

    Raises
    ------
    InputError
        If a file cannot be read or lacks what is needed.
    """
    with open_hdf5(atl03) as file:
        equal_lengths(atl03, file, f"{beam}/geolocation", _SEGMENT)
        count = segment_photons(atl03, file, beam)
        number = dataset(atl03, file, f"{beam}/geolocation/segment_id")[()].astype(np.int64)
        time_s = dataset(atl03, file, f"{beam}/geolocation/delta_time")[()]
    segments = Segments(number, time_s, count, np.cumsum(count) - count)
    for path in files if len(number) else ():
        with open_hdf5(path) as file:
            group = f"{beam}/signal_photons"
            if group in file:
                photons = equal_lengths(path, file, group, _PHOTON)
                slices = tuple(_slices(file, beam, photons, segments))
                if slices:
                    return PhotonClasses(path, beam, segments, slices)
    return None


def _slices(file: h5py.File, beam: str, photons: int, segments: Segments) -> Iterator[Slice]:
    """Slices of an ATL08 file with photons of these segments."""
    for first in range(0, photons, SLICE_PHOTONS):
        at = (first, min(first + SLICE_PHOTONS, photons))
        segment, _, _ = _located(file, beam, at, segments)
        segment = segment[segment >= 0]
        if len(segment):
            low, last = segment.min(), segment.max()
            stop = segments.start[last] + segments.count[last]
            yield Slice(at, (int(segments.start[low]), int(stop)))


def _located(
    file: h5py.File, beam: str, at: tuple[int, int], segments: Segments
) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.int64]]:
    """Segment of each photon of a slice, -1 where it is none of these; its row, and its class."""
    columns = (file[f"{beam}/signal_photons/{name}"][slice(*at)] for name in _PHOTON)
    flag, index, number, time_s = columns
    segment = np.searchsorted(segments.number, number)
    segment = np.minimum(segment, len(segments.number) - 1)
    fits = (segments.number[segment] == number) & (index >= 1) & (index <= segments.count[segment])
    fits &= np.abs(time_s - segments.time_s[segment]) < _SAME_TIME_S
    row = segments.start[segment] + index.astype(np.int64) - 1
    return np.where(fits, segment, -1), row, flag
