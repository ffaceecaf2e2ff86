"""Shares of the expected noise: what each stretch adds to the voxels, a file of arrays for each."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.store.working_store import Store
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tables import VoxelPart


def voxel_file(store: Store, part: str) -> Path:
    """Where a share is kept, by the name of its stretch ``LINE/K``."""
    return store.path("voxels", f"{part}.npz")


def write_voxels(path: Path, part: VoxelPart) -> None:
    """Write a stretch's share of the noise model, atomically."""
    sums = {name: getattr(part, name) for name in ("amount", "shots", "beamlets", "squares")}
    known = {name: values for name, values in sums.items() if values is not None}
    write_arrays(path, {"corner": np.array(part.corner), **known})


def read_voxels(path: Path) -> VoxelPart:
    """A share from :func:`write_voxels`; raises DamagedError if it is missing or damaged."""
    arrays = read_arrays(path)
    west, south, low = arrays.pop("corner").tolist()
    return VoxelPart((west, south, low), **arrays)


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
