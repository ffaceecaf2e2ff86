"""SBET: smoothed best estimate of trajectory, as Applanix POSPac writes it."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import InputError
from spl_batch.formats.las.header import open_input
from spl_batch.formats.trajectory.usable import MOST_WRONG

SBET_RECORD: Final = np.dtype(
    [
        (name, "<f8")
        for name in (
            "time",
            "latitude",
            "longitude",
            "altitude",
            "x_velocity",
            "y_velocity",
            "z_velocity",
            "roll",
            "pitch",
            "platform_heading",
            "wander_angle",
            "x_acceleration",
            "y_acceleration",
            "z_acceleration",
            "x_angular_rate",
            "y_angular_rate",
            "z_angular_rate",
        )
    ]
)
"""One record: 17 little-endian doubles; seconds, radians, metres."""

BLOCK_RECORDS: Final = 65_536
"""Records read at once [count]."""

SBET_SUFFIXES: Final = frozenset({".out", ".sbet"})


def read_sbet(path: Path) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Times and positions of an SBET file, some records at a time.

    Yields
    ------
    time_s : (n,) float64
        As the file has them, mostly seconds of the GPS week [s].
    lon_lat_height : (n, 3) float64
        Longitude and latitude [deg], ellipsoidal height [m].

    Raises
    ------
    InputError
        If the size is no whole number of records, or most angles are none.
    """
    with open_input(path) as file:
        size = file.seek(0, os.SEEK_END)
        if size % SBET_RECORD.itemsize:
            raise InputError(
                str(path),
                f"has {size} bytes, an SBET a multiple of {SBET_RECORD.itemsize}:"
                " it is cut off or not an SBET, copy it again",
            )
        file.seek(0)
        for start in range(0, size // SBET_RECORD.itemsize, BLOCK_RECORDS):
            records = np.frombuffer(file.read(BLOCK_RECORDS * SBET_RECORD.itemsize), SBET_RECORD)
            # Copied, because a record has four times what is wanted of it.
            yield records["time"].astype(np.float64), _position(path, records, start)


def _position(path: Path, records: NDArray[np.void], start: int) -> NDArray[np.float64]:
    """Longitude, latitude [deg] and height [m] of records, the first of which has this number."""
    latitude, longitude = records["latitude"], records["longitude"]
    # Written so that NaN counts as wrong.
    wrong = ~((np.abs(latitude) <= np.pi / 2) & (np.abs(longitude) <= 2 * np.pi))
    if np.count_nonzero(wrong) > MOST_WRONG * len(wrong):
        first = int(np.argmax(wrong))
        raise InputError(
            str(path),
            f"record {start + first} has latitude {latitude[first]}, longitude"
            f" {longitude[first]}; an SBET has radians: it is not an SBET, or name its format"
            " by .csv or .parquet",
        )
    # A few that cannot be are left out later, like others.
    place = np.column_stack([longitude, latitude, records["altitude"]])
    place[wrong] = np.nan
    place[:, :2] = np.degrees(place[:, :2])
    return place
