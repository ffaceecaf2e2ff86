"""ICESat-2 ATL03: photons by geolocation segment.

Along-track distance is that of the segment from the equator crossing plus that of the photon
within its segment. Photons lie segment by segment, so ``segment_ph_cnt`` alone shows whose
they are; ``ph_index_beg`` is not looked at, which subsetting tools leave one off.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.hdf5 import dataset, equal_lengths, finite
from spl_batch.altimetry.photon_table import Slice
from spl_batch.errors import InputError
from spl_batch.formats.declared import DAMAGED, bounded

BEAMS: Final = ("gt1l", "gt1r", "gt2l", "gt2r", "gt3l", "gt3r")

_PLACED: Final = ("dist_ph_along", "h_ph", "lat_ph", "lon_ph")
_SEGMENT: Final = ("segment_dist_x", "segment_ph_cnt")


def beams(path: Path, file: h5py.File) -> list[tuple[str, int, str]]:
    """Name, photons and group of each beam, one at least, with all that is needed."""
    found = []
    for name in BEAMS:
        if f"{name}/heights" not in file:
            continue
        count = equal_lengths(path, file, f"{name}/heights", _PLACED)
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
    """Photons of each segment of a beam [count]: whole numbers, none larger than the beam's."""
    name = f"{beam}/geolocation/segment_ph_cnt"
    most = len(dataset(path, file, f"{beam}/heights/h_ph"))
    count: NDArray[Any] = dataset(path, file, name)[()]
    if count.dtype.kind not in "iu":
        raise InputError(str(path), f"{name} holds {count.dtype}, not whole numbers: {DAMAGED}")
    for value in (count.min(initial=0), count.max(initial=0)):
        bounded(path, name, value, most=most)
    return count.astype(np.int64)


def reader(path: Path, file: h5py.File, beam: str) -> tuple[int, Callable[[slice], Slice]]:
    """Photons of a beam [count], and what reads some of them."""
    distance: NDArray[Any] = dataset(path, file, f"{beam}/geolocation/segment_dist_x")[()]
    count = segment_photons(path, file, beam)
    segment, end = distance[count > 0], np.cumsum(count[count > 0])
    heights = file[f"{beam}/heights"]

    def read(rows: slice) -> Slice:
        within, *others = (heights[name][rows].astype(np.float64) for name in _PLACED)
        within[~finite(within)] = np.nan
        at = np.searchsorted(end, np.arange(rows.start, rows.stop), side="right")
        return Slice(segment[at] + within, *others)

    return len(heights["h_ph"]), read
