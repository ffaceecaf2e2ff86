"""ICESat-2 ATL08: its classes of single photons, by position in the ATL03 file, and its ground.

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

from spl_batch.altimetry.formats.atl03 import BEAMS, segment_photons
from spl_batch.altimetry.formats.hdf5 import dataset, equal_lengths, finite
from spl_batch.errors import InputError
from spl_batch.formats.hdf5 import SIGNATURE, open_hdf5
from spl_batch.formats.las.header import open_input

_PHOTON: Final = ("classed_pc_flag", "classed_pc_indx", "ph_segment_id", "delta_time")

_SEGMENT: Final = ("segment_id", "segment_ph_cnt", "delta_time", "segment_dist_x")

_LAND: Final = ("segment_id_beg", "delta_time")

_FIT_20M, _FIT_100M = "terrain/h_te_best_fit_20m", "terrain/h_te_best_fit"
"""Heights of the terrain by segment of ATL03, and, in early releases alone, by five of them."""

_HALF_SEGMENT_M: Final = 10.0
"""From the start of a segment of ATL03 to its middle [m]."""

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
    along_m: NDArray[np.float64]  #: Along-track distance of its start [m].


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
    segments = _segments(atl03, beam)
    for path in files if len(segments.number) else ():
        with open_hdf5(path) as file:
            group = f"{beam}/signal_photons"
            if group in file:
                photons = equal_lengths(path, file, group, _PHOTON)
                slices = tuple(_slices(file, beam, photons, segments))
                if slices:
                    return PhotonClasses(path, beam, segments, slices)
    return None


def _segments(atl03: Path, beam: str) -> Segments:
    """Segments of a beam of ATL03."""
    with open_hdf5(atl03) as file:
        equal_lengths(atl03, file, f"{beam}/geolocation", _SEGMENT)
        count = segment_photons(atl03, file, beam)
        number, time_s, along_m = (
            dataset(atl03, file, f"{beam}/geolocation/{name}")[()]
            for name in ("segment_id", "delta_time", "segment_dist_x")
        )
    start = np.cumsum(count) - count
    return Segments(number.astype(np.int64), time_s, count, start, along_m.astype(np.float64))


def terrain_heights(atl03: Path, files: Iterable[Path], beam: str) -> NDArray[np.float64]:
    """Terrain that ATL08 fits along a beam, (m, 2) float64: along-track distance, height [m].

    A height is of a segment of ATL03, some 20 m, and stands at its middle; where a release has
    fits of 100 m alone, at the middle of these. From the first file that has some of this beam.

    Raises
    ------
    InputError
        If a file cannot be read or lacks what is needed.
    """
    wanted = list(files)
    if not wanted:
        return np.empty((0, 2))
    segments = _segments(atl03, beam)
    for path in wanted if len(segments.number) else ():
        with open_hdf5(path) as file:
            if f"{beam}/land_segments" in file:
                found = _fitted(path, file, f"{beam}/land_segments", segments)
                if len(found):
                    return found
    return np.empty((0, 2))


def _fitted(path: Path, file: h5py.File, group: str, segments: Segments) -> NDArray[np.float64]:
    """Heights of a file that lie on these segments, in order of distance."""
    count = equal_lengths(path, file, group, _LAND)
    fine = f"{group}/{_FIT_20M}" in file
    fit = dataset(path, file, f"{group}/{_FIT_20M if fine else _FIT_100M}")
    if fit.ndim != 1 + fine or len(fit) != count:
        raise InputError(str(path), f"{fit.name} has shape {fit.shape} for {count} segments")
    height = fit[()].astype(np.float64).reshape(count, -1)
    first, time_s = (file[f"{group}/{name}"][()] for name in _LAND)
    offset = np.arange(height.shape[1]) if fine else np.array([2])
    number = first.astype(np.int64)[:, None] + offset
    at = np.minimum(np.searchsorted(segments.number, number), len(segments.number) - 1)
    fits = (segments.number[at] == number) & finite(height)
    fits &= np.abs(time_s[:, None] - segments.time_s[at]) < _SAME_TIME_S
    found = np.column_stack([segments.along_m[at[fits]] + _HALF_SEGMENT_M, height[fits]])
    ordered: NDArray[np.float64] = found[np.argsort(found[:, 0], kind="stable")]
    return ordered


def no_atl08(path: Path) -> str:
    """Why a file is none of ATL08, as a kind of finding P01; empty where it is one.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    with open_input(path) as stream:
        if stream.read(len(SIGNATURE)) != SIGNATURE:
            return "no hdf5"
    with open_hdf5(path) as file:
        if any(f"{beam}/signal_photons" in file for beam in BEAMS):
            return ""
        return "atl03" if any(f"{beam}/heights" in file for beam in BEAMS) else "no atl08"


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
