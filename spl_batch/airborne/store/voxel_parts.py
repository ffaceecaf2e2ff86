"""Shares of the expected noise: what each stretch adds to the voxels, a zipped Zarr group for each.

A damaged byte of it is noticed, as :mod:`~spl_batch.formats.verified.parquet_npz` has it.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import zarr
from numpy.typing import NDArray
from zarr.buffer.cpu import Buffer
from zarr.storage import MemoryStore

from spl_batch.engine.store.working_store import Store
from spl_batch.formats.verified.parquet_npz import read_files, write_files
from spl_batch.lattice.tables import VoxelPart

SUMS: Final = ("amount", "shots", "beamlets", "squares")
"""Arrays of a share; see :class:`.VoxelPart`."""


def voxel_file(store: Store, part: str) -> Path:
    """Where a share is kept, by the name of its stretch ``LINE/K``."""
    return store.path("voxels", f"{part}.zarr.zip")


def write_voxels(path: Path, part: VoxelPart) -> None:
    """Write a stretch's share of the noise model, atomically."""
    files: dict[str, Any] = {}
    attributes = {"corner": list(part.corner)}
    group = zarr.create_group(MemoryStore(files), zarr_format=3, attributes=attributes)
    for name in SUMS:
        values: NDArray[Any] | None = getattr(part, name)
        if values is not None:
            chunks = tuple(max(edge, 1) for edge in values.shape)
            group.create_array(name, data=values, chunks=chunks)
    write_files(path, {name: file.to_bytes() for name, file in files.items()})


def read_voxels(path: Path) -> VoxelPart:
    """A share from :func:`write_voxels`; raises DamagedError if it is missing or damaged."""
    files: dict[str, Any] = {k: Buffer.from_bytes(v) for k, v in read_files(path).items()}
    group = zarr.open_group(MemoryStore(files), mode="r")
    corner: Any = group.attrs["corner"]
    sums: dict[str, Any] = {name: array[...] for name, array in group.arrays()}
    return VoxelPart((corner[0], corner[1], corner[2]), **sums)


class StoredVoxels(NamedTuple):
    """A share of the store, which is read once it is added up."""

    path: Path
    first: int  #: Its first layer, and the one past the last.
    stop: int

    def layers(self) -> range:
        """Absolute indices of its layers."""
        return range(self.first, self.stop)

    def add(self, corner: Sequence[int], totals: Mapping[str, NDArray[Any]]) -> None:
        """Add it to a box of voxels, in place; see :meth:`.VoxelPart.add`."""
        read_voxels(self.path).add(corner, totals)


def stored_by_line(store: Store, parts: Iterable[tuple[str, int, int]]) -> list[list[StoredVoxels]]:
    """Shares of stretches, a list for each flightline in the order of names.

    ``parts``: name ``LINE/K``, first layer and the one past the last, of each.
    """
    lines: dict[str, list[StoredVoxels]] = {}
    for part, first, stop in sorted(parts):
        stored = StoredVoxels(voxel_file(store, part), first, stop)
        lines.setdefault(part.rpartition("/")[0], []).append(stored)
    return list(lines.values())
