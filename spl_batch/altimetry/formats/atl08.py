"""ICESat-2 ATL08: its classes of single photons, by position in the ATL03 file, and its ground.

A photon of ATL08 is known by its ATL03 segment and its number within it, from 1. Photons
that ATL08 does not list are noise to it. The two products of a granule have the same name but
for their first five characters; a clip's may have any, so files are tried in turn. Segments are
numbered anew on each track, so the time has to agree as well.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.atl03 import BEAMS, segment_photons
from spl_batch.altimetry.formats.hdf5 import dataset, equal_lengths, finite
from spl_batch.errors import InputError
from spl_batch.formats.hdf5 import SIGNATURE, open_hdf5
from spl_batch.formats.las.header import open_input

T = TypeVar("T")

_PHOTON: Final = ("classed_pc_flag", "classed_pc_indx", "ph_segment_id", "delta_time")

_SEGMENT: Final = ("segment_id", "delta_time", "segment_dist_x")

_LAND: Final = ("segment_id_beg", "delta_time")

_FIT_20M, _FIT_100M = "terrain/h_te_best_fit_20m", "terrain/h_te_best_fit"
"""Heights of the terrain by segment of ATL03, and, in early releases alone, by five of them."""

_HALF_SEGMENT_M: Final = 10.0
"""From the start of a segment of ATL03 to its middle [m]."""

_SAME_TIME_S: Final = 1.0
"""A photon is nearer than this to its segment's time [s]; a segment is 20 m, another pass a day."""

SLICE_PHOTONS: Final = 262_144
"""Photons of an ATL08 file that are read at once [count]."""


class Segments(NamedTuple):
    """Segments of an ATL03 beam."""

    number: NDArray[np.int64]
    time_s: NDArray[np.float64]
    along_m: NDArray[np.float64]  #: Along-track distance of its start [m].
    photons: NDArray[np.int64]
    start: NDArray[np.int64]  #: Its first photon.

    def find(self, number: NDArray[Any], time_s: Any) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Segment of each number, and whether it is that one, by its number and its time [s]."""
        at = np.minimum(np.searchsorted(self.number, number), len(self.number) - 1)
        same = np.abs(time_s - self.time_s[at]) < _SAME_TIME_S
        return at, (self.number[at] == number) & same


class PhotonClasses(NamedTuple):
    """What an ATL08 file has of the photons of an ATL03 beam."""

    first: int  #: First photon of the stretch that it classified.
    #: (n,): whether each photon from there is ground, canopy or its top.
    signal: NDArray[np.bool_]


def find_labels(atl03: Path, files: Sequence[Path], beam: str) -> PhotonClasses | None:
    """Classes of a beam's photons, from the first file that has its segments.

    Raises
    ------
    InputError
        If a file cannot be read or lacks what is needed.
    """
    return _first_of(atl03, files, (beam, "signal_photons"), _classes)


def terrain_heights(atl03: Path, files: Sequence[Path], beam: str) -> NDArray[np.float64]:
    """Terrain that ATL08 fits along a beam, (m, 2) float64: along-track distance, height [m].

    A height is of a segment of ATL03, some 20 m, and lies at its middle; where a release has
    fits of 100 m alone, at the middle of these. From the first file that has some of this beam.

    Raises
    ------
    InputError
        If a file cannot be read or lacks what is needed.
    """
    found = _first_of(atl03, files, (beam, "land_segments"), _fitted)
    return np.empty((0, 2)) if found is None else found


def _first_of(
    atl03: Path,
    files: Sequence[Path],
    wanted: tuple[str, str],
    read: Callable[[Path, h5py.File, str, Segments], T | None],
) -> T | None:
    """What the first file with some of a beam's segments has in a group; None without one."""
    beam, group = wanted
    if not files:
        return None
    segments = _segments(atl03, beam)
    for path in files if len(segments.number) else ():
        with open_hdf5(path) as file:
            if f"{beam}/{group}" in file:
                found = read(path, file, f"{beam}/{group}", segments)
                if found is not None:
                    return found
    return None


def _segments(atl03: Path, beam: str) -> Segments:
    """Segments of a beam of ATL03."""
    with open_hdf5(atl03) as file:
        equal_lengths(atl03, file, f"{beam}/geolocation", (*_SEGMENT, "segment_ph_cnt"))
        count = segment_photons(atl03, file, beam)
        number, time_s, along_m = (
            dataset(atl03, file, f"{beam}/geolocation/{name}")[()] for name in _SEGMENT
        )
    start = np.cumsum(count) - count
    return Segments(number.astype(np.int64), time_s, along_m.astype(np.float64), count, start)


def _classes(path: Path, file: h5py.File, group: str, segments: Segments) -> PhotonClasses | None:
    """Classes of the photons that lie in these segments."""
    photons = equal_lengths(path, file, group, _PHOTON)
    seen, rows = [], [np.empty(0, np.int64)]
    for first in range(0, photons, SLICE_PHOTONS):
        flag, index, number, time_s = (
            file[f"{group}/{name}"][first : first + SLICE_PHOTONS] for name in _PHOTON
        )
        at, fits = segments.find(number, time_s)
        fits &= (index >= 1) & (index <= segments.photons[at])
        if fits.any():
            seen += [at[fits].min(), at[fits].max()]
        signal = fits & (flag >= 1)
        rows.append(segments.start[at[signal]] + index[signal].astype(np.int64) - 1)
    if not seen:
        return None
    low, last = int(segments.start[min(seen)]), max(seen)
    signal = np.zeros(int(segments.start[last] + segments.photons[last]) - low, np.bool_)
    signal[np.concatenate(rows) - low] = True
    return PhotonClasses(low, signal)


def _fitted(
    path: Path, file: h5py.File, group: str, segments: Segments
) -> NDArray[np.float64] | None:
    """Heights of a file that lie on these segments, in order of distance."""
    count = equal_lengths(path, file, group, _LAND)
    fine = f"{group}/{_FIT_20M}" in file
    fit = dataset(path, file, f"{group}/{_FIT_20M if fine else _FIT_100M}")
    if fit.ndim != 1 + fine or len(fit) != count:
        raise InputError(str(path), f"{fit.name} has shape {fit.shape} for {count} segments")
    height = fit[()].astype(np.float64).reshape(count, -1)
    first, time_s = (file[f"{group}/{name}"][()] for name in _LAND)
    offset = np.arange(height.shape[1]) if fine else np.array([2])
    at, fits = segments.find(first.astype(np.int64)[:, None] + offset, time_s[:, None])
    fits &= finite(height)
    found = np.column_stack([segments.along_m[at[fits]] + _HALF_SEGMENT_M, height[fits]])
    return found[np.argsort(found[:, 0], kind="stable")] if len(found) else None


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
