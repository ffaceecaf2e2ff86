"""Files laid out like MABEL L2A: a group of photons for each channel.

::

    photon/channelNNN/{delta_time, elev, latitude, longitude}   one value per photon

Along-track distance is time times the mean speed over ground, from the whole second in which
the channel's first photon was recorded.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from spl_batch.altimetry.formats.hdf5 import equal_lengths, finite
from spl_batch.altimetry.photon_table import Slice
from spl_batch.errors import InputError
from spl_batch.formats.files.atomic import replacing

_PHOTON: Final = ("delta_time", "elev", "latitude", "longitude")


def beams(path: Path, file: h5py.File) -> list[tuple[str, int, str]]:
    """Name, photons and group of each channel, one at least, with all that is needed."""
    found = [
        (name, equal_lengths(path, file, f"photon/{name}", _PHOTON), f"photon/{name}")
        for name in sorted(file["photon"])
    ]
    if not found:
        raise InputError(str(path), "group photon holds no channel")
    return found


def reader(path: Path, file: h5py.File, beam: str) -> tuple[int, Callable[[slice], Slice]]:
    """Photons of a channel [count], and what reads some of them."""
    group = file[f"photon/{beam}"]
    count = len(group["elev"])
    origin, speed = _motion(path, group) if count else (0.0, 0.0)

    def read(rows: slice) -> Slice:
        time, *others = (group[name][rows].astype(np.float64) for name in _PHOTON)
        return Slice((time - origin) * speed, *others)

    return count, read


def _motion(path: Path, group: h5py.Group) -> tuple[float, float]:
    """Time of along-track zero [s] and speed over ground [m/s]."""
    time = group["delta_time"]
    ends = {name: (float(group[name][0]), float(group[name][-1])) for name in _PHOTON}
    known = all(finite(np.array(ends[k])).all() for k in ("delta_time", "latitude", "longitude"))
    duration = ends["delta_time"][1] - ends["delta_time"][0] if known else 0.0
    if duration <= 0:
        raise InputError(
            str(path),
            f"{group.name}: times from {time[0]} to {time[-1]} s; sort the photons by time",
        )
    (lat0, lat1), (lon0, lon1) = ends["latitude"], ends["longitude"]
    _, _, distance = Geod(ellps="WGS84").inv(lon0, lat0, lon1, lat1)
    if distance <= 0:
        raise InputError(str(path), f"{group.name}: first and last photon are at one position")
    return float(np.floor(ends["delta_time"][0])), distance / duration


def write_mabel(path: Path, channels: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
    """Write a file of this layout: by channel delta_time, elev, latitude, longitude and others."""
    with replacing(path) as temporary, h5py.File(temporary, "w") as file:
        for name, columns in channels.items():
            for key, values in columns.items():
                file.create_dataset(f"photon/{name}/{key}", data=values, compression="gzip")
