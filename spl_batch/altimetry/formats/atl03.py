"""ICESat-2 ATL03: photons by geolocation segment, background rate every 50 shots.

Along-track distance is that of the segment from the equator crossing plus that of the photon
within its segment. Photons lie segment by segment, so ``segment_ph_cnt`` alone says whose
they are; ``ph_index_beg`` is not looked at, which subsetting tools leave one off.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.hdf5 import dataset, equal_lengths, finite
from spl_batch.altimetry.formats.slices import Slice
from spl_batch.altimetry.photon_table import Background
from spl_batch.constants import SPEED_OF_LIGHT_M_S
from spl_batch.errors import InputError
from spl_batch.formats.declared import DAMAGED, bounded
from spl_batch.formats.hdf5 import open_hdf5

BEAMS: Final = ("gt1l", "gt1r", "gt2l", "gt2r", "gt3l", "gt3r")

PRF_HZ: Final = 10_000.0
"""Pulse repetition frequency of ATLAS [Hz]."""

_PHOTON: Final = ("h_ph", "dist_ph_along", "lat_ph", "lon_ph")
_SEGMENT: Final = ("segment_dist_x", "segment_ph_cnt", "delta_time")


def beams(path: Path, file: h5py.File) -> list[tuple[str, int, str, bool]]:
    """Name, photons, group and whether there is a background rate, of each beam.

    Raises
    ------
    InputError
        If there is no beam, or one lacks what is needed.
    """
    found = []
    for name in BEAMS:
        if f"{name}/heights" not in file:
            continue
        count = equal_lengths(path, file, f"{name}/heights", _PHOTON)
        equal_lengths(path, file, f"{name}/geolocation", _SEGMENT)
        placed = int(segment_photons(path, file, name).sum())
        if placed != count:
            raise InputError(
                str(path),
                f"{name}: segments count {placed} photons, there are {count}; subset it again",
            )
        rate = f"{name}/bckgrd_atlas/bckgrd_rate" in file
        found.append((name, count, f"{name}/heights", rate))
    if not found:
        raise InputError(
            str(path), "neither gtxx/heights (ATL03) nor photon/channelxxx (MABEL) in it"
        )
    return found


def segment_photons(path: Path, file: h5py.File, beam: str) -> NDArray[np.int64]:
    """Photons of each segment of a beam [count]: none is negative, their sum is a whole number.

    Raises
    ------
    InputError
        If one is not from 0 to the photons of the beam.
    """
    name = f"{beam}/geolocation/segment_ph_cnt"
    most = len(dataset(path, file, f"{beam}/heights/h_ph"))
    count: NDArray[Any] = dataset(path, file, name)[()]
    if count.dtype.kind not in "iu":
        raise InputError(str(path), f"{name} holds {count.dtype}, not whole numbers: {DAMAGED}")
    for value in (count.min(initial=0), count.max(initial=0)):
        bounded(path, name, value, most=most)
    return count.astype(np.int64)


def slices(path: Path, beam: str, chunk: int) -> Iterator[Slice]:
    """Photons of a beam in slices."""
    with open_hdf5(path) as file:
        segment, _, start = _segments(path, file, beam)
        heights = file[f"{beam}/heights"]
        total = len(heights["h_ph"])
        for first in range(0, total, chunk):
            rows = slice(first, min(first + chunk, total))
            at = np.searchsorted(start, np.arange(rows.start, rows.stop), side="right") - 1
            within = heights["dist_ph_along"][rows].astype(np.float64)
            within[~finite(within)] = np.nan
            yield Slice(
                first,
                segment[at] + within,
                heights["h_ph"][rows].astype(np.float64),
                heights["lat_ph"][rows].astype(np.float64),
                heights["lon_ph"][rows].astype(np.float64),
            )


def background(path: Path, beam: str) -> Background | None:
    """Background rate along the track, or none."""
    with open_hdf5(path) as file:
        if f"{beam}/bckgrd_atlas/bckgrd_rate" not in file:
            return None
        equal_lengths(path, file, f"{beam}/bckgrd_atlas", ("bckgrd_rate", "delta_time"))
        along, time, _ = _segments(path, file, beam)
        at = file[f"{beam}/bckgrd_atlas/delta_time"][()]
        rate = file[f"{beam}/bckgrd_atlas/bckgrd_rate"][()].astype(np.float64)
    rising = np.flatnonzero(np.diff(time, prepend=-np.inf) > 0)
    along, time = along[rising], time[rising]
    if len(time) < 2:
        return None
    # A clip keeps the rate of the whole granule; what lies far from its photons is of no use.
    near = (at >= time[0] - 1.0) & (at <= time[-1] + 1.0)
    speed = float((along[-1] - along[0]) / (time[-1] - time[0]))
    beyond = (at[near] - np.clip(at[near], time[0], time[-1])) * speed
    per_m2 = rate[near] * (2.0 / SPEED_OF_LIGHT_M_S) * PRF_HZ / speed
    return Background(np.interp(at[near], time, along) + beyond, per_m2)


def _segments(
    path: Path, file: h5py.File, beam: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Along-track distance, time, and first photon of each segment that holds some."""

    def column(name: str) -> NDArray[Any]:
        values: NDArray[Any] = dataset(path, file, f"{beam}/geolocation/{name}")[()]
        return values

    count = segment_photons(path, file, beam)
    some = count > 0
    start = (np.cumsum(count) - count)[some]
    return column("segment_dist_x")[some], column("delta_time")[some], start
