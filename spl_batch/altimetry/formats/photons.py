"""Photons of any known layout, in slices: along-track distance and height on the lattice."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats import atl03, mabel, track_csv
from spl_batch.altimetry.formats.hdf5 import finite
from spl_batch.altimetry.photon_table import Slice
from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError
from spl_batch.formats.hdf5 import SIGNATURE, open_hdf5
from spl_batch.formats.las.header import open_input

Layout = Literal["atl03", "mabel", "csv"]

HDF5: Final = frozenset({".h5", ".hdf5", ".he5"})
"""Suffixes of files that cannot be tables."""

_HEIGHT_MAX_M: Final = 2e4
_ALONG_MAX_M: Final = 1e9


@dataclass(frozen=True, slots=True)
class BeamFacts:
    """A beam by its file's header."""

    name: str  #: As the product calls it.
    photons: int  #: Photons, or an estimate where only reading counts them [count].
    group: str  #: Group of its photons in an HDF5 file.


@dataclass(frozen=True, slots=True)
class TrackFile:
    """A photon file whose header is sound."""

    path: Path
    layout: Layout
    beams: tuple[BeamFacts, ...]
    size_bytes: int
    written_ns: int


@dataclass(frozen=True, slots=True)
class Photons:
    """Photons of a slice that can be placed."""

    row: NDArray[np.int64]  #: (n,): position in the file.
    along: NDArray[np.int64]  #: (n,): along-track distance [quanta].
    height: NDArray[np.int32]  #: (n,): height [quanta].
    #: (n,): where [deg]; NaN where the file has none.
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
    read: int  #: Photons of the slice, placed or not [count].


def inspect(path: Path) -> TrackFile:
    """Layout and beams of a file of HDF5 or CSV, from its header.

    Raises
    ------
    InputError
        With every fault found.
    """
    with open_input(path) as stream:
        start = stream.read(len(SIGNATURE))
    status = path.stat()
    layout: Layout = "csv"
    if start != SIGNATURE and path.suffix.lower() not in HDF5:
        listed = [("track", track_csv.estimate(path, status.st_size), "")]
    else:
        with open_hdf5(path) as file:
            layout = "mabel" if "photon" in file else "atl03"
            listed = (mabel if layout == "mabel" else atl03).beams(path, file)
    beams = tuple(BeamFacts(*values) for values in listed)
    return TrackFile(path, layout, beams, status.st_size, status.st_mtime_ns)


def iter_photons(path: Path, layout: Layout, beam: str, chunk: int) -> Iterator[Photons]:
    """Photons of a beam in the order of the file, of HDF5 never more than ``chunk`` at once.

    Raises
    ------
    InputError
        If a slice cannot be read, or holds heights or distances that cannot be.
    """
    first = 0
    for piece in _slices(path, layout, beam, chunk):
        known = finite(piece.along_m) & finite(piece.height_m)
        along_m, height_m, latitude, longitude = (values[known] for values in piece)
        faults = [
            f"{name} {worst:g} m; at most {most:g} m is possible: check units and columns"
            for name, values, most in (
                ("height", height_m, _HEIGHT_MAX_M),
                ("along-track distance", along_m, _ALONG_MAX_M),
            )
            if (worst := float(np.abs(values).max(initial=0.0))) > most
        ]
        if faults:
            raise InputError(str(path), faults)
        yield Photons(
            first + np.flatnonzero(known),
            np.rint(along_m * QUANTA_PER_M).astype(np.int64),
            np.rint(height_m * QUANTA_PER_M).astype(np.int32),
            latitude,
            longitude,
            len(known),
        )
        first += len(known)


def _slices(path: Path, layout: Layout, beam: str, chunk: int) -> Iterator[Slice]:
    if layout == "csv":
        yield from track_csv.slices(path)
        return
    with open_hdf5(path) as file:
        count, read = (mabel if layout == "mabel" else atl03).reader(path, file, beam)
        for first in range(0, count, chunk):
            yield read(slice(first, min(first + chunk, count)))
