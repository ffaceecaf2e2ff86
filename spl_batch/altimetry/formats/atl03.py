"""ICESat-2 ATL03: photons by geolocation segment.

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
from spl_batch.altimetry.photon_table import Slice
from spl_batch.errors import InputError
from spl_batch.formats.declared import DAMAGED, bounded
from spl_batch.formats.hdf5 import open_hdf5

BEAMS: Final = ("gt1l", "gt1r", "gt2l", "gt2r", "gt3l", "gt3r")

_PHOTON: Final = ("h_ph", "dist_ph_along", "lat_ph", "lon_ph")
_SEGMENT: Final = ("segment_dist_x", "segment_ph_cnt")


def beams(path: Path, file: h5py.File) -> list[tuple[str, int, str]]:
    """Name, photons and group of each beam.

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
        found.append((name, count, f"{name}/heights"))
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
        segment, start = _segments(path, file, beam)
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


def _segments(
    path: Path, file: h5py.File, beam: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Along-track distance and first photon of each segment that holds some."""
    distance: NDArray[Any] = dataset(path, file, f"{beam}/geolocation/segment_dist_x")[()]
    count = segment_photons(path, file, beam)
    some = count > 0
    return distance[some], (np.cumsum(count) - count)[some]
