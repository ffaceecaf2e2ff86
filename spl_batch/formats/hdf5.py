"""HDF5 files that others made, and Zarr beside them: whatever is wrong becomes one clear line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import h5py

from spl_batch.errors import InputError
from spl_batch.formats.las.header import open_input

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file."""

_FAULTS: Final = (OSError, ValueError, TypeError, KeyError, IndexError, RuntimeError)
"""What h5py, Zarr and their codecs raise over files that make no sense."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading.

    Raises
    ------
    InputError
        If the file is missing, no HDF5, damaged, or a block of it cannot be read.
    """
    with open_input(path) as stream:
        if stream.read(len(SIGNATURE)) != SIGNATURE:
            raise InputError(str(path), "is no HDF5 file (its first bytes say so); copy it again")
    with told_as_damage(path, "HDF5"), h5py.File(path, "r") as file:
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


@contextmanager
def told_as_damage(path: Path, format_name: str) -> Iterator[None]:
    """Turn what a library raises over a file that is open into one line about that file.

    ``format_name``: what it is called, ``HDF5`` or ``Zarr``.

    Raises
    ------
    InputError
        As the block raised it, or with what the library said.
    """
    try:
        yield
    except InputError:
        raise
    except _FAULTS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(str(path), f"damaged {format_name} ({reason}); copy it again") from error
