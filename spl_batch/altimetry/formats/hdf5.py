"""Datasets of altimeters' HDF5 files: checked, and labels written beside them in a copy."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import InputError
from spl_batch.formats.declared import bounded, refuse_bomb
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.hdf5 import refuse_foreign

_CHUNK: Final = 65_536

_VALUES_MAX: Final = 2**40
"""Values of a dataset [count]."""

_CHUNK_BYTES_MAX: Final = 256 << 20
"""A chunk is decoded at once [byte]."""


def dataset(path: Path, file: h5py.File, name: str) -> h5py.Dataset:
    """Dataset of this name, which there has to be."""
    found = file.get(name)
    if not isinstance(found, h5py.Dataset):
        raise InputError(str(path), f"no dataset {name}; is it of the product that it should be?")
    _check_size(path, name, found)
    return found


def _check_size(path: Path, name: str, found: h5py.Dataset) -> None:
    """Refuse a dataset that lies elsewhere, or declares more than its file can hold."""
    refuse_foreign(path, found)
    count = bounded(path, f"values of {name}", int(found.size or 0), most=_VALUES_MAX)
    refuse_bomb(path, name, count * found.dtype.itemsize, path.stat().st_size)
    chunk = int(np.prod(found.chunks or (0,), dtype=object)) * found.dtype.itemsize
    bounded(path, f"bytes of a chunk of {name}", chunk, most=_CHUNK_BYTES_MAX)


def equal_lengths(path: Path, file: h5py.File, group: str, names: Sequence[str]) -> int:
    """Length that one-dimensional datasets of numbers of a group have in common, if all is well."""
    faults: list[str] = []
    sizes: dict[str, int] = {}
    for name in names:
        found = file.get(f"{group}/{name}")
        if not isinstance(found, h5py.Dataset):
            faults.append(f"no dataset {group}/{name}")
        elif found.ndim != 1 or found.dtype.kind not in "fiu":
            faults.append(f"{group}/{name} is {found.ndim}-dimensional {found.dtype}, not numbers")
        else:
            _check_size(path, f"{group}/{name}", found)
            sizes[name] = len(found)
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{k} {v}" for k, v in sizes.items())
        faults.append(f"datasets of {group} differ in length ({listed})")
    if faults:
        raise InputError(str(path), faults)
    return next(iter(sizes.values()))


@contextmanager
def labelled_copy(source: Path, target: Path) -> Iterator[h5py.File]:
    """Copy a file and give the copy for adding to; it appears when the body ends."""
    with replacing(target) as temporary:
        shutil.copyfile(source, temporary)
        with h5py.File(temporary, "r+") as file:
            yield file


def add_dataset(
    group: h5py.Group, name: str, size: int, fill: float, attributes: Mapping[str, str], dtype: Any
) -> h5py.Dataset:
    """Make a compressed one-dimensional dataset of ``fill``, in place of one of this name."""
    if name in group:
        del group[name]
    # A dataset of nothing cannot be cut into chunks.
    packed = {"chunks": (min(_CHUNK, size),), "compression": "gzip", "shuffle": True}
    made = group.create_dataset(
        name,
        shape=(size,),
        dtype=dtype,
        fillvalue=np.dtype(dtype).type(fill),
        **(packed if size else {}),
    )
    made.attrs.update(attributes)
    return made


def finite(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Which values are numbers; products fill what they do not know with 3.4e38."""
    ok: NDArray[np.bool_] = np.isfinite(values) & (np.abs(values) < 1e30)
    return ok
