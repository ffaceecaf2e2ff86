"""Shares of the expected noise: what each stretch adds to the voxels, as Zarr groups."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import zarr
from numpy.typing import NDArray

from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.verified.zarr_chunks import pack, read_box, read_metadata
from spl_batch.lattice.tables import VoxelPart

VOXEL_CHUNK: Final = 32
"""Voxels along one horizontal side of a Zarr chunk [count]."""


def write_voxels(path: Path, part: VoxelPart) -> None:
    """Write a stretch's share of the noise model as a Zarr group, atomically."""
    shape = part.amount.shape
    arrays: dict[str, NDArray[Any] | None] = {
        "amount": part.amount,
        "shots": part.shots,
        "beamlets": part.beamlets,
        "squares": part.squares,
    }
    attributes = {"corner": list(part.corner)}
    with replacing(path, durable=False) as temporary:
        zarr.create_group(str(temporary), attributes=attributes)
        for name, values in arrays.items():
            if values is None:
                continue
            chunks = (min(VOXEL_CHUNK, shape[0]), min(VOXEL_CHUNK, shape[1]), *values.shape[2:])
            files = pack(values, chunks=chunks, attributes=attributes)
            for file, content in files.items():
                target = temporary / name / file
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)


def add_voxels(
    path: Path, corner: tuple[int, int, int], totals: Mapping[str, NDArray[Any]]
) -> None:
    """Add one part's share to a box of voxels, in place.

    Parameters
    ----------
    path : Path
        Group written by :func:`write_voxels`.
    corner : (3,) int
        Absolute index of the box's first voxel.
    totals : mapping of str to (nx, ny, nz) or (nx, ny, nz, 16) integer
        The box by the name of the sum (``amount``, ``shots``, ``beamlets``, ``squares``); the
        part is added where they overlap.

    Raises
    ------
    DamagedError
        If the part is missing or damaged.
    """
    for name, total in totals.items():
        array = path / name
        metadata = read_metadata(array)
        first = [int(c) for c in metadata["attributes"]["corner"]]
        shape, inner = metadata["shape"][:3], metadata["shape"][3:]
        low = [max(a, b) for a, b in zip(first, corner, strict=True)]
        high = [
            min(a + n, b + m)
            for a, n, b, m in zip(first, shape, corner, total.shape[:3], strict=True)
        ]
        if any(b <= a for a, b in zip(low, high, strict=True)):
            return
        of_part = tuple(slice(a - c, b - c) for a, b, c in zip(low, high, first, strict=True))
        of_box = tuple(slice(a - c, b - c) for a, b, c in zip(low, high, corner, strict=True))
        whole = (*of_part, *(slice(0, n) for n in inner))
        values = read_box(array, metadata, whole)
        total[of_box] += values.astype(total.dtype, copy=False)
