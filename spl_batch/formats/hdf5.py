"""HDF5 files that others made: whatever is wrong becomes one clear line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import h5py

from spl_batch.errors import InputError, as_input_fault
from spl_batch.formats.las.header import open_input

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading.

    Raises
    ------
    InputError
        If the file is missing, no HDF5, damaged, or a chunk of it cannot be read.
    """
    with open_input(path) as stream:
        if stream.read(len(SIGNATURE)) != SIGNATURE:
            raise InputError(str(path), "is no HDF5 file (by its first bytes); copy it again")
    with as_input_fault(path, "damaged HDF5"), h5py.File(path, "r") as file:
        yield file


def refuse_foreign(path: Path, found: h5py.Dataset) -> None:
    """Refuse a dataset whose values lie in another file, whatever file that is.

    A link, a virtual dataset or external storage would lead a run to read what nobody has named,
    and a link to write there.

    Raises
    ------
    InputError
        If they do.
    """
    if found.is_virtual or found.external or found.file.filename != str(path):
        raise InputError(
            str(path),
            f"{(found.name or '?').lstrip('/')} lies in another file: copy its values into this"
            " one (h5repack)",
        )
