"""ICESat-2 ATL08: its classes of single photons, by position in the ATL03 file.

A photon of ATL08 is known by its ATL03 segment and its number within it, from 1. Photons
that ATL08 does not list are noise to it. The two products of a granule have the same name but
for their first five characters; a clip's may have any, so files are tried in turn. Segments are
numbered anew on each track, so the time has to agree as well.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.io.hdf5 import dataset, equal_lengths, open_hdf5

_PHOTON: Final = ("classed_pc_flag", "classed_pc_indx", "ph_segment_id", "delta_time")

_SAME_TIME_S: Final = 1.0
"""A photon is nearer than this to its segment's time [s]; a segment is 20 m, another pass a day."""


@dataclass(frozen=True, slots=True)
class PhotonClasses:
    """Photons of an ATL03 beam that an ATL08 file speaks of.

    Parameters
    ----------
    rows : (int, int)
        First photon of the stretch that it classified, and the one after the last.
    signal : (n,) bool
        Whether each of them is ground, canopy or top of canopy to it.
    """

    rows: tuple[int, int]
    signal: NDArray[np.bool_]


def read_labels(atl03: Path, files: Iterable[Path], beam: str) -> PhotonClasses | None:
    """Classes of a beam's photons, from the first file that has its segments.

    Raises
    ------
    InputError
        If a file cannot be read or lacks what is needed.
    """
    with open_hdf5(atl03) as file:
        count = dataset(atl03, file, f"{beam}/geolocation/segment_ph_cnt")[()].astype(np.int64)
        segment = dataset(atl03, file, f"{beam}/geolocation/segment_id")[()].astype(np.int64)
        time = dataset(atl03, file, f"{beam}/geolocation/delta_time")[()]
    start = np.cumsum(count) - count
    for path in files:
        with open_hdf5(path) as file:
            group = f"{beam}/signal_photons"
            if group not in file:
                continue
            equal_lengths(path, file, group, _PHOTON)
            flag, number, theirs, when = (file[f"{group}/{name}"][()] for name in _PHOTON)
        at = np.searchsorted(segment, theirs)
        at_safe = np.minimum(at, len(segment) - 1)
        fits = (segment[at_safe] == theirs) & (number >= 1) & (number <= count[at_safe])
        fits &= np.abs(when - time[at_safe]) < _SAME_TIME_S
        if not fits.any():
            continue
        row = start[at_safe[fits]] + number[fits] - 1
        covered = np.unique(at_safe[fits])
        low, last = int(start[covered[0]]), covered[-1]
        high = int(start[last] + count[last])
        signal = np.zeros(high - low, np.bool_)
        signal[row[flag[fits] >= 1] - low] = True
        return PhotonClasses((low, high), signal)
    return None
